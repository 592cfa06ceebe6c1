"""The noise of a recording's channels, in which a simulation's differences from it are counted.

It is the scatter between repeats of the experiment where there are some, else between the recording's own periods. With neither it is
assumed: what changes from row to row in what no filter of the simulated channel explains, since noise does not follow the simulation and a
wrong model errs smoothly; but not less than the rounding to the sensor's resolution. An axis is homed, and held by its feedback, to a
count or two of its encoder, so that its positions are known to two counts of the coarser one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from hil.errors import RecordingError
from hil.recording import Recording

NoiseSource = Literal["repeats", "periods", "assumed"]

ROUNDING = 1e-9
"""Least noise of any channel, in its unit and as a share of its largest value: less is the arithmetic's."""

ON_A_LATTICE = 0.05
"""Share of a step within which values are its multiples where a sensor rounds."""

TAPS = 5
"""Rows to either side over which a filter of the simulated channel reaches: an error of gain, of delay, or of a fast mode."""

HELD_COUNTS = 2.0
"""Counts of its encoder to which an axis is homed and held."""

OFTEN = 10
"""Times that each value must come on average where fewer than `MANY` differ, for a step between them to be the sensor's resolution."""

MANY = 10


@dataclass(frozen=True)
class Noise:
    """Where the noise of a recording is from, and how many repeats or periods tell it."""

    source: NoiseSource
    count: int

    @property
    def said(self) -> str:
        """Return the source in words."""
        if self.source == "assumed":
            return "assumed, from each channel's roughness and resolution; --repeat REC or periods would show it"
        return f"from {self.count} {self.source}"


def noise_source(recording: Recording, repeats: Sequence[Recording] = ()) -> Noise:
    """Return where the noise of a recording is known from.

    Raises
    ------
    RecordingError
        A recording among `repeats` is none of this experiment.
    """
    for number, other in enumerate(repeats, start=1):
        if not recording.repeats(other):
            raise RecordingError(
                f"repeat {number} is another experiment: a repeat has the same reference, excitation, start pose and machine file"
            )
    if repeats:
        return Noise("repeats", 1 + len(repeats))
    periods = _whole_periods(recording)
    return Noise("periods", len(periods)) if len(periods) > 1 else Noise("assumed", 0)


def channel_noise(name: str, recording: Recording, simulated: np.ndarray, noise: Noise, repeats: Sequence[Recording] = ()) -> float:
    """Return the standard deviation of a channel's noise in one row, in its unit.

    Parameters
    ----------
    name : str
    recording : Recording
    simulated : (N,) array
        The channel in the simulation.
    noise : Noise
        From `noise_source` of the same recordings.
    repeats : sequence of Recording
    """
    values = recording[name]
    least = ROUNDING * max(float(np.nanmax(np.abs(values), initial=0.0)), 1.0)
    least = max(least, resolution(values) / np.sqrt(12.0))
    if noise.source == "assumed" and (axis := name.removeprefix("link_")).startswith("position_"):
        least = max(
            least, *(HELD_COUNTS * resolution(recording[channel]) for channel in (axis, f"link_{axis}") if channel in recording), 0.0
        )
    if noise.source == "repeats":
        found = _scatter(np.stack([values, *(other[name] for other in repeats if name in other)]))
    elif noise.source == "periods":
        found = _scatter(np.stack([values[rows] for rows in _whole_periods(recording)]))
    else:
        steps = np.diff(_not_explained(values, simulated))
        found = float(np.sqrt(np.mean(steps**2) / 2.0)) if steps.size else 0.0
    return float(max(found, least))


def resolution(values: np.ndarray) -> float:
    """Return the step to whose multiples a sensor rounds; 0 where values (N,) lie on no lattice, or too few differ to tell."""
    distinct = np.unique(values[np.isfinite(values)])
    gaps = np.diff(distinct)
    gaps = gaps[gaps > 1e-12 * np.abs(distinct).max(initial=0.0)]
    if not len(gaps) or (len(distinct) < MANY and values.size < OFTEN * len(distinct)):
        return 0.0
    step = float(gaps.min())
    multiples = gaps / step
    if np.abs(multiples - np.rint(multiples)).max() > ON_A_LATTICE:
        return 0.0
    return float(np.mean(gaps / np.rint(multiples)))


def _not_explained(values: np.ndarray, simulated: np.ndarray) -> np.ndarray:
    """Return what a least-squares filter of the simulated channel (N,) does not explain of the recorded one (N,), whole rows only."""
    if len(values) <= 8 * TAPS:
        difference: np.ndarray = simulated - values
        known: np.ndarray = difference[np.isfinite(difference)]
        return known
    shifted = np.lib.stride_tricks.sliding_window_view(simulated, 2 * TAPS + 1)
    middle = values[TAPS : len(values) - TAPS]
    whole = np.isfinite(middle) & np.isfinite(shifted).all(axis=1)
    if not whole.any():
        return np.zeros(0)
    basis = np.column_stack([shifted[whole] - shifted[whole].mean(), np.ones(int(whole.sum()))])
    explained = basis @ np.linalg.lstsq(basis, middle[whole], rcond=1e-10)[0]
    left: np.ndarray = middle[whole] - explained
    return left


def _whole_periods(recording: Recording) -> tuple[slice, ...]:
    try:
        return recording.period_slices
    except RecordingError:  # not periodic
        return ()


def _scatter(rows: np.ndarray) -> float:
    """Return the standard deviation of one of several (n, N) about their mean, rows without a value left out."""
    whole = rows[:, np.isfinite(rows).all(axis=0)]
    if len(whole) < 2 or not whole.size:
        return 0.0
    return float(np.sqrt(np.mean(np.var(whole, axis=0, ddof=1))))
