"""Time and travel from a fault to standstill: closed forms of one axis at one pose, class by class.

A stop is a row of phases of constant acceleration, the last one down to rest. Gravity, reaction times and brakes act against the stop as
far as they can; friction, which helps, is left out. Springs are rigid: they only exchange momentum between the masses that brake.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True)
class AxisFacts:
    """What decides how fast an axis comes to rest: efforts in Nm or N at its joint, motion in rad or m."""

    speed: float  # at which the fault finds it
    watched_speed: float  # at which the watch over its speed stops it
    acceleration: float  # that the loop may be asking for at that moment
    tracking_error: float
    gravity: float  # largest effort that holds it, either way
    inertia: tuple[float, float]  # kg m^2 or kg: smallest and largest
    drive_effort: float  # greatest of the drive
    quick_stop: float  # rad/s^2 or m/s^2 of the drive's own ramp (6085h)
    brake_effort: float  # 0: no brake
    brake_delay_s: float  # from the command to the full effort
    period_s: float
    stale_s: float  # that a missing position is bridged
    inputs_s: float  # age at which a released switch is seen at the latest
    io_silent_s: float  # that a silent I/O is borne
    node_silent_s: float  # that a silent drive is borne
    bench_silent_s: float  # that the drive bears a silent bench
    drive_late_s: float  # from what the drive is told, or tells itself, to the current that flows

    @property
    def falls(self) -> float:
        """Acceleration of the axis that nobody holds."""
        return self.gravity / self.inertia[0]

    @property
    def brakes(self) -> float:
        """Deceleration by the closed brake alone; negative where the load is too great for it."""
        return (self.brake_effort - self.gravity) / self.inertia[1]

    @property
    def ramps(self) -> float:
        """Deceleration of the quick stop, as far as the drive has the effort for it."""
        return min(self.quick_stop, (self.drive_effort - self.gravity) / self.inertia[1])

    @property
    def closing_s(self) -> float:
        """Time from the stop to the closed brake: the stop is sent with the next tick."""
        return self.period_s + self.brake_delay_s


@dataclass(frozen=True)
class Stop:
    """How an axis comes to rest; infinite where it does not."""

    time_s: float
    travel: float  # rad or m


def run_down(speed: float, phases: tuple[tuple[float, float], ...], deceleration: float, travel: float = 0.0) -> Stop:
    """Return time and travel to rest: phases of (duration, acceleration), then one deceleration until rest."""
    time_s = 0.0
    for duration_s, acceleration in phases:
        if acceleration < 0.0:
            duration_s = min(duration_s, -speed / acceleration)
        travel += (speed + 0.5 * acceleration * duration_s) * duration_s
        speed += acceleration * duration_s
        time_s += duration_s
    if speed <= 0.0:
        return Stop(time_s, travel)
    if deceleration <= 0.0:
        return Stop(math.inf, math.inf)
    return Stop(time_s + speed / deceleration, travel + speed**2 / (2.0 * deceleration))


def _drive_and_brake(axis: AxisFacts, seen_s: float) -> Stop:
    """Let the drive ramp down at once and the brake close over it.

    A drive whose ramp is slower than the brake pushes on, with all it has, to keep to its ramp. One that is late may be later than the
    brake.
    """
    against = 0.0 if axis.quick_stop >= axis.brakes else axis.drive_effort / axis.inertia[1]
    apart_s = axis.closing_s - axis.drive_late_s
    coasts, ramps = (seen_s + min(axis.drive_late_s, axis.closing_s), 0.0), (max(apart_s, 0.0), -axis.ramps)
    return run_down(axis.speed, (coasts, ramps, (max(-apart_s, 0.0), -axis.brakes)), max(axis.ramps, axis.brakes - against))


def _brake_alone(axis: AxisFacts, seen_s: float) -> Stop:
    """Let the axis fall until the brake has closed."""
    return run_down(axis.speed, ((seen_s + axis.closing_s, axis.falls),), axis.brakes)


def _departed(axis: AxisFacts, acceleration: float, deceleration: float) -> Stop:
    """Let the axis depart from its reference until tracking error or speed show it, and on until the brake has closed."""
    gained = min(math.sqrt(2.0 * acceleration * axis.tracking_error), axis.watched_speed - axis.speed)
    departed = gained**2 / (2.0 * acceleration) if acceleration > 0.0 else axis.tracking_error
    phases = ((axis.period_s + axis.closing_s, acceleration),)
    return run_down(axis.speed + gained, phases, deceleration, departed)


def asked(axis: AxisFacts) -> Stop:
    """Stop on the operator's request: hold-to-run, door, Ctrl-C."""
    return _drive_and_brake(axis, axis.inputs_s + axis.period_s)


def position_lost(axis: AxisFacts) -> Stop:
    """Stop after the motor side's position is missing."""
    return _drive_and_brake(axis, axis.stale_s + axis.period_s)


def drive_fault(axis: AxisFacts) -> Stop:
    """Stop after the drive reported a fault that took its torque."""
    return _brake_alone(axis, axis.period_s)


def node_silent(axis: AxisFacts) -> Stop:
    """Stop after the drive fell silent, its torque gone; the tracking error may show it first."""
    departs_s = math.sqrt(2.0 * axis.tracking_error / axis.falls) if axis.falls > 0.0 else math.inf
    return _brake_alone(axis, min(axis.node_silent_s, departs_s + axis.period_s))


def torque_lost(axis: AxisFacts) -> Stop:
    """Stop after torque is lost and nothing says so."""
    return _departed(axis, axis.falls, axis.brakes)


def runaway(axis: AxisFacts) -> Stop:
    """Stop a drive that pushes with all it has, whatever the cause, and goes on pushing against the brake."""
    pushes = (axis.drive_effort + axis.gravity) / axis.inertia[0]
    return _departed(axis, pushes, axis.brakes - axis.drive_effort / axis.inertia[1])


def io_silent(axis: AxisFacts) -> Stop:
    """Stop after the I/O fell silent: no brake can be commanded, the drive stops by itself."""
    return run_down(axis.speed, ((axis.io_silent_s + axis.period_s + axis.drive_late_s, 0.0),), axis.ramps)


def bench_silent(axis: AxisFacts) -> Stop:
    """Stop after the bench fell silent: the drive keeps its last torque until it notices, and stops by itself."""
    return run_down(axis.speed, ((axis.bench_silent_s + axis.drive_late_s, axis.acceleration),), axis.ramps)


CLASSES: dict[str, Callable[[AxisFacts], Stop]] = {
    "asked": asked,
    "position_lost": position_lost,
    "drive_fault": drive_fault,
    "node_silent": node_silent,
    "torque_lost": torque_lost,
    "runaway": runaway,
    "io_silent": io_silent,
    "bench_silent": bench_silent,
}
"""Classes of faults, as the machine file's [budgets.AXIS] calls them."""
