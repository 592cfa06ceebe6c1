"""A machine's first careful motion, axis by axis: a gentle push that must move it in the right direction, homing, encoder agreement."""

from __future__ import annotations

from math import copysign, isfinite, nan

import numpy as np

from drivers.canopen import cia402, power_and_brakes
from drivers.canopen.cia402 import HOMING_AT_PRESENT_POSITION, NO_HOMING, Homing, Mode, State
from drivers.canopen.power_and_brakes import SETTLED_TICKS, Machine
from drivers.canopen.quick_stop import SETTLING_S, STANDSTILL_COUNTS
from drivers.canopen.units import in_data_sheet, units_of, whole_speed
from drivers.errors import BusTimeoutError, MotionRefusedError
from drivers.interface import Sample
from drivers.settings import HomingSettings

DRIFT_WATCH_S = 0.1  # how long an axis must stand under holding effort alone before it is pushed
RAMP_SHARE = 0.5  # share of the direction check's time-out in which the effort rises
SAMPLE_TIMEOUT_S = 1.0  # for one row in which motor side and link encoder both answered
ATTAINED = (Homing.DONE, Homing.SETTLING)
"""What a drive may say of an earlier run still: it counts once the drive has said otherwise since this one began."""
SMALLEST_SHARE = 0.07
"""Of the range in which a load may lie: an axis that moves on still, after four halvings, has no friction to speak of."""
WEAKER = 0.7
"""Share of the acceleration before with which an axis that is held by more may still move on: midway between half of it, to which it falls
at least, and all of it."""
STALE_S = 0.25
"""[s] After which it counts, where homing takes the present position, even if the drive has said nothing else: such a run may be over
between two frames."""
STANDS_S = 0.25
"""How long an axis must have stood where a drive says that it has found its home and never that it has reached it."""
AVERAGING_S = 0.5  # a flexible structure swings on after a brake has closed; the mean over some of its periods is its rest position

HOME_OFFSET = 0x607C
HOMING_METHOD, HOMING_SPEEDS, HOMING_ACCELERATION = 0x6098, 0x6099, 0x609A


def commission_axis(
    machine: Machine, axis: int, settings: HomingSettings, holding: np.ndarray, windup: float, load_between: np.ndarray, *, push: bool
) -> list[str]:
    """Check the first move (if `push`), home and check encoder agreement of one axis, all others braked and without voltage.

    Parameters
    ----------
    machine : Machine
    axis : int
    settings : HomingSettings
        Of this axis.
    holding : (n_axes,) array
        Effort that should hold this axis where it is; zero for the others. The first move sets it to what has held it.
    windup : float
        How far the gear's deflection puts the link ahead of the motor side, brake closed [rad or m].
    load_between : (2,) array
        Least and most effort beside `holding` that may hold this axis on a sound machine.
    push : bool
        Whether the axis is moved a little first.

    Returns
    -------
    list of str
        The checks and their findings, a line each.

    Raises
    ------
    MotionRefusedError, DeviceFaultError, BusTimeoutError
    """
    found = []
    power_and_brakes.reset_fault(machine, axis)
    if push and not machine.takes_effort(axis):
        found.append(f"{machine.axes[axis]}: its first move was not checked, because its drive takes no effort: look at its first motion")
    elif push:
        power_and_brakes.set_mode(machine, axis, Mode.CYCLIC_SYNCHRONOUS_TORQUE)
        found.append(make_first_move(machine, axis, settings, holding, load_between))
    home_drive(machine, axis, settings, holding, windup)
    found.append(check_agreement(machine, axis, settings, holding, windup))
    return found


