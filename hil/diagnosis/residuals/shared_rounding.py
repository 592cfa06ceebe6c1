"""Rounding of encoders' readings that repeats share where no loop is closed.

Repeats of an open loop come to the same place at the same time as near as disturbances let them. Where that is nearer than a count they are
rounded alike: no deviation shows the error, and a mean of repeats keeps it whole. A simulation that is off by a part of a count has another
one (Widrow and Kollár 2008, ch. 5). In a loop the errors go around besides: `loop_lattices.py`.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from hil.diagnosis.residuals.loop_lattices import LEAST_SHARED, PHASES, rows_of
from hil.diagnosis.residuals.repeat_group import RepeatGroup
from hil.diagnosis.residuals.simulated import smooth
from hil.simulation import Simulator

BLOCK_s = 0.25
"""Stretch over which it is asked how far repeats are apart: they may be near in one part of a motion and far in another."""

HARMONICS = 60
"""Of the rounding error as a function of the place within a count; the rest hold a hundredth of its power."""


def shared_rounding(groups: Sequence[RepeatGroup], channels: Sequence[str]) -> list[tuple[RepeatGroup, np.ndarray]]:
    """Rounding errors along the nominal motion, as far as repeats share them.

    Parameters
    ----------
    groups : sequence of RepeatGroup
    channels : sequence of str

    Returns
    -------
    list of (RepeatGroup, (N, C) array)
        Records whose mean power is that of the errors; none where repeats do not share any, or a loop is closed.
    """
    found = []
    for group in groups:
        counts = {encoder.channel: encoder.resolution for encoder in group.machine.plant.encoders if encoder.resolution > 0.0}
        if group.machine.controllers or not set(counts) & set(channels):
            continue
        weights, steps = np.zeros((len(group.time_s), len(channels))), np.ones(len(channels))
        for number, name in enumerate(channels):
            if name in counts:
                steps[number] = counts[name]
                weights[:, number] = np.sqrt(shared_power(group.measured[:, :, number], counts[name], round(BLOCK_s / _step_s(group))))
        if np.max(np.mean(weights**2, axis=0)) <= LEAST_SHARED:
            continue
        places = rows_of(Simulator(smooth(group.machine)), group.inputs, channels) / steps
        for phase in (np.arange(PHASES) + 0.5) / PHASES:
            errors = weights * steps * (np.floor(places + phase + 0.5) - phase - places)
            found += [(group, errors[window]) for window in group.windows]
    return found


def shared_power(readings: np.ndarray, count: float, block: int) -> np.ndarray:
    """(N,) share of the power of rounding errors that readings (R, N) have in common.

    The k-th harmonics of the rounding errors of two positions that are d apart, at any place within a count q, are correlated by
    cos(2 pi k d / q): by exp(-2 pi^2 k^2 var(d) / q^2) in the mean over a normal d, and hold 6 / (pi k)^2 of their power. And two readings
    differ by |d| in the mean over the places.
    """
    edges = np.arange(0, readings.shape[1], max(block, 1))
    lengths = np.diff([*edges, readings.shape[1]])
    shares = [np.zeros(len(edges))]
    for i, j in combinations(range(len(readings)), 2):
        apart = np.add.reduceat(np.nan_to_num(np.abs(readings[i] - readings[j])), edges) / lengths
        alike = np.exp(-2.0 * np.pi**2 * (0.5 * np.pi) * (apart / count) ** 2)
        shares.append(np.sum([6.0 / (np.pi * k) ** 2 * alike ** (k * k) for k in range(1, HARMONICS + 1)], axis=0))
    return np.repeat(np.mean(shares[1:] or shares, axis=0), lengths)


def _step_s(group: RepeatGroup) -> float:
    return 1.0 / group.machine.sample_rate_Hz
