"""Steps between the times of samples: the usual one, and whether they are even."""

from __future__ import annotations

import numpy as np

LOST = 1.5
"""Neighbouring samples further apart than this many of the usual steps have lost one between them."""

CLOSE = 0.5
"""Samples of one sender are at least this many of the usual steps apart; halfway lies what belongs to neither."""

COARSE = 0.1
"""Share of samples with the stamp of the one before, from which a clock is coarser than the samples."""

ON_RASTER = 0.15
"""Largest distance of a sample from its place in an even raster, in steps."""

SAME_RATE = 0.01
"""Rates that differ by less than this share are the same."""


def usual_step(time_s: np.ndarray) -> float:
    """Return the usual step between neighbouring times; 0 of fewer than two."""
    steps = np.diff(time_s)
    steps = steps[steps > 0.0]
    return float(np.median(steps)) if steps.size else 0.0


def is_even(time_s: np.ndarray) -> bool:
    """Return whether samples come at one rate, gaps and jitter aside."""
    steps, step = np.diff(time_s), usual_step(time_s)
    return steps.size > 1 and float(np.mean(np.abs(steps - step) < CLOSE * step)) >= 1.0 - COARSE


def is_on_raster(time_s: np.ndarray) -> bool:
    """Return whether samples lie at whole multiples of the usual step from each other: of one rate at which many were lost."""
    steps, step = np.diff(time_s), usual_step(time_s)
    whole = np.abs(steps - step * np.rint(steps / step)) < ON_RASTER * step if step else np.zeros(0)
    return steps.size > 1 and float(np.mean(whole)) >= 1.0 - COARSE


def usual_change(values: np.ndarray) -> np.ndarray:
    """Return the usual change (K,) of values (N, K) from sample to sample, or to the next but one where two take turns; inf without one."""
    scale = np.full(values.shape[1], np.inf)
    for column in range(values.shape[1]):
        for stride in (1, 2):
            change = np.abs(values[stride:, column] - values[:-stride, column])
            change = change[np.isfinite(change) & (change > 0.0)]
            if change.size:
                scale[column] = min(scale[column], float(np.median(change)))
    return scale


def equal_rows(these: np.ndarray, those: np.ndarray) -> np.ndarray:
    """Return which rows (N,) of two arrays (N, K) are the same, missing values too."""
    equal: np.ndarray = ((these == those) | (np.isnan(these) & np.isnan(those))).all(axis=1)
    return equal
