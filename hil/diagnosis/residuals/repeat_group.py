"""Repeats of one experiment beside their simulation."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from hil.diagnosis.residuals.carried import CarriedImu
from hil.machine import Machine
from hil.simulation import Inputs


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
        """(N, C) mean of the repeats; where a sample is missing in all of them, the line between its neighbours."""
        return self.complete.mean(axis=0)

    @cached_property
    def complete(self) -> np.ndarray:
        """(R, N, C) measured, a missing sample replaced by what the other repeats read there and what this one read more, interpolated in
        time; where all miss it, by the simulation and the residual.
        """
        complete = _filled(self.measured, np.broadcast_to(self.simulated, self.measured.shape), self.time_s)
        others = np.stack([_mean_known(np.delete(self.measured, r, axis=0)) for r in range(self.repeats)])
        return np.where(np.isnan(others), complete, _filled(self.measured, np.where(np.isnan(others), complete, others), self.time_s))

    def without(self, kept: np.ndarray) -> RepeatGroup:
        """With those readings (R, N, C) alone that were not lost, NaN in place of these."""
        bare = replace(self, measured=kept)
        gone = np.isnan(kept) & ~np.isnan(self.measured)
        return replace(bare, lost=np.where(gone, self.measured - bare.complete, 0.0))

    def fold(self, rows: np.ndarray) -> np.ndarray:
        """Simulated rows of the whole recording (M, C) as those of the repeats (N, C); of one window a part of them, not a copy."""
        return rows[self.windows[0]] if len(self.windows) == 1 else np.mean([rows[window] for window in self.windows], axis=0)


def _filled(measured: np.ndarray, expected: np.ndarray, time_s: np.ndarray) -> np.ndarray:
    """(R, N, C) with what is missing as expected and as much more as the readings around it are."""
    more = measured - expected
    for r, c in np.argwhere(np.isnan(more).any(axis=1)):
        missing = np.isnan(more[r, :, c])
        more[r, missing, c] = np.interp(time_s[missing], time_s[~missing], more[r, ~missing, c])
    return np.where(np.isnan(measured), more + expected, measured)


def _mean_known(measured: np.ndarray) -> np.ndarray:
    """(N, C) mean of those of some repeats (R, N, C) that read anything; NaN where none does."""
    known = ~np.isnan(measured)
    counts = known.sum(axis=0)
    total = np.where(known, measured, 0.0).sum(axis=0)
    return np.where(counts > 0, total / np.maximum(counts, 1), np.nan)
