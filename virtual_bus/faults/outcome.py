"""What became of a machine after a fault, from its true motion: pure functions of the log."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from virtual_bus.canopen.power_state import PowerState
from virtual_bus.faults.condition import STILL_SPEED
from virtual_bus.faults.machine import REST_S
from virtual_bus.faults.motion_log import HOLDING, MotionLog

SWING_S = 0.25
"""Time that tells standstill from a turning point: two periods of the slowest vibration."""

Ending = Literal["moving", "held by its brake", "held by its drive", "held by both", "at rest, held by nothing"]


@dataclass(frozen=True)
class AxisOutcome:
    """What became of one axis.

    Parameters
    ----------
    axis : str
    ending : str
        Whether it is at rest at the end of the log, and what holds it.
    rest_s : float
        Time from the fault to rest [s]; NaN: it is not at rest.
    travel : float
        Way along its path from the fault to rest, or to the end of the log [rad or m].
    furthest : float
        Greatest distance from where it was at the fault [rad or m].
    fastest : float
        Greatest speed after the fault [rad/s or m/s].
    """

    axis: str
    ending: Ending
    rest_s: float
    travel: float
    furthest: float
    fastest: float

    @property
    def at_rest(self) -> bool:
        """Whether it is."""
        return self.ending != "moving"


@dataclass(frozen=True)
class FaultOutcome:
    """What became of a machine after a fault.

    Parameters
    ----------
    onset_s : float
        Machine time [s] from which motion is counted.
    watched_s : float
        How long the truth was watched after it.
    axes : tuple of AxisOutcome
    """

    onset_s: float
    watched_s: float
    axes: tuple[AxisOutcome, ...]

    @property
    def at_rest(self) -> bool:
        """Whether every axis is at rest."""
        return all(axis.at_rest for axis in self.axes)

    def of(self, axis: str) -> AxisOutcome:
        """Return what became of an axis."""
        return next(outcome for outcome in self.axes if outcome.axis == axis)


@dataclass(frozen=True)
class Standstill:
    """When an axis came to stand, and how far it went until then."""

    time_s: float  # infinite where it did not
    travel: float  # along its path [rad or m]


def standstill_of(log: MotionLog, axis: str, onset_s: float, moved: float, *, from_stop: bool) -> Standstill:
    """Return when an axis came to stand: from there it moves by no more than `moved` for `SWING_S`.

    A brake's proof comes after that, and may move it by a little again.

    Parameters
    ----------
    log : MotionLog
    axis : str
    onset_s : float
        Machine time of the fault [s].
    moved : float
        What counts as a motion [rad or m].
    from_stop : bool
        Count from the first instant after the fault at which some drive is told to stop, instead of from the fault.
    """
    position, time_s = log.position[:, log.axes.index(axis)], log.time_s
    first = int(np.searchsorted(time_s, onset_s - 1e-9))
    if from_stop:
        led = log.drive[first:] == PowerState.OPERATION_ENABLED
        left = np.flatnonzero((led[0] & ~led).any(axis=1)) if len(led) else np.zeros(0)
        first += int(left[0]) if len(left) else 0
    rows = int(np.searchsorted(time_s, time_s[0] + SWING_S))
    if len(position) - first <= rows:
        return Standstill(math.inf, math.inf)
    stands = np.flatnonzero(np.ptp(np.lib.stride_tricks.sliding_window_view(position[first:], rows + 1), axis=1) <= moved)
    if not len(stands):
        return Standstill(math.inf, math.inf)
    last = first + int(stands[0])
    return Standstill(float(time_s[last] - time_s[first]), float(np.abs(np.diff(position[first : last + 1])).sum()))


def outcome_of(log: MotionLog, onset_s: float, standing: Sequence[float]) -> FaultOutcome:
    """Return what became of every axis from a time on.

    An axis is at rest from the last instant at which it was faster than `STILL_SPEED`, if that is `REST_S` or more before the log ends. One
    that its drive holds, and shakes by its noise, is so too from when it stays within the range of an axis that stands.

    Parameters
    ----------
    log : MotionLog
    onset_s : float
        Machine time [s].
    standing : sequence of float
        By axis: how far one may swing that stands, as its stop judges it [rad or m].

    Raises
    ------
    ValueError
        The log has no row at or after that time.
    """
    time_s = log.time_s
    after = np.flatnonzero(time_s >= onset_s - 1e-9)
    if not len(after):
        raise ValueError(f"the log of {len(log)} rows ends before {onset_s} s")
    first = int(after[0])
    time_s, position, speed = time_s[first:], log.position[first:], log.speed[first:]
    last_brake, last_drive = log.brake[-1], log.drive[-1]
    axes = tuple(
        _axis_outcome(axis, time_s, position[:, index], speed[:, index], last_brake[index], int(last_drive[index]), standing[index])
        for index, axis in enumerate(log.axes)
    )
    return FaultOutcome(onset_s, float(time_s[-1] - time_s[0]), axes)


def _axis_outcome(
    axis: str, time_s: np.ndarray, position: np.ndarray, speed: np.ndarray, brake: float, drive: int, standing: float
) -> AxisOutcome:
    fast = np.flatnonzero(np.abs(speed) > STILL_SPEED)
    last = int(fast[-1]) if len(fast) else 0
    at_rest = not len(fast) or time_s[-1] - time_s[last] >= REST_S
    by_brake, by_drive = brake > 0.0, drive in HOLDING
    if by_drive and not at_rest:
        to_come = position[::-1]
        away = np.flatnonzero((np.maximum.accumulate(to_come) - np.minimum.accumulate(to_come))[::-1] > standing)
        last = int(away[-1]) if len(away) else 0
        at_rest = bool(time_s[-1] - time_s[last] >= REST_S)
    until = min(last + 1, len(time_s) - 1) if at_rest else len(time_s) - 1
    way = position[: until + 1]
    return AxisOutcome(
        axis,
        _ending(at_rest, by_brake, by_drive),
        (float(time_s[last] - time_s[0]) if at_rest else math.nan),
        float(np.abs(np.diff(way)).sum()),
        float(np.abs(way - way[0]).max()),
        float(np.abs(speed).max()),
    )


def _ending(at_rest: bool, by_brake: bool, by_drive: bool) -> Ending:
    if not at_rest:
        return "moving"
    if by_brake:
        return "held by both" if by_drive else "held by its brake"
    return "held by its drive" if by_drive else "at rest, held by nothing"