def make_first_move(machine: Machine, axis: int, settings: HomingSettings, holding: np.ndarray, load_between: np.ndarray) -> str:
    """Open the brake of an axis, check that a push moves it the right way, and close it; set `holding` to the effort that held it.

    An axis that moves on under its holding effort is stopped, any brake proven, and it is released anew under the middle of what is left of
    the range in which its load may lie. That takes away half of the doubt, and at least half of what pulls it: one that gains as much as
    before has a reversed motor, or a load outside the range. With no effort left against it, only what encoders disagree by is a motion.

    Returns
    -------
    str
        What was seen, for an operator.

    Raises
    ------
    MotionRefusedError
        It moves on under every holding effort that a sound machine may take, or the wrong way, or not at all; or the link encoder does not
        follow.
    """
    expected, first, before = float(holding[axis]), 0.0, 0.0
    least, most = expected + min(0.0, float(load_between[0])), expected + max(0.0, float(load_between[1]))
    known = SMALLEST_SHARE * (most - least)
    while True:
        machine.watch.stand()
        effort, is_last = float(holding[axis]), most - least <= known
        left = [effort < most and not is_last, effort > least and not is_last]  # another effort, against a motion down and up
        travels = [settings.direction_check_travel if another else settings.agreement_tolerance for another in left]
        released = _Released(machine, axis, holding, travels)
        try:
            power_and_brakes.reach(machine, State.OPERATION_ENABLED, [axis], released)
            power_and_brakes.open_brakes(machine, [axis], released)
            seen, push = check_first_move(machine, axis, settings, released, most)
            holding[axis] += max(0.0, push - settings.direction_check_effort)  # friction takes no more than that: it is load
        except _MovesOnError as motion:
            if not left[motion.moved > 0.0] or motion.acceleration * before > WEAKER * before**2:
                raise _refusal(machine, axis, expected, load_between, effort, motion, first) from None
            machine.rest_axes([axis], None)
            least, most = (effort, most) if motion.moved < 0.0 else (least, effort)
            first, before, holding[axis] = first or motion.acceleration, motion.acceleration, 0.5 * (least + most)
            continue
        power_and_brakes.come_to_rest(machine, [axis], lambda _: holding)
        beside = float(holding[axis]) - expected
        return f"{seen}; what holds it is {beside:+.3g} beside the file's {expected:.3g}" if beside else seen


class _MovesOnError(Exception):
    """An axis moves on under its holding effort alone: how far it has, and how much it gains [rad, rad/s^2 or m, m/s^2]."""

    def __init__(self, moved: float, acceleration: float) -> None:
        super().__init__(f"moves by {moved:+.2e}")
        self.moved, self.acceleration = moved, acceleration


class _Released:
    """Holds an axis by its holding effort alone, from before its brake opens, and raises where it moves on.

    What its load differs from the holding effort by, dry friction takes up, which bends before it slides: such an axis moves a little and
    stands. One that moves by more than `travels`, down and up, is held by nothing.
    """

    def __init__(self, machine: Machine, axis: int, holding: np.ndarray, travels: list[float]) -> None:
        self.holding = holding
        self._machine, self._axis, self._travels = machine, axis, travels
        self._began = self._half = self._half_s = self._last = self._last_s = nan

    def __call__(self, sample: Sample) -> np.ndarray:
        """Return the command that holds."""
        position, now_s = float(sample.position[self._axis]), self._machine.clock.now()
        if not isfinite(position):
            return self.holding
        if not isfinite(self._began):
            self._began = position
        moved = position - self._began
        most = self._travels[moved > 0.0]
        if abs(moved) >= most:
            self._raise(moved, now_s, most)
        if abs(moved) < 0.5 * most:
            self._half = nan
        elif not isfinite(self._half):
            self._half, self._half_s = moved, now_s
        self._last, self._last_s = moved, now_s
        return self.holding

    def _raise(self, moved: float, now_s: float, most: float) -> None:
        """Tell of the motion: its acceleration is that of one that began at rest, from its mean speed over its second half."""
        before, before_s = (self._half, self._half_s) if isfinite(self._half) else (self._last, self._last_s)
        if not now_s > before_s:
            before, before_s = 0.0, now_s - self._machine.period_s
        speed = (moved - before) / (now_s - before_s)
        raise _MovesOnError(moved, copysign(speed**2 / max(abs(moved + before), most), moved))


def _refusal(
    machine: Machine, axis: int, expected: float, load_between: np.ndarray, tried: float, motion: _MovesOnError, first: float
) -> MotionRefusedError:
    """Return the error that tells why no effort holds an axis: what it did under the last one, and had gained under the first."""
    rated, unit = machine.scalings[axis].rated, machine.scalings[axis].position_unit
    load = f"the load is not the {abs(expected) / rated:.0%} of the rated effort that the file says"
    if load_between.any():
        load += f", which its effects change by {load_between[0] / rated:+.0%} to {load_between[1] / rated:+.0%}"
    wrong = "the holding effort is wrong or not given"
    if motion.acceleration * first > WEAKER * first**2:
        wrong += ", or acts the other way (another effort hardly slowed it): motor wiring, encoder direction or the machine file's sign"
    moves = f"moves by {motion.moved:+.2e} {unit} under its holding effort of {tried:.3g} alone"
    return MotionRefusedError(f"{machine.axes[axis]}: {moves}; {wrong}, or {load}")


