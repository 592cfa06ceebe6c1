"""Repeats of one experiment beside their simulation."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from hil.diagnosis.residuals.carried import CarriedImu
from hil.machine import Machine
from hil.simulation import Inputs

LONG_GAP = 4
"""Rows from which on others are asked: over fewer no residual leaves the line."""

BENT = 3.0
"""Times the rms of what noise does over a gap's length that the others' residual must leave a line there to be followed."""

NEAR = 5
"""Gap lengths to either side of it, where noise says how strong it is there."""

STRONG = 0.75
"""Share of the stretches there whose noise is less: some may be at rest, and some hold a reading that is off."""

STRETCHES = 200
"""That are looked at, and rows of each, about."""


@dataclass(frozen=True, eq=False)
class RepeatGroup:
    """R repeats of N rows of one experiment, and its simulation.

    Attributes
    ----------
    labels : tuple of str
        What each repeat is called: the recording's name, with the period's number where it is one.
    machine : Machine
        The diagnosed machine, with the controller of these recordings where their own machine file has another one.
    inputs : Inputs
        What drives the simulation of the whole recording.
    windows : tuple of slice
        Rows of that simulation the repeats stand for; more than one for periods.
    time_s : (N,) array
    measured : (R, N, C) array
        NaN where a sample is missing.
    simulated : (N, C) array
        Noise off, averaged over the windows.
    position, speed, effort, reference : (N, n_axes) arrays
        For binning: mean over the repeats of what was measured (effort in the drive's unit); the reference is the position's own where a
        machine has no controller.
    imu : CarriedImu, optional
        What the encoders say of the IMU along this motion; none where one of both is not recorded.
    lost : (R, N, C) array, optional
        How far readings that were lost, and were taken out of `measured`, were from what stands in their place; zero elsewhere.
    """

    labels: tuple[str, ...]
    machine: Machine
    inputs: Inputs
    windows: tuple[slice, ...]
    time_s: np.ndarray
    measured: np.ndarray
    simulated: np.ndarray
    position: np.ndarray
    speed: np.ndarray
    effort: np.ndarray
    reference: np.ndarray
    imu: CarriedImu | None = None
    lost: np.ndarray | None = None

    @property
    def repeats(self) -> int:
        return len(self.measured)

    @property
    def mean(self) -> np.ndarray:
        """(N, C) mean of the repeats, complete."""
        return self.complete.mean(axis=0)

    @cached_property
    def complete(self) -> np.ndarray:
        """(R, N, C) measured, a missing sample replaced by the simulation plus the residual interpolated in time; where the other repeats'
        residual leaves its own line over a gap by more than noise does, by as much more.
        """
        read = self.measured - self.simulated
        residual = read.copy()
        for r, c in np.argwhere(np.isnan(read).any(axis=1)):
            missing = np.isnan(read[r, :, c])
            if missing.all():
                residual[r, :, c] = 0.0
                continue
            bent = _bent_in_others(read[:, :, c], r, self.time_s)
            residual[r, missing, c] = np.interp(self.time_s[missing], self.time_s[~missing], read[r, ~missing, c]) + bent[missing]
        return residual + self.simulated

    def without(self, kept: np.ndarray) -> RepeatGroup:
        """With those readings (R, N, C) alone that were not lost, NaN in place of these."""
        bare = replace(self, measured=kept)
        gone = np.isnan(kept) & ~np.isnan(self.measured)
        return replace(bare, lost=np.where(gone, self.measured - bare.complete, 0.0))

    def fold(self, rows: np.ndarray) -> np.ndarray:
        """Simulated rows of the whole recording (M, C) as those of the repeats (N, C); of one window a part of them, not a copy."""
        return rows[self.windows[0]] if len(self.windows) == 1 else np.mean([rows[window] for window in self.windows], axis=0)


def _bent_in_others(residual: np.ndarray, repeat: int, time_s: np.ndarray) -> np.ndarray:
    """(N,) by how much the mean of the other repeats' residual (R, N) leaves the line over each of one repeat's gaps, where that is more
    than noise does: of those others that read the gap and both of its ends.

    Where it is less, the line is the better guess: it copies none of their noise.
    """
    missing = np.isnan(residual[repeat])
    bent, others = np.zeros(len(missing)), np.delete(residual, repeat, axis=0)
    edges = np.flatnonzero(np.diff(np.pad(missing.astype(int), 1)))
    for begin, end in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
        if begin == 0 or end == len(missing) or end - begin < LONG_GAP:
            continue
        there = others[:, begin - 1 : end + 1]
        there = there[~np.isnan(there).any(axis=1)]
        if not len(there):
            continue
        off = _off_the_line(there.mean(axis=0), time_s[begin - 1 : end + 1])
        if np.sqrt(np.mean(off**2)) > BENT * _noise_over(residual, begin - 1, end + 1):
            bent[begin:end] = off
    return bent


def _off_the_line(values: np.ndarray, time_s: np.ndarray) -> np.ndarray:
    """(..., M - 2) of values (..., M), how far those between the ends are from the line between them."""
    share = (time_s - time_s[0]) / (time_s[-1] - time_s[0])
    line = values[..., :1] + (values[..., -1:] - values[..., :1]) * share
    return np.asarray((values - line)[..., 1:-1])


def _noise_over(residual: np.ndarray, begin: int, end: int) -> float:
    """How far over as many rows as these one repeat (R, N) is from the line between its ends by what others have not, rms: around them, at
    least what it is in the middle everywhere; infinite where that is not known.

    A machine that rests most of the time may differ in motion alone; a single reading that is off does not say how strong noise is.
    """
    known, rows = residual[~np.isnan(residual).all(axis=1)], end - begin
    if len(known) < 2:
        return np.inf
    apart = known - np.roll(known, 1, axis=0)
    near = slice(max(begin - NEAR * rows, 0), end + NEAR * rows)
    around, everywhere = _squares(apart[:, near], rows), _squares(apart, rows)
    if not len(around):
        return np.inf
    return float(np.sqrt(max(np.quantile(around, STRONG), np.median(everywhere)) / 2.0))


def _squares(apart: np.ndarray, rows: int) -> np.ndarray:
    """Mean squares of what differences (R, N) have beside the line between the ends of stretches of so many rows that are read whole."""
    windows = np.lib.stride_tricks.sliding_window_view(apart, rows, axis=1)
    windows = windows[:, :: max(1, windows.shape[1] // STRETCHES)]
    at = np.unique(np.linspace(0, rows - 1, min(rows, STRETCHES)).astype(int))
    off = _off_the_line(windows[..., at], at.astype(float))
    return np.asarray(np.mean(off[np.isfinite(off).all(axis=2)] ** 2, axis=1))
