"""What happens to drives between "powered" and "in the loop", tick by tick: states, fault reset, brakes, first move, homing.

Every procedure runs on the same ticks as the sample loop, so SYNC, heartbeats and supervision never pause; each has a time-out and each
refuses in words. The bench's methods in `drivers.machine_link` string them together and stop the motors when one refuses.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Protocol

import numpy as np

from drivers.canopen import cia402
from drivers.canopen.cia402 import Homing, Mode, State
from drivers.canopen.cyclic import AxisInput
from drivers.canopen.emcy import describe_code
from drivers.canopen.sdo import SdoNode
from drivers.canopen.supervision import Supervision
from drivers.errors import BusTimeout, DeviceFault, MotionRefused
from drivers.interface import Clock, Sample
from drivers.settings import AxisScaling, HomingSettings, Node

TRANSITION_TIMEOUT_S = 2.0  # drives that charge a DC link or wait for a contactor take most of a second
FAULT_RESET_TIMEOUT_S = 1.0
MODE_TIMEOUT_S = 1.0
BRAKE_TIMEOUT_S = 1.0  # Modbus poll, relay, armature, feedback, Modbus poll
HOLD_BEFORE_RELEASE_S = 0.05  # current controllers settle within milliseconds; the brake must not open before
DRIFT_WATCH_S = 0.1  # how long an axis is watched under holding effort alone before it is pushed
RAMP_SHARE = 0.5  # of the direction check's time-out in which the effort rises
SETTLED_TICKS = 2  # after a controlword goes out its effect is in the statusword of the next SYNC; one more to be sure

HOMING_AT_PRESENT_POSITION = frozenset({35, 37})
MODES_OF_OPERATION, MODES_DISPLAY, ERROR_CODE = 0x6060, 0x6061, 0x603F
HOMING_METHOD, HOMING_SPEEDS, HOMING_ACCELERATION = 0x6098, 0x6099, 0x609A

Hold = Callable[[Sample], np.ndarray]
"""Which command holds the axes, given the newest sample: a constant effort, or the loop's feedback."""


class Machine(Protocol):
    """What the procedures need of the machine: its ticks, its drives by axis number, its brakes."""

    clock: Clock
    supervision: Supervision
    axes: tuple[str, ...]
    drives: tuple[Node, ...]
    scalings: tuple[AxisScaling, ...]
    inputs: tuple[AxisInput, ...]
    sample: Sample

    def exchange(self, command: np.ndarray) -> Sample:
        """One tick; raises on faults of armed drives."""

    def set_controlword(self, axis: int, controlword: int) -> None:
        """Controlword from the next tick on."""

    def arm(self, axis: int, armed: bool) -> None:
        """An armed drive that leaves operation enabled is a fault."""

    def command_brakes(self, open_: dict[str, bool]) -> None:
        """Ask for brakes to open or close."""

    def has_brake(self, axis: int) -> bool:
        """Whether the I/O commands a brake of this axis."""

    def sdo(self, axis: int) -> SdoNode:
        """Object dictionary of the axis' drive."""

    def resume_ticks(self) -> None:
        """Ticks start anew after something else took time."""


def reach(machine: Machine, goal: State, axes: Sequence[int], command: np.ndarray) -> None:
    """Lead drives to a state of CiA 402, one transition per answer.

    Raises
    ------
    DeviceFault
        A drive is in fault or falls into it.
    BusTimeout
        A drive stays where it is.
    """
    deadline = machine.clock.now() + TRANSITION_TIMEOUT_S
    for axis in axes:
        machine.arm(axis, False)
    while True:
        pending = []
        for axis in axes:
            statusword = machine.inputs[axis].statusword
            state = cia402.decode_state(statusword)
            if state in (State.FAULT, State.FAULT_REACTION_ACTIVE):
                raise DeviceFault(fault_words(machine, axis))
            controlword = cia402.next_controlword(state, goal)
            if controlword is not None:
                machine.set_controlword(axis, controlword)
            if state is not goal:
                pending.append(axis)
        if not pending:
            break
        if machine.clock.now() > deadline:
            words = "; ".join(f"{machine.drives[a].name} is {cia402.describe_statusword(machine.inputs[a].statusword)}" for a in pending)
            raise BusTimeout(
                f"not {goal.value} within {TRANSITION_TIMEOUT_S:.1f} s: {words}; is its power stage supplied, is safe torque off released?"
            )
        machine.exchange(command)
    if goal is State.OPERATION_ENABLED:
        for axis in axes:
            machine.arm(axis, True)