def check_first_move(machine: Machine, axis: int, settings: HomingSettings, released: _Released, most: float) -> tuple[str, float]:
    """Push an enabled axis, brake open, gently in the positive direction: it must move that way, and its link with it.

    The effort rises from the holding effort to `direction_check_effort` above it, which is more than the friction, and as much further as
    the load may pull that friction has held, up to `most` of its holding effort. It falls back once `direction_check_travel` is reached.

    Returns
    -------
    str
        What was seen, for an operator.
    float
        Effort above holding that it took.

    Raises
    ------
    MotionRefusedError
        It moves the wrong way, or not at all; or the link encoder does not follow.
    """
    name, unit, travel = machine.axes[axis], machine.scalings[axis].position_unit, settings.direction_check_travel
    holding = released.holding
    start, link_start = _stand_released(machine, axis, settings, released)
    pulls = min(settings.direction_check_effort, max(0.0, most - float(holding[axis])))
    push = _push_until_moved(machine, axis, settings, holding, start, settings.direction_check_effort + pulls)
    position, link = _positions(machine, axis, lambda _: holding)
    moved, link_moved = position - start, link - link_start
    if link_moved <= -0.5 * travel or abs(moved - link_moved) > settings.agreement_tolerance:
        raise MotionRefusedError(
            f"{name}: the motor side moved {moved:+.2e} {unit}, its link encoder {link_moved:+.2e}; "
            "the link encoder counts the wrong way, or is not on this axis"
        )
    return f"{name}: moved {moved:+.2e} {unit} when pushed by {push:+.3g}, the right way", push


def _stand_released(machine: Machine, axis: int, settings: HomingSettings, released: _Released) -> tuple[float, float]:
    """Watch an axis under its holding effort alone until it stands; return where its motor side and its link do.

    One that moves on for longer than an axis settles is held by nothing.
    """
    name, unit = machine.axes[axis], machine.scalings[axis].position_unit
    position, _ = _positions(machine, axis, released)
    ends_s = machine.clock.now() + SETTLING_S
    while True:
        before = position
        power_and_brakes.run_for(machine, DRIFT_WATCH_S, released)
        position, link = _positions(machine, axis, released)
        if abs(position - before) < settings.direction_check_travel:
            return position, link
        if machine.clock.now() > ends_s:
            raise MotionRefusedError(
                f"{name}: {SETTLING_S:g} s after its brake opened it still moves by more than {settings.direction_check_travel:.1e} {unit} "
                f"in {DRIFT_WATCH_S:g} s; wait until the structure is at rest, or raise bus.homing.{name}.direction_check_travel"
            )


def _push_until_moved(machine: Machine, axis: int, settings: HomingSettings, holding: np.ndarray, start: float, most: float) -> float:
    """Raise the effort until the axis has moved, at the rate of the check's own push; return the effort above holding that it took."""
    name, unit, travel = machine.axes[axis], machine.scalings[axis].position_unit, settings.direction_check_travel
    rate = settings.direction_check_effort / (RAMP_SHARE * settings.direction_check_timeout_s)
    timeout_s = settings.direction_check_timeout_s * most / settings.direction_check_effort
    command = holding.copy()
    elapsed = 0.0
    while True:
        elapsed += machine.period_s
        push = min(most, rate * elapsed)
        command[axis] = holding[axis] + push
        moved = power_and_brakes.tick(machine, command).position[axis] - start
        if moved >= travel:
            return push
        if moved <= -travel:
            raise MotionRefusedError(
                f"{name}: moved {moved:+.2e} {unit} on a positive effort; "
                "motor wiring, encoder direction or the machine file's sign is reversed, or a load that the file does not know "
                f"outweighs {push / machine.scalings[axis].rated:.2%} of the rated effort"
            )
        if elapsed > timeout_s:
            raise MotionRefusedError(
                f"{name}: moved {moved:+.2e} {unit} where {travel:.2e} was expected within {timeout_s:.1f} s at "
                f"{most:.3g} above its holding effort; brake, friction, a load of "
                f"{most / machine.scalings[axis].rated:.0%} of the rated effort that the file does not know, "
                "or a disconnected motor"
            )


