"""Whether two encoders of one axis agree: what the one on the load differs by from the one on the motor."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from hil.diagnosis.audit.readings import FEWEST_ROWS
from hil.machine import Machine
from hil.recording import Recording

STEPS = 3.0
"""Lattice steps of both encoders together that a difference is at least."""
GAIN, DELAY = 1e-3, 0.25
"""Of a ratio, and of a delay in rows: what linear interpolation and a worn gear make of two encoders that agree."""
HALF = 0.5
"""Of what position, speed, acceleration and effort leave of the difference, that two sides must leave for there to be play: a shaft winds
up in proportion, and a gap has two ends. Of both the median size counts: on its way from one end to the other play is on neither."""
WRONG_UNIT = 2.0
"""Ratio of two encoders of one axis, or its inverse, from which one of them counts in another unit: no gear errs by so much."""
PASSES = 50
"""Of the division into two sides; a dozen are enough."""
SPAN = 5
"""Rows that a speed is taken over."""


NAMES = ("first", "second", "speed", "acceleration", "effort")


@dataclass(frozen=True, eq=False)
class _Pair:
    """One recording's readings of both (N,), speed and acceleration of the first, and the drive's effort (0 where there is none)."""

    first: np.ndarray
    second: np.ndarray
    speed: np.ndarray
    acceleration: np.ndarray
    effort: np.ndarray
    period_s: float


@dataclass(frozen=True)
class SensorAudit:
    """What two encoders of an axis differ by.

    Attributes
    ----------
    first, second : str
        Channels: motor side, load side.
    gain : float
        Of the second over the first.
    delay_s : float
        How late the second is.
    gap : float
        Play between both, from one end to the other [rad or m]; 0 where there is none.
    scatter : float
        Median distance from the nearer end of the play [rad or m].
    offset : float
        [rad or m].
    status : "as_filed", "differs"
    said : str
        In one sentence.
    """

    first: str
    second: str
    gain: float
    delay_s: float
    gap: float
    scatter: float
    offset: float
    status: Literal["as_filed", "differs"]
    said: str

    @property
    def is_wrong(self) -> bool:
        """Whether one of both counts the other way round, or in another unit, which no effect makes of it."""
        return not 1.0 / WRONG_UNIT < self.gain < WRONG_UNIT


def audit_sensors(machine: Machine, recordings: Sequence[Recording]) -> list[SensorAudit]:
    """Audit every axis both of whose encoders read the same joints and were recorded on even rows."""
    found = []
    steps = {encoder.channel: encoder.resolution for encoder in machine.plant.encoders}
    joints = {encoder.channel: tuple(encoder.joints) for encoder in machine.plant.encoders}
    for units in machine.units:
        pair = f"position_{units.axis}", f"link_position_{units.axis}"
        both = [recording for recording in recordings if all(name in recording for name in pair)]
        rows = [part for recording in both if (part := _part(recording, pair)) is not None]
        if rows and all(name in steps for name in pair) and joints[pair[0]] == joints[pair[1]]:
            found.append(_audited(pair, units.position, sum(steps[name] for name in pair), rows))
    return found


def _part(recording: Recording, pair: tuple[str, str]) -> _Pair | None:
    gaps = np.diff(recording.time)
    if len(gaps) < FEWEST_ROWS or not recording.is_even:
        return None
    first, second = (recording[name] for name in pair)
    period = float(gaps.mean())
    speed, acceleration = np.zeros(len(first)), np.zeros(len(first))
    speed[SPAN:-SPAN] = (first[2 * SPAN :] - first[: -2 * SPAN]) / (2.0 * SPAN * period)
    acceleration[SPAN:-SPAN] = (first[2 * SPAN :] - 2.0 * first[SPAN:-SPAN] + first[: -2 * SPAN]) / (SPAN * period) ** 2
    axis = pair[0].removeprefix("position_")
    efforts = [recording[name] for name in (f"current_{axis}", f"effort_{axis}", f"command_{axis}") if name in recording]
    effort = np.nan_to_num(efforts[0]) if efforts else np.zeros(len(first))
    used = np.isfinite(first) & np.isfinite(second) & np.isfinite(speed) & np.isfinite(acceleration)
    used[:SPAN] = used[-SPAN:] = False
    if used.sum() < FEWEST_ROWS or np.ptp(first[used]) == 0.0:
        return None
    return _Pair(first[used], second[used], speed[used], acceleration[used], effort[used], period)


def _audited(pair: tuple[str, str], unit: str, step: float, parts: Sequence[_Pair]) -> SensorAudit:
    first, second, speed, acceleration, effort = (np.concatenate([getattr(part, name) for part in parts]) for name in NAMES)
    apart = second - first
    smooth = np.column_stack([first, speed, np.ones(len(first)), acceleration, effort])
    scale = np.maximum(np.abs(smooth).max(axis=0), 1e-300)
    weights = np.linalg.lstsq(smooth / scale, apart, rcond=None)[0] / scale
    windup = apart - smooth @ weights
    gap, played = _two_sides(apart)
    gain, delay, offset = 1.0 + float(weights[0]), -float(weights[1]), float(weights[2])
    wrong = []
    if played < HALF * float(np.median(np.abs(windup))) and gap > STEPS * step:
        gain, delay, offset = 1.0, 0.0, float(np.median(apart))
        wrong.append(f"on one of two sides, {gap:.3g} {unit} apart: there is play between both")
    else:
        gap = 0.0
        if abs(gain - 1.0) > GAIN and abs(gain - 1.0) * float(np.ptp(first)) > STEPS * step:
            wrong.append(f"{gain:.4f} times as large")
        if abs(delay) > DELAY * parts[0].period_s and abs(delay) * float(np.abs(speed).max()) > STEPS * step:
            wrong.append(f"{1e3 * delay:.3g} ms late")
    said = f"{pair[1]}: beside {pair[0]} it is " + (", ".join(wrong) if wrong else "what the file says")
    return SensorAudit(*pair, gain, delay, gap, played, offset, "differs" if wrong else "as_filed", said)


def _two_sides(apart: np.ndarray) -> tuple[float, float]:
    """Return how far two sides lie apart between which values are best divided, and the median distance from them (2-medians)."""
    middle = 0.5 * (float(apart.min()) + float(apart.max()))
    for _ in range(PASSES):
        above = apart > middle
        if above.all() or not above.any():
            return 0.0, np.inf
        low, high = float(np.median(apart[~above])), float(np.median(apart[above]))
        middle = 0.5 * (low + high)
    above = apart > middle
    return high - low, float(np.median(np.abs(np.where(above, apart - high, apart - low))))