def reset_fault(machine: Machine, axis: int) -> None:
    """Reset a drive's fault by a rising edge and check that it is gone. Never enables the drive.

    Raises
    ------
    DeviceFault
        The fault persists; its cause in words.
    """
    zero = np.zeros(len(machine.axes))
    machine.arm(axis, False)
    deadline = machine.clock.now() + FAULT_RESET_TIMEOUT_S
    if not _in_fault(machine, axis):
        return
    for controlword in (cia402.DISABLE_VOLTAGE, cia402.FAULT_RESET):
        machine.set_controlword(axis, controlword)
        for _ in range(SETTLED_TICKS):
            machine.exchange(zero)
    while _in_fault(machine, axis) and machine.clock.now() < deadline:
        machine.exchange(zero)
    machine.set_controlword(axis, cia402.DISABLE_VOLTAGE)
    for _ in range(SETTLED_TICKS):  # a cause that is still there brings the fault back at once
        machine.exchange(zero)
    if _in_fault(machine, axis):
        raise DeviceFault(
            f"{fault_words(machine, axis)}; a fault reset did not clear it within {FAULT_RESET_TIMEOUT_S:.1f} s: remove its cause"
        )


def fault_words(machine: Machine, axis: int) -> str:
    """State, error code and newest EMCY of a drive that is in fault."""
    node = machine.drives[axis]
    words = [f"{node.name} (node {node.node_id}): {cia402.describe_statusword(machine.inputs[axis].statusword)}"]
    emergency = machine.supervision.last_emergency(node.node_id)
    if emergency:
        words.append(emergency)
    else:
        code = int.from_bytes(machine.sdo(axis).read_if_present(ERROR_CODE) or b"", "little")
        words.append(f"error code {code:04X}h: {describe_code(code, node.identity.vendor_id)}")
    return "; ".join(words)


def set_mode(machine: Machine, axis: int, mode: Mode) -> None:
    """Choose a mode of operation and wait until the drive displays it.

    Raises
    ------
    MotionRefused
        The drive keeps another mode.
    """
    sdo = machine.sdo(axis)
    if sdo.read_integer(MODES_DISPLAY) == mode:
        return
    sdo.write_integer(MODES_OF_OPERATION, 0, mode)
    deadline = machine.clock.now() + MODE_TIMEOUT_S
    while (shown := sdo.read_integer(MODES_DISPLAY)) != mode:
        if machine.clock.now() > deadline:
            raise MotionRefused(f"{sdo.who}: stays in mode {shown}, mode {int(mode)} ({mode.name.lower().replace('_', ' ')}) was asked for")
        sdo.network.pump_for(0.01)
    machine.resume_ticks()


def open_brakes(machine: Machine, axes: Sequence[int], hold: Hold) -> None:
    """Hold, release the brakes, and wait until their feedback says open.

    Raises
    ------
    MotionRefused
        A brake's feedback does not follow.
    """
    run_for(machine, HOLD_BEFORE_RELEASE_S, hold)
    _move_brakes(machine, axes, hold, wanted=True)


def close_brakes(machine: Machine, axes: Sequence[int], hold: Hold) -> None:
    """Close the brakes while the drives still hold, and wait until their feedback says closed."""
    _move_brakes(machine, axes, hold, wanted=False)