def home_drive(machine: Machine, axis: int, settings: HomingSettings, holding: np.ndarray, windup: float = 0.0) -> None:
    """Run the drive's own homing and take its counter's zero, or that of the absolute link encoder, as the joint's.

    The axis' drive is disabled before and after. Method 0 asks nothing of it: its counter is taken as it is. Methods 35 and
    37 (the present position is home) move nothing: the link encoder, less the
    gear's windup, then gives the motor side's position. Methods that move open the brake while they run; their home offset (607Ch) is set
    in the machine file.

    Raises
    ------
    MotionRefusedError
        The drive reports a homing error, or homing took too long.
    """
    if settings.method == NO_HOMING:
        _take_link_position(machine, axis, holding, windup)
        return
    moves = settings.method not in HOMING_AT_PRESENT_POSITION
    power_and_brakes.set_mode(machine, axis, Mode.HOMING)
    _write_homing(machine, axis, settings, moves)
    offset = int.from_bytes(machine.sdo(axis).read_if_present(HOME_OFFSET) or b"", "little", signed=True)
    machine.resume_ticks()
    machine.watch.stand(sets_counter=None if moves else axis)
    power_and_brakes.reach(machine, State.OPERATION_ENABLED, [axis], lambda _: holding)
    if moves:
        power_and_brakes.open_brakes(machine, [axis], lambda _: holding)
        machine.watch.home(axis, settings)
    _run_homing(machine, axis, settings, holding)
    if moves:
        machine.watch.stand()
        power_and_brakes.come_to_rest(machine, [axis], lambda _: holding)
    else:  # its brake has not been opened since the axis stood without voltage
        power_and_brakes.reach(machine, State.SWITCH_ON_DISABLED, [axis], lambda _: holding)
    if machine.takes_effort(axis):
        power_and_brakes.set_mode(machine, axis, Mode.CYCLIC_SYNCHRONOUS_TORQUE)
    source = machine.inputs[axis]
    source.counter_was_set()
    source.offset = 0.0
    machine.watch.stand()
    position, link = _mean_positions(machine, axis, holding)
    if not moves:
        _check_counter(machine, axis, settings, position, offset)
    if not moves and np.isfinite(link):
        source.offset = link - windup - position
    machine.watch.homed(axis)
    machine.watch.stand()


def _take_link_position(machine: Machine, axis: int, holding: np.ndarray, windup: float) -> None:
    """Take the position of the absolute link encoder, less the gear's windup, for that of the drive's counter as it is."""
    source = machine.inputs[axis]
    source.offset = 0.0
    machine.watch.stand()
    position, link = _mean_positions(machine, axis, holding)
    source.offset = link - windup - position
    machine.watch.homed(axis)
    machine.watch.stand()


def _check_counter(machine: Machine, axis: int, settings: HomingSettings, position: float, offset: int) -> None:
    """Check that homing at the present position has set the drive's counter to the home offset.

    Raises
    ------
    MotionRefusedError
        The counter shows something else than that offset (607Ch), by more than the encoders may disagree.
    """
    scaling = machine.scalings[axis]
    shown = round(scaling.sign * position / scaling.position_resolution)
    if abs(shown - offset) * scaling.position_resolution > settings.agreement_tolerance:
        raise MotionRefusedError(
            f"{machine.axes[axis]}: homing by method {settings.method} has set the counter to {shown} where the home offset (607Ch) is "
            f"{offset}: the drive takes another position for its home than the present one"
        )


def check_agreement(machine: Machine, axis: int, settings: HomingSettings, command: np.ndarray, windup: float = 0.0) -> str:
    """Check that motor side and link encoder give the same position, after subtracting the gear's windup.

    Returns
    -------
    str
        What was seen, for an operator.

    Raises
    ------
    MotionRefusedError
        They differ by more than `agreement_tolerance`.
    """
    name, unit = machine.axes[axis], machine.scalings[axis].position_unit
    position, link = _mean_positions(machine, axis, command)
    link -= windup
    if np.isfinite(link) and abs(position - link) > settings.agreement_tolerance:
        raise MotionRefusedError(
            f"{name}: motor side {position:+.5f} {unit}, link encoder {link:+.5f} {unit}: "
            f"they differ by {abs(position - link):.2e}, {settings.agreement_tolerance:.2e} is allowed; "
            "home anew, or check ratio, resolution and zero_counts"
        )
    if not np.isfinite(link):
        return f"{name}: homed at {position:+.5f} {unit}; it has no link encoder to agree with"
    return f"{name}: homed at {position:+.5f} {unit}; motor side and link encoder differ by {abs(position - link):.1e} {unit}"


