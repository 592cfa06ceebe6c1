"""Procedures that take drives from "powered" to "in the loop", tick by tick: states, fault reset, modes, brakes.

Every procedure runs on the same ticks as the sample loop, so SYNC, heartbeats and supervision never pause; each has a time-out and each
refuses in words. The bench's methods in `drivers.machine_link` string them together and stop the motors when one refuses.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Protocol

import numpy as np

from drivers.canopen import cia402
from drivers.canopen.axis_rest import POWERED
from drivers.canopen.cia402 import MODES_DISPLAY, MODES_OF_OPERATION, Mode, State
from drivers.canopen.emcy import describe_code
from drivers.canopen.heartbeat_consumer import HeartbeatConsumer
from drivers.canopen.motion_bounds import MotionWatch
from drivers.canopen.process_data import AxisInput
from drivers.canopen.sdo import SdoNode
from drivers.errors import BusTimeoutError, DeviceFaultError, MotionRefusedError
from drivers.interface import Clock, Sample
from drivers.settings import AxisScaling, Node

TRANSITION_TIMEOUT_S = 2.0  # drives that charge a DC link or wait for a contactor take most of a second
FAULT_RESET_TIMEOUT_S = 1.0
FAULT_RESETS = 2  # a drive may take the first rising edge for none
MODE_TIMEOUT_S = 1.0
MODE_CHANGING_S = 10.0
"""For how long a drive without voltage may show no mode, -1, while it changes; some take 3 to 6 s to synchronise."""
NO_MODE = -1
BRAKE_TIMEOUT_S = 1.0  # Modbus poll, relay, armature, feedback, Modbus poll
HOLD_BEFORE_RELEASE_S = 0.05  # current controllers settle within milliseconds; the brake must not open before
SETTLED_TICKS = 2  # after a controlword goes out its effect is in the statusword of the next SYNC; one more to be sure

ERROR_CODE = 0x603F

Hold = Callable[[Sample], np.ndarray]
"""Command that holds the axes, as a function of the newest sample: a constant effort, or the loop's feedback."""


class Machine(Protocol):
    """The interface of a machine for these procedures: its ticks, its drives by axis number, its brakes."""

    clock: Clock
    period_s: float  # of the ticks
    heartbeats: HeartbeatConsumer
    axes: tuple[str, ...]
    drives: tuple[Node, ...]
    scalings: tuple[AxisScaling, ...]
    inputs: tuple[AxisInput, ...]
    sample: Sample
    watch: MotionWatch
    modes: list[Mode | None]  # of the drives, None where the bench has chosen none
    open_brakes: set[str]  # of these axes: one that reports closed before it is told to is refused
    judged: Callable[[Sample], str]  # why sensors stop the motors, in words; '' where they do not
    notes: tuple[str, ...]  # what an operator should know of the nodes

    def exchange(self, command: np.ndarray) -> Sample:
        """Make one tick; raises on faults of armed drives."""

    def set_controlword(self, axis: int, controlword: int) -> None:
        """Set the controlword of the next tick and all later ones."""

    def lead_to(self, axis: int, target: float) -> None:
        """Set the position or velocity that a drive's own loops follow from the next tick on."""

    def takes_effort(self, axis: int) -> bool:
        """Return whether the drive takes an effort: all of it in torque mode, a part of it in others."""

    def arm(self, axis: int, armed: bool) -> None:
        """Arm or disarm a drive: an armed drive that leaves operation enabled is a fault."""

    def command_brakes(self, open_: dict[str, bool]) -> None:
        """Ask for brakes to open or close."""

    def has_brake(self, axis: int) -> bool:
        """Return whether the I/O commands a brake of this axis."""

    def rest_axes(self, axes: Sequence[int], effort: np.ndarray | None) -> None:
        """Prove the closed brakes of enabled axes that stand with this effort, None: that move, and take their voltage."""

    def refusal(self) -> str:
        """Return in words why hold-to-run, door or I/O forbid motion; '' when they permit it."""

    def sdo(self, axis: int) -> SdoNode:
        """Return the object dictionary of the axis' drive."""

    def resume_ticks(self) -> None:
        """Start the ticks again after something else took time."""