def check_first_move(machine: Machine, axis: int, settings: HomingSettings, holding: np.ndarray) -> None:
    """Push an enabled axis, brake open, gently in the positive direction: it must move that way, and its link with it.

    The effort rises from the holding effort to `direction_check_effort` above it and is taken back once `direction_check_travel` is seen.

    Raises
    ------
    MotionRefused
        It moves under holding effort alone, the wrong way, or not at all; or the link encoder counts the other way.
    """
    name, unit, travel = machine.axes[axis], machine.scalings[axis].position_unit, settings.direction_check_travel
    start, link_start = _positions(machine, axis, holding)
    run_for(machine, DRIFT_WATCH_S, lambda _: holding)
    drift = _positions(machine, axis, holding)[0] - start
    if abs(drift) >= travel:
        raise MotionRefused(
            f"{name}: moves by {drift:+.2e} {unit} under its holding effort of {holding[axis]:.3g} alone; the holding effort is wrong"
        )
    begin = machine.clock.now()
    command = holding.copy()
    while True:
        elapsed = machine.clock.now() - begin
        command[axis] = holding[axis] + settings.direction_check_effort * min(
            1.0, elapsed / (RAMP_SHARE * settings.direction_check_timeout_s)
        )
        sample = machine.exchange(command)
        moved = sample.position[axis] - start
        if moved >= travel:
            break
        if moved <= -travel:
            raise MotionRefused(
                f"{name}: moved {moved:+.2e} {unit} on a positive effort; "
                "motor wiring, encoder direction or the machine file's sign is reversed"
            )
        if elapsed > settings.direction_check_timeout_s:
            raise MotionRefused(
                f"{name}: moved {moved:+.2e} {unit} where {travel:.2e} was expected within {settings.direction_check_timeout_s:.1f} s at "
                f"{settings.direction_check_effort:.3g} above its holding effort; brake, friction or a disconnected motor"
            )
    link_moved = _positions(machine, axis, holding)[1] - link_start
    if link_moved <= -0.5 * travel:
        raise MotionRefused(
            f"{name}: the motor moved {moved:+.2e} {unit}, its link encoder {link_moved:+.2e}; the link encoder counts the wrong way"
        )


def home_drive(machine: Machine, axis: int, settings: HomingSettings, holding: np.ndarray) -> None:
    """Run the drive's own homing and take its counter's zero, or the absolute link encoder's, as the joint's.

    The axis' drive is disabled before and after. Methods 35 and 37 (the present position is home) move nothing: there the link encoder says
    where the joint is. Methods that move open the brake for as long as they last; their home offset (607Ch) is the machine file's affair.

    Raises
    ------
    MotionRefused
        Homing error or time-out.
    """
    moves = settings.method not in HOMING_AT_PRESENT_POSITION
    set_mode(machine, axis, Mode.HOMING)
    _write_homing(machine, axis, settings, moves)
    machine.resume_ticks()
    reach(machine, State.OPERATION_ENABLED, [axis], holding)
    if moves:
        open_brakes(machine, [axis], lambda _: holding)
    try:
        _run_homing(machine, axis, settings, holding)
    finally:
        if moves:
            machine.command_brakes({machine.axes[axis]: False})
    if moves:
        close_brakes(machine, [axis], lambda _: holding)
    reach(machine, State.SWITCH_ON_DISABLED, [axis], holding)
    set_mode(machine, axis, Mode.CYCLIC_SYNCHRONOUS_TORQUE)
    source = machine.inputs[axis]
    source.counter_was_set()
    source.offset = 0.0
    position, link = _positions(machine, axis, holding)
    if not moves and np.isfinite(link):
        source.offset = link - position


def check_agreement(machine: Machine, axis: int, settings: HomingSettings, command: np.ndarray) -> None:
    """Motor side and link encoder must tell the same position.

    Raises
    ------
    MotionRefused
        They differ by more than `agreement_tolerance`.
    """
    position, link = _positions(machine, axis, command)
    if np.isfinite(link) and abs(position - link) > settings.agreement_tolerance:
        unit = machine.scalings[axis].position_unit
        raise MotionRefused(
            f"{machine.axes[axis]}: motor side {position:+.5f} {unit}, link encoder {link:+.5f} {unit}: "
            f"they differ by {abs(position - link):.2e}, {settings.agreement_tolerance:.2e} is allowed; home anew, or check ratio, resolution and zero_counts"
        )


