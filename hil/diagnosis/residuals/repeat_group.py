"""Repeats of one experiment beside their simulation."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from hil.diagnosis.residuals.carried import CarriedImu
from hil.machine import Machine
from hil.simulation import Inputs

BENT = 3.0
"""Times what repeats differ by from row to row, rms, that the others' residual must leave a line over a gap to be followed there."""


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
        """(R, N, C) measured, a missing sample replaced by the simulation plus the residual interpolated in time; of a gap over which the
        residual of the other repeats does not go straight, by what they read there and this one reads more around it.
        """
        residual = self.measured - self.simulated
        for r, c in np.argwhere(np.isnan(residual).any(axis=1)):
            missing = np.isnan(residual[r, :, c])
            if missing.all():
                residual[r, :, c] = 0.0
                continue
            bent = _bent_in_others(residual[:, :, c], r)
            residual[r, missing, c] = np.interp(self.time_s[missing], self.time_s[~missing], residual[r, ~missing, c]) + bent[missing]
        return residual + self.simulated

    def without(self, kept: np.ndarray) -> RepeatGroup:
        """With those readings (R, N, C) alone that were not lost, NaN in place of these."""
        bare = replace(self, measured=kept)
        gone = np.isnan(kept) & ~np.isnan(self.measured)
        return replace(bare, lost=np.where(gone, self.measured - bare.complete, 0.0))

    def fold(self, rows: np.ndarray) -> np.ndarray:
        """Simulated rows of the whole recording (M, C) as those of the repeats (N, C); of one window a part of them, not a copy."""
        return rows[self.windows[0]] if len(self.windows) == 1 else np.mean([rows[window] for window in self.windows], axis=0)


def _bent_in_others(residual: np.ndarray, repeat: int) -> np.ndarray:
    """(N,) by how much the mean of the other repeats' residual (R, N) leaves the line over each of one repeat's gaps, where that is more
    than what they differ by: of those others that read the gap and both of its ends.

    Where it is less, the line is the better guess: it copies none of their noise.
    """
    missing = np.isnan(residual[repeat])
    bent, least = np.zeros(len(missing)), BENT * _differ_by(residual)
    edges = np.flatnonzero(np.diff(np.pad(missing.astype(int), 1)))
    for begin, end in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
        if begin == 0 or end == len(missing):
            continue
        there = np.delete(residual, repeat, axis=0)[:, begin - 1 : end + 1]
        there = there[~np.isnan(there).any(axis=1)]
        if not len(there):
            continue
        line = np.linspace(0.0, 1.0, end - begin + 2)
        off = there.mean(axis=0) - there[:, 0].mean() - (there[:, -1].mean() - there[:, 0].mean()) * line
        if np.sqrt(np.mean(off[1:-1] ** 2)) > least:
            bent[begin:end] = off[1:-1]
    return bent


def _differ_by(residual: np.ndarray) -> float:
    """What one repeat (R, N) has from row to row that the others have not, rms."""
    known = residual[~np.isnan(residual).all(axis=1)]
    if len(known) < 2:
        return 0.0
    changes = np.abs(np.diff(known[1:] - known[0], axis=1))
    changes = changes[np.isfinite(changes)]
    return float(np.median(changes)) / 0.6745 / 2.0 if len(changes) else np.inf
