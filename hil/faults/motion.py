"""What moves an axis while the table of faults is tried: a recorded scan, a move to a pose, or the homing of its drive."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from drivers.canopen.cia402 import HOMING_AT_PRESENT_POSITION, NO_HOMING
from hil.bench.bench import Bench
from hil.errors import ExperimentError, UnusableInputError
from hil.experiments import Move, Plan, Scan
from hil.machine import Machine

SPEED = 0.4
"""rad/s or m/s of the scan: that of a C-arm; half the axis's limit where that is less."""
SPEED_SHARE = 0.5
SWEEP_S = 1.25
"""The sweep is this long at its speed: the fault comes when it has accelerated, and most are seen within tenths of a second."""
FORTH_SHARE = 0.4
"""Share of the sweep before the middle of the axis's range: an arm is not balanced at its end."""
DWELL_S = 0.25
SEARCH_S = 2.0
"""A homing run searches this long for its switch, as long as the range has room for it."""

MotionName = Literal["scan", "move", "homing"]
MOTIONS: dict[MotionName, str] = {
    "scan": "a recorded scan of {axis} at {speed:.2f} {unit}/s",
    "move": "a move of {axis} to a pose at up to {speed:.2f} {unit}/s",
    "homing": "a homing run of {axis} at {speed:.3f} {unit}/s",
}
"""What moves the axis, in words; the speed is the greatest."""


@dataclass(frozen=True)
class Motion:
    """A motion of one axis of a machine that stands at `start_pose`.

    Parameters
    ----------
    name : str
    start_pose : (n_axes,) array
        [rad or m]
    speed : float
        Greatest of the axis on its way [rad/s or m/s].
    rows : int
        Of the recording; 0: nothing is recorded.
    make : callable
        Makes it on a bench, with the path of its recording; returns what is noted, and what is judged of the sensors, a line each.
    """

    name: MotionName
    start_pose: np.ndarray
    speed: float
    rows: int
    make: Callable[[Bench, Path], tuple[tuple[str, ...], tuple[str, ...]]]


def motion_of(machine: Machine, axis: str, name: MotionName = "scan") -> Motion:
    """Return the motion of an axis by its name.

    Raises
    ------
    UnusableInputError
        The machine cannot make it.
    """
    return {"scan": _scan, "move": _move, "homing": _homing}[name](machine, axis)


def standard_scan(machine: Machine, axis: str) -> tuple[Plan, float]:
    """Return the plan of a short sweep of an axis about the middle of its range, and its speed [rad/s or m/s].

    Raises
    ------
    UnusableInputError
        The machine cannot make it.
    """
    limit = machine.limits[machine.axis_index(axis)]
    speed = min(SPEED, SPEED_SHARE * limit.speed)
    middle, way = 0.5 * (limit.lower + limit.upper), min(speed * SWEEP_S, 0.5 * (limit.upper - limit.lower))
    begin = middle + FORTH_SHARE * way
    try:
        (plan,) = Scan(axis, begin, begin - way, speed, dwell_s=DWELL_S).plans(machine)
    except ExperimentError as error:
        raise UnusableInputError(f"{machine.name}: the sweep of {axis} that the table of faults runs: {error}") from None
    return plan, speed


def _scan(machine: Machine, axis: str) -> Motion:
    plan, speed = standard_scan(machine, axis)

    def make(bench: Bench, path: Path) -> tuple[tuple[str, ...], tuple[str, ...]]:
        timing = bench.run(plan, path)
        return timing.notes, timing.judged

    return Motion("scan", plan.start_pose, speed, plan.rows, make)


def _move(machine: Machine, axis: str) -> Motion:
    """Return a move about the middle of the range, as long as it takes to reach the greatest speed and to keep it for a while."""
    number = machine.axis_index(axis)
    limit = machine.limits[number]
    half = 0.5 * min(limit.speed**2 / limit.acceleration + limit.speed * DWELL_S, 0.8 * (limit.upper - limit.lower))
    middle = 0.5 * (limit.lower + limit.upper)
    start, goal = np.zeros(len(machine.axes)), np.zeros(len(machine.axes))
    start[number], goal[number] = middle + half, middle - half
    by_itself = machine.bus is not None and machine.bus.scalings[number].mode == "profile_position"
    if by_itself:
        speed = min(limit.speed, math.sqrt(2.0 * half * limit.acceleration))
    else:
        try:
            (plan,) = Move({axis: start[number]}, {axis: goal[number]}).plans(machine)
        except ExperimentError as error:
            raise UnusableInputError(f"{machine.name}: the move of {axis} that the table of faults makes: {error}") from None
        speed = float(np.abs(np.diff(plan.reference[:, number])).max()) * machine.sample_rate_Hz

    def make(bench: Bench, path: Path) -> tuple[tuple[str, ...], tuple[str, ...]]:
        bench.move(goal)
        return bench.wiring.link.remarks, bench.judged

    return Motion("move", start, speed, 0, make)


def _homing(machine: Machine, axis: str) -> Motion:
    """Return the commissioning of a machine whose axis stands before its reference, as its drive's homing method searches it."""
    number = machine.axis_index(axis)
    assert machine.bus is not None  # a machine without one has no faults
    homing, limit = machine.bus.homings[number], machine.limits[number]
    if homing.method in (*HOMING_AT_PRESENT_POSITION, NO_HOMING):
        raise UnusableInputError(f"{machine.name}: {axis} homes by method {homing.method}, which moves nothing; 17, 18, 33 and 34 do")
    ahead = min(homing.speed * SEARCH_S, 0.4 * (limit.upper - limit.lower))
    sign = machine.bus.scalings[number].sign  # the drive's negative end is the axis's upper one where its direction is the other
    ends = (limit.lower + ahead, limit.upper - ahead)[::sign]
    start = np.zeros(len(machine.axes))
    start[number] = dict(zip((17, 18), ends, strict=True)).get(homing.method, 0.5 * (limit.lower + limit.upper))

    def make(bench: Bench, path: Path) -> tuple[tuple[str, ...], tuple[str, ...]]:
        bench.commission()
        return bench.wiring.link.remarks, bench.judged

    return Motion("homing", start, homing.speed, 0, make)