def reach(machine: Machine, goal: State, axes: Sequence[int], hold: Hold) -> None:
    """Lead drives to a state of CiA 402, one transition per answer; `hold` acts as soon as a drive is enabled.

    Raises
    ------
    DeviceFaultError
        A drive is in fault or falls into it.
    BusTimeoutError
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
                raise DeviceFaultError(fault_words(machine, axis))
            controlword = cia402.next_controlword(state, goal)
            if controlword is not None:
                machine.set_controlword(axis, controlword)
            if state is not goal:
                pending.append(axis)
        if not pending:
            break
        if machine.clock.now() > deadline:
            words = "; ".join(f"{machine.drives[a].name} is {cia402.describe_statusword(machine.inputs[a].statusword)}" for a in pending)
            raise BusTimeoutError(
                f"not {goal.value} within {TRANSITION_TIMEOUT_S:.1f} s: {words}; is its power stage supplied, is safe torque off released?"
            )
        tick(machine, hold(machine.sample))
    if goal is State.OPERATION_ENABLED:
        for axis in axes:
            machine.arm(axis, True)


def reset_fault(machine: Machine, axis: int) -> None:
    """Reset a drive's fault by a rising edge, or a second one, check that it is gone, and note which it was. Never enables the drive.

    Raises
    ------
    DeviceFaultError
        The fault persists; its cause in words.
    """
    machine.arm(axis, False)
    if not _in_fault(machine, axis):
        return
    node = machine.drives[axis]
    was = machine.heartbeats.last_emergency(node.node_id) or cia402.describe_statusword(machine.inputs[axis].statusword)
    resets = 0
    while _in_fault(machine, axis):
        if resets == FAULT_RESETS:
            raise DeviceFaultError(
                f"{fault_words(machine, axis)}; {resets} fault resets did not clear it within {FAULT_RESET_TIMEOUT_S:.1f} s each: "
                "remove its cause"
            )
        resets += 1
        _raise_reset(machine, axis)
    machine.notes += (f"{node.name} (node {node.node_id}): was in fault, {was}; it was reset",)


def _raise_reset(machine: Machine, axis: int) -> None:
    """Give the fault reset bit of a drive a rising edge, wait for its effect, and take it back."""
    zero, deadline = np.zeros(len(machine.axes)), machine.clock.now() + FAULT_RESET_TIMEOUT_S
    machine.set_controlword(axis, cia402.FAULT_RESET)  # rises: no other controlword sent before has this bit
    for _ in range(SETTLED_TICKS):
        machine.exchange(zero)
    while _in_fault(machine, axis) and machine.clock.now() < deadline:
        machine.exchange(zero)
    machine.set_controlword(axis, cia402.DISABLE_VOLTAGE)
    for _ in range(SETTLED_TICKS):  # a cause that is still there brings the fault back at once
        machine.exchange(zero)


def fault_words(machine: Machine, axis: int) -> str:
    """Return state, error code and newest EMCY of a drive that is in fault."""
    node = machine.drives[axis]
    words = [f"{node.name} (node {node.node_id}): {cia402.describe_statusword(machine.inputs[axis].statusword)}"]
    emergency = machine.heartbeats.last_emergency(node.node_id)
    if emergency:
        words.append(emergency)
    else:
        code = int.from_bytes(machine.sdo(axis).read_if_present(ERROR_CODE) or b"", "little")
        words.append(f"error code {code:04X}h: {describe_code(code, node.identity.vendor_id)}")
    return "; ".join(words)


def set_mode(machine: Machine, axis: int, mode: Mode) -> None:
    """Choose a mode of operation and wait until the drive displays it; where it has no voltage, the ticks go on meanwhile.

    Raises
    ------
    MotionRefusedError
        The drive keeps another mode.
    """
    sdo = machine.sdo(axis)
    machine.modes[axis] = None
    sdo.settings.pop((MODES_DISPLAY, 0), None)
    if sdo.read_integer(MODES_DISPLAY) == mode:
        machine.modes[axis], sdo.settings[MODES_DISPLAY, 0] = mode, (mode, 0)
        return
    sdo.write_integer(MODES_OF_OPERATION, 0, mode)
    asked_s = machine.clock.now()
    while (shown := sdo.read_integer(MODES_DISPLAY)) != mode:
        changes = shown == NO_MODE and cia402.decode_state(machine.inputs[axis].statusword) not in POWERED
        if machine.clock.now() > asked_s + (MODE_CHANGING_S if changes else MODE_TIMEOUT_S):
            stays = f"shows no mode (-1) for {MODE_CHANGING_S:g} s" if changes else f"stays in mode {shown}"
            raise MotionRefusedError(f"{sdo.who}: {stays}, mode {int(mode)} ({mode.name.lower().replace('_', ' ')}) was asked for")
        if changes:  # it may miss its commands
            machine.resume_ticks()
            machine.exchange(np.zeros(len(machine.axes)))
        else:
            sdo.network.pump_for(0.01)
    machine.modes[axis], sdo.settings[MODES_DISPLAY, 0] = mode, (mode, 0)
    machine.resume_ticks()


def open_brakes(machine: Machine, axes: Sequence[int], hold: Hold) -> None:
    """Hold, release the brakes, and wait until their feedback says open.

    Raises
    ------
    MotionRefusedError
        A brake's feedback does not follow.
    """
    run_for(machine, HOLD_BEFORE_RELEASE_S, hold)
    _move_brakes(machine, axes, hold, wanted=True)


def close_brakes(machine: Machine, axes: Sequence[int], hold: Hold) -> None:
    """Close the brakes while the drives still hold, and wait until their feedback says closed."""
    _move_brakes(machine, axes, hold, wanted=False)


def come_to_rest(machine: Machine, axes: Sequence[int], hold: Hold) -> None:
    """Close the brakes of axes that their drives hold, prove them, and take the voltage.

    Raises
    ------
    MotionRefusedError
        A brake's feedback does not follow, or a brake does not hold the axis when its drive lets go; the drive holds.
    """
    close_brakes(machine, axes, hold)
    machine.rest_axes(axes, hold(machine.sample))


def run_for(machine: Machine, seconds: float, hold: Hold) -> None:
    """Tick for this long under a holding command."""
    for _ in range(ticks_in(machine, seconds)):
        tick(machine, hold(machine.sample))


def ticks_in(machine: Machine, seconds: float) -> int:
    """Return whole ticks of a duration, so that a procedure is the same frame by frame on every bus."""
    return max(1, math.ceil(seconds / machine.period_s))


def tick(machine: Machine, command: np.ndarray) -> Sample:
    """Exchange once; no device may report a fault, the permission to move must stand, and no axis may leave its bounds.

    Raises
    ------
    DeviceFaultError
        A node reported a fault; the message gives it in words.
    MotionRefusedError
        Hold-to-run was released, the door was opened, or the I/O has gone silent; an open brake reports closed; an axis moves beyond its
        bounds, or its position is unknown; a sensor stops the motors.
    """
    sample = machine.exchange(command)
    if sample.fault:
        raise DeviceFaultError(sample.fault)
    refusal = machine.refusal() or machine.watch.check(sample) or machine.judged(sample)
    if refusal:
        raise MotionRefusedError(refusal)
    return sample


def _in_fault(machine: Machine, axis: int) -> bool:
    return cia402.decode_state(machine.inputs[axis].statusword) in (State.FAULT, State.FAULT_REACTION_ACTIVE)


def _move_brakes(machine: Machine, axes: Sequence[int], hold: Hold, *, wanted: bool) -> None:
    braked = [axis for axis in axes if machine.has_brake(axis)]
    if not braked:
        return
    machine.command_brakes({machine.axes[axis]: wanted for axis in braked})
    deadline = machine.clock.now() + BRAKE_TIMEOUT_S
    while True:
        sample = tick(machine, hold(machine.sample))
        waiting = [machine.axes[axis] for axis in braked if bool(sample.brakes_open[axis]) != wanted]
        if not waiting:
            if wanted:
                machine.open_brakes.update(machine.axes[axis] for axis in braked)
            return
        if machine.clock.now() > deadline:
            word = "open" if wanted else "closed"
            raise MotionRefusedError(
                f"brake of {', '.join(waiting)}: not {word} within {BRAKE_TIMEOUT_S:.1f} s by its feedback; check brake, relay and input"
            )