def _positions(machine: Machine, axis: int, hold: power_and_brakes.Hold) -> tuple[float, float]:
    """Motor-side and link position of one complete sample; the link's is NaN when the axis has no link encoder."""
    has_link = machine.scalings[axis].link_resolution != 0.0
    deadline = machine.clock.now() + SAMPLE_TIMEOUT_S
    while True:
        sample = power_and_brakes.tick(machine, hold(machine.sample))
        position, link = float(sample.position[axis]), float(sample.link_position[axis])
        if np.isfinite(position) and (np.isfinite(link) or not has_link):
            return position, link
        if machine.clock.now() > deadline:
            silent = "position" if not np.isfinite(position) else "link encoder"
            raise BusTimeoutError(f"{machine.axes[axis]}: no {silent} for {SAMPLE_TIMEOUT_S:.1f} s")


def _mean_positions(machine: Machine, axis: int, command: np.ndarray) -> tuple[float, float]:
    """Return motor-side position and link position, averaged at a standstill in which the structure may still swing."""
    rows = [_positions(machine, axis, lambda _: command) for _ in range(power_and_brakes.ticks_in(machine, AVERAGING_S))]
    position, link = np.mean(rows, axis=0)
    return float(position), float(link)


def _write_homing(machine: Machine, axis: int, settings: HomingSettings, moves: bool) -> None:
    """Write the homing method, and for methods that move, speeds and acceleration in the drive's units."""
    sdo = machine.sdo(axis)
    sdo.write_checked(HOMING_METHOD, 0, settings.method)
    if not moves:
        return
    per_count = machine.scalings[axis].position_resolution
    units = units_of(in_data_sheet(sdo.dictionary, machine.drives[axis].writes), machine.scalings[axis], sdo.who)
    speed, coarse = whole_speed(settings.speed / per_count * units.velocity, f"{sdo.who}: {HOMING_SPEEDS:04X}h")
    machine.notes += coarse
    for subindex in (1, 2):
        sdo.write_checked(HOMING_SPEEDS, subindex, speed)
    if sdo.may_write(HOMING_ACCELERATION):
        sdo.write_checked(HOMING_ACCELERATION, 0, max(1, round(settings.acceleration / per_count * units.acceleration)))


def _run_homing(machine: Machine, axis: int, settings: HomingSettings, command: np.ndarray) -> None:
    is_old = cia402.decode_homing(machine.inputs[axis].statusword) in ATTAINED
    began_s, began = machine.clock.now(), float(machine.sample.position[axis])
    machine.set_controlword(axis, cia402.ENABLE_OPERATION | cia402.HOMING_START)  # rises from the low bit with which it was enabled
    for _ in range(SETTLED_TICKS):
        power_and_brakes.tick(machine, command)
    deadline = machine.clock.now() + settings.timeout_s
    standing = _Standing(machine, axis)
    while True:
        progress = cia402.decode_homing(machine.inputs[axis].statusword)
        is_overdue = settings.method in HOMING_AT_PRESENT_POSITION and machine.clock.now() >= began_s + STALE_S
        is_old = is_old and progress in ATTAINED and not is_overdue
        if progress is Homing.DONE and not is_old:
            break
        if standing.ticks_since(progress is Homing.SETTLING and not is_old) >= power_and_brakes.ticks_in(machine, STANDS_S):
            machine.notes += (f"{machine.axes[axis]}: its drive says {progress.value} for {STANDS_S:g} s at a standstill: taken for homed",)
            break
        failed = progress in (Homing.FAILED, Homing.FAILED_MOVING)
        if failed or machine.clock.now() > deadline:
            reason = progress.value if failed else f"not completed within {settings.timeout_s:.1f} s ({progress.value})"
            if not failed and settings.method not in HOMING_AT_PRESENT_POSITION:
                unit, mean = machine.scalings[axis].position_unit, abs(float(machine.sample.position[axis]) - began) / settings.timeout_s
                reason += f", at {mean:.2g} {unit}/s in the mean where {settings.speed:.2g} {unit}/s were asked for"
            raise MotionRefusedError(f"{machine.axes[axis]}: homing by method {settings.method}: {reason}; the position is not known")
        power_and_brakes.tick(machine, command)
    machine.set_controlword(axis, cia402.ENABLE_OPERATION)


class _Standing:
    """Counts the ticks for which an axis has stood since its drive has said something."""

    def __init__(self, machine: Machine, axis: int) -> None:
        self._machine, self._axis, self._ticks, self._anchor = machine, axis, 0, float("nan")
        self._flicker = STANDSTILL_COUNTS * machine.scalings[axis].position_resolution

    def ticks_since(self, said: bool) -> int:
        """Take the newest sample, and whether it is still said; return the ticks."""
        position = float(self._machine.sample.position[self._axis])
        if said and abs(position - self._anchor) <= self._flicker:
            self._ticks += 1
        else:
            self._ticks, self._anchor = 0, position
        return self._ticks