def run_for(machine: Machine, seconds: float, hold: Hold) -> None:
    """Tick for that long under a holding command."""
    end = machine.clock.now() + seconds
    while machine.clock.now() < end:
        machine.exchange(hold(machine.sample))


def _in_fault(machine: Machine, axis: int) -> bool:
    return cia402.decode_state(machine.inputs[axis].statusword) in (State.FAULT, State.FAULT_REACTION_ACTIVE)


def _move_brakes(machine: Machine, axes: Sequence[int], hold: Hold, *, wanted: bool) -> None:
    braked = [axis for axis in axes if machine.has_brake(axis)]
    if not braked:
        return
    machine.command_brakes({machine.axes[axis]: wanted for axis in braked})
    deadline = machine.clock.now() + BRAKE_TIMEOUT_S
    while True:
        sample = machine.exchange(hold(machine.sample))
        waiting = [machine.axes[axis] for axis in braked if bool(sample.brakes_open[axis]) != wanted]
        if not waiting:
            return
        if machine.clock.now() > deadline:
            word = "open" if wanted else "closed"
            raise MotionRefused(
                f"brake of {', '.join(waiting)}: not {word} within {BRAKE_TIMEOUT_S:.1f} s by its feedback; check brake, relay and input"
            )


def _positions(machine: Machine, axis: int, command: np.ndarray) -> tuple[float, float]:
    """Motor-side and link position of one complete sample; the link's is NaN when the axis has no link encoder."""
    has_link = machine.scalings[axis].link_resolution != 0.0
    deadline = machine.clock.now() + MODE_TIMEOUT_S
    while True:
        sample = machine.exchange(command)
        position, link = float(sample.position[axis]), float(sample.link_position[axis])
        if np.isfinite(position) and (np.isfinite(link) or not has_link):
            return position, link
        if machine.clock.now() > deadline:
            silent = "position" if not np.isfinite(position) else "link encoder"
            raise BusTimeout(f"{machine.axes[axis]}: no {silent} for {MODE_TIMEOUT_S:.1f} s")


def _write_homing(machine: Machine, axis: int, settings: HomingSettings, moves: bool) -> None:
    """Method, and for those that move speeds and acceleration, in counts per second as the standard's default units have it."""
    sdo = machine.sdo(axis)
    sdo.write_checked(HOMING_METHOD, 0, settings.method)
    if not moves:
        return
    per_count = machine.scalings[axis].position_resolution
    for subindex in (1, 2):
        sdo.write_checked(HOMING_SPEEDS, subindex, max(1, round(settings.speed / per_count)))
    if sdo.may_write(HOMING_ACCELERATION):
        sdo.write_checked(HOMING_ACCELERATION, 0, max(1, round(settings.acceleration / per_count)))


def _run_homing(machine: Machine, axis: int, settings: HomingSettings, command: np.ndarray) -> None:
    machine.set_controlword(axis, cia402.ENABLE_OPERATION)
    for _ in range(SETTLED_TICKS):  # the start bit must be seen low before it rises
        machine.exchange(command)
    machine.set_controlword(axis, cia402.ENABLE_OPERATION | cia402.HOMING_START)
    for _ in range(SETTLED_TICKS):
        machine.exchange(command)
    deadline = machine.clock.now() + settings.timeout_s
    while (progress := cia402.decode_homing(machine.inputs[axis].statusword)) is not Homing.DONE:
        failed = progress in (Homing.FAILED, Homing.FAILED_MOVING)
        if failed or machine.clock.now() > deadline:
            reason = progress.value if failed else f"not completed within {settings.timeout_s:.1f} s ({progress.value})"
            raise MotionRefused(f"{machine.axes[axis]}: homing by method {settings.method}: {reason}; the position is not known")
        machine.exchange(command)
    machine.set_controlword(axis, cia402.ENABLE_OPERATION)
