"""Rounding of encoders' readings that repeats share where no loop is closed.

Repeats of an open loop come to the same place at the same time as near as disturbances let them. Where that is nearer than a count they are
rounded alike: no deviation shows the error, and a mean of repeats keeps it whole. A simulation that is off by a part of a count has another
one (Widrow and Kollár 2008, ch. 5). In a loop the errors go around besides: `loop_lattices.py`.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np

from hil.diagnosis.residuals.loop_lattices import LEAST_SHARED, PHASES, rows_of
from hil.diagnosis.residuals.repeat_group import RepeatGroup
from hil.machine import Machine
from hil.simulation import Simulator
from hil.simulation.smooth import smooth

BLOCK_s = 0.25
"""Stretch over which it is asked how far repeats are apart: they may be near in one part of a motion and far in another."""

HARMONICS = 60
"""Of the rounding error as a function of the place within a count; the rest hold a hundredth of its power."""

LEAST_OWN = 0.05
"""Share of a rounding's power that a channel has as its own noise at the least: no spectrum is nothing."""


def shared_rounding(
    groups: Sequence[RepeatGroup], channels: Sequence[str], known: Collection[str] = ()
) -> tuple[list[tuple[RepeatGroup, np.ndarray]], dict[str, float]]:
    """Rounding errors along the nominal motion, as far as repeats share them.

    Parameters
    ----------
    groups : sequence of RepeatGroup
    channels : sequence of str
    known : collection of str
        Channels whose rounding counts otherwise (`recorded/lattice.py`).

    Returns
    -------
    list of (RepeatGroup, (N, C) array)
        Records whose mean power is that of the errors; none where repeats do not share any, or a loop is closed. Encoders are where they
        are within a count independently of each other, so that each has records of its own.
    dict of str to float
        Of these channels, the share of their rounding's power that repeats have in common.
    """
    found: list[tuple[RepeatGroup, np.ndarray]] = []
    shares: dict[str, list[float]] = {}
    for group in groups:
        counts = {encoder.channel: encoder.resolution for encoder in group.machine.plant.encoders if encoder.channel not in known}
        rounding = [name for name in channels if counts.get(name, 0.0) > 0.0]
        if group.machine.controllers or not rounding:
            continue
        block = max(round(BLOCK_s * group.machine.sample_rate_Hz), 1)
        share = {name: shared_power(group.measured[:, :, list(channels).index(name)], counts[name], block) for name in rounding}
        for name in rounding:
            shares.setdefault(name, []).append(float(np.mean(share[name])))
        if all(np.mean(each) <= LEAST_SHARED for each in share.values()):
            continue
        rows = rows_of(Simulator(smooth(group.machine)), group.inputs, channels)
        for name in rounding:
            places = rows[:, list(channels).index(name)] / counts[name]
            weight = counts[name] * np.sqrt(share[name] * len(rounding))  # powers of channels add up, those of records are averaged
            for phase in (np.arange(PHASES) + 0.5) / PHASES:
                errors = np.floor(places + phase + 0.5) - phase - places
                found += [(group, _in_channel(weight * errors[window], channels, name)) for window in group.windows]
    return found, {name: float(np.mean(each)) for name, each in shares.items()}


def with_less_rounding(machine: Machine, shares: Mapping[str, float]) -> Machine:
    """The machine with the rounding that repeats do not share, as the least that their deviations' noise is."""
    encoders = tuple(
        replace(encoder, resolution=encoder.resolution * max(1.0 - shares.get(encoder.channel, 0.0), LEAST_OWN) ** 0.5)
        for encoder in machine.plant.encoders
    )
    return replace(machine, plant=replace(machine.plant, encoders=encoders))


def _in_channel(errors: np.ndarray, channels: Sequence[str], name: str) -> np.ndarray:
    """(N, C) errors (N,) of one channel."""
    return np.outer(errors, [one == name for one in channels])


def shared_power(readings: np.ndarray, count: float, block: int) -> np.ndarray:
    """(N,) share of the power of rounding errors that readings (R, N) have in common.

    The k-th harmonics of the rounding errors of two positions that are d apart, at any place within a count q, are correlated by
    cos(2 pi k d / q): by exp(-2 pi^2 k^2 var(d) / q^2) in the mean over a normal d, and hold 6 / (pi k)^2 of their power. And two readings
    differ by |d| in the mean over the places. Lost samples say nothing, and where nothing was read twice nothing is shared.
    """
    edges = np.arange(0, readings.shape[1], block)
    lengths = np.diff([*edges, readings.shape[1]])
    shares = []
    for i, j in combinations(range(len(readings)), 2):
        differ = np.abs(readings[i] - readings[j])
        read = np.add.reduceat(np.isfinite(differ).astype(float), edges)
        apart = np.add.reduceat(np.nan_to_num(differ), edges) / np.maximum(read, 1.0)
        alike = np.exp(-2.0 * np.pi**2 * (0.5 * np.pi) * (apart / count) ** 2)
        power = np.sum([6.0 / (np.pi * k) ** 2 * alike ** (k * k) for k in range(1, HARMONICS + 1)], axis=0)
        shares.append(np.where(read > 0.0, power, np.nan))
    if not shares:
        return np.zeros(readings.shape[1])
    known = np.sum(np.isfinite(shares), axis=0)
    return np.repeat(np.nansum(shares, axis=0) / np.maximum(known, 1), lengths)
