"""Where the explainable mismatch is: by channel, time, frequency, position, speed, effort and direction.

What is located is the difference that the named effects make (free runs with and without them), or, where nothing is named, the mean
residual with the noise's share taken off. All of it in units of one repeat's noise per channel and frequency, so that no channel counts
more for its unit.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np

from hil.diagnosis.mismatch import Mismatch, RepeatGroup
from hil.diagnosis.result import Location, Span
from hil.diagnosis.whitened import InNoiseUnits, in_noise_units

ABOVE_NOISE = 1.0
"""Mean power, in units of one repeat's noise, from which a stretch of time, a band or a bin counts as having the mismatch."""

SHARE_OF_PEAK = 0.02
"""And this share of the largest: what is below a hundredth of the mismatch's peak power is not where it is, however quiet the machine."""

EVERYWHERE = 0.85
"""Share of what was visited from which a mismatch is not localised."""

TIME_WINDOW_s = 0.2
"""Power is averaged over it: a few cycles of the frequencies in which loops show disturbances."""

BINS = 24
"""Of position, speed and effort between the extremes visited."""

VISITED_ROWS = 5
"""A bin with fewer rows says nothing."""

BANDS_PER_OCTAVE = 6
MOVING = 0.05
"""Share of an axis's top speed below which it has no direction."""

ONE_WAY = 4.0
"""Ratio of mean power in one direction to that in the other from which the mismatch counts as one-way."""


def locate(found: Mismatch, effect: Sequence[np.ndarray] | None = None) -> Location:
    """Locate the mismatch of all groups together.

    Parameters
    ----------
    found : Mismatch
        Beside the simulation whose mismatch is meant: the re-tuned one, say.
    effect : sequence of (N, C) arrays, optional
        Per group, what the named effects add to the simulation. Without it the mean residual is located.
    """
    signals = [group.mean - group.simulated for group in found.groups] if effect is None else effect
    whitened = [in_noise_units(found.noise, signal) for signal in signals]
    left = [1.0 / group.repeats if effect is None else 0.0 for group in found.groups]  # noise power in the mean of repeats
    powers = [np.maximum(_smooth(w.rows**2, found.noise.rate_Hz) - noise, 0.0) for w, noise in zip(whitened, left, strict=True)]
    total = sum(np.maximum((w.rows**2).sum(axis=0) - noise * len(w.rows), 0.0) for w, noise in zip(whitened, left, strict=True))
    if not np.any(total > 0.0):
        return Location()
    at_rows = [power.sum(axis=1) for power in powers]
    peak = max(float(power.max(initial=0.0)) for power in at_rows)
    threshold = max(ABOVE_NOISE, SHARE_OF_PEAK * peak)
    names = found.axes
    return Location(
        channels={name: float(share) for name, share in zip(found.channels, total / np.sum(total), strict=True)},
        time_s=_times(found, whitened, at_rows, threshold),
        frequency_hz=_bands(whitened, left),
        position=_by_axis(found, at_rows, whitened, names, "position"),
        speed=_by_axis(found, at_rows, whitened, names, "speed"),
        effort=_by_axis(found, at_rows, whitened, names, "effort"),
        direction=_directions(found, at_rows, whitened),
    )


def locate_outcome(
    found: Mismatch, retuned: Sequence[np.ndarray], extended: Sequence[np.ndarray], without: Sequence[np.ndarray], *, named: bool
) -> Location:
    """Where the named effects act, or, where none is named, where the re-tuned simulation is off.

    Parameters
    ----------
    found : Mismatch
    retuned, extended, without : sequences of (N, C) arrays
        Simulated rows per group: re-tuned; with the effects; with the same numbers but without the effects.
    named : bool
    """
    if named and all(np.isfinite(rows).all() for rows in without):
        return locate(found, [full - bare for full, bare in zip(extended, without, strict=True)])
    return locate(found.with_simulated(retuned))


def _smooth(power: np.ndarray, rate_Hz: float) -> np.ndarray:
    """(M, C) mean over a window about every row."""
    width = max(1, round(TIME_WINDOW_s * rate_Hz))
    sums = np.cumsum(np.vstack([np.zeros(power.shape[1]), power]), axis=0)
    low = np.clip(np.arange(len(power)) - width // 2, 0, len(power))
    high = np.clip(low + width, 0, len(power))
    return (sums[high] - sums[low]) / (high - low)[:, None]


def _times(found: Mismatch, whitened: Sequence[InNoiseUnits], power: Sequence[np.ndarray], threshold: float) -> dict[str, tuple[Span, ...]]:
    """Intervals per recording; empty when they cover nearly everything or nothing."""
    spans: dict[str, tuple[Span, ...]] = {}
    marked = rows = 0
    for group, w, values in zip(found.groups, whitened, power, strict=True):
        is_on = _closed(values > threshold, round(TIME_WINDOW_s * found.noise.rate_Hz))
        marked, rows = marked + int(is_on.sum()), rows + len(is_on)
        time_s = group.time_s[w.first_row :]
        found_here = tuple((float(time_s[a]), float(time_s[b - 1])) for a, b in _runs(is_on))
        for label in group.labels:
            spans[label] = found_here
    return {} if not 0 < marked < EVERYWHERE * rows else {label: found_here for label, found_here in spans.items() if found_here}


def _bands(whitened: Sequence[InNoiseUnits], left: Sequence[float]) -> tuple[Span, ...]:
    """Frequency intervals in which any channel's power is above noise; () when they cover nearly every octave there is."""
    highest = max(w.frequencies_Hz[-1] for w in whitened)
    lowest = max(w.frequencies_Hz[1] for w in whitened)
    count = max(1, int(np.ceil(BANDS_PER_OCTAVE * np.log2(highest / lowest))))
    edges = np.concatenate([[0.0], np.geomspace(lowest, highest * (1.0 + 1e-9), count + 1)[1:]])
    width = len(whitened[0].power[0])
    sums, lines = np.zeros((count, width)), np.zeros(count)
    for w, noise in zip(whitened, left, strict=True):
        place = np.clip(np.searchsorted(edges, w.frequencies_Hz, side="right") - 1, 0, count - 1)
        np.add.at(sums, place, w.power - noise)
        np.add.at(lines, place, 1.0)
    mean = np.where(lines[:, None] > 0.0, sums / np.maximum(lines, 1.0)[:, None], 0.0).max(axis=1)
    is_on = mean > max(ABOVE_NOISE, SHARE_OF_PEAK * float(mean.max()))
    is_on = _fill_unvisited(is_on, lines > 0.0)
    if not 0 < is_on.sum() < EVERYWHERE * count:
        return ()
    return tuple((float(edges[a]), float(edges[b])) for a, b in _runs(is_on))


def _by_axis(
    found: Mismatch, power: Sequence[np.ndarray], whitened: Sequence[InNoiseUnits], axes: Sequence[str], quantity: str
) -> dict[str, tuple[Span, ...]]:
    """Intervals of one quantity per axis, of its visited bins."""
    spans = {}
    for k, axis in enumerate(axes):
        columns = [_column(group, w, quantity, k) for group, w in zip(found.groups, whitened, strict=True)]
        edges, mean, is_visited = binned(np.concatenate(columns), np.concatenate(list(power)))
        if is_visited.sum() < 3:
            continue
        is_on = is_visited & (mean > max(ABOVE_NOISE, SHARE_OF_PEAK * float(mean[is_visited].max())))
        if 0 < is_on.sum() < EVERYWHERE * is_visited.sum():
            spans[axis] = tuple((float(edges[a]), float(edges[b])) for a, b in _runs(_fill_unvisited(is_on, is_visited)))
    return spans


def binned(values: np.ndarray, power: np.ndarray, bins: int = BINS) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Edges (bins + 1,), mean power (bins,) and whether a bin was visited (bins,)."""
    low, high = float(values.min()), float(values.max())
    if not high > low:
        return np.array([low, high]), np.array([float(power.mean())]), np.array([True])
    edges = np.linspace(low, high, bins + 1)
    place = np.clip(((values - low) / (high - low) * bins).astype(int), 0, bins - 1)
    rows = np.bincount(place, minlength=bins)
    mean = np.bincount(place, weights=power, minlength=bins) / np.maximum(rows, 1)
    return edges, mean, rows >= VISITED_ROWS


def _directions(found: Mismatch, power: Sequence[np.ndarray], whitened: Sequence[InNoiseUnits]) -> dict[str, str]:
    """Whether the mismatch belongs to one direction of motion; an axis that does not move both ways has none."""
    directions = {}
    for k, axis in enumerate(found.axes):
        speed = np.concatenate([_column(group, w, "speed", k) for group, w in zip(found.groups, whitened, strict=True)])
        values = np.concatenate(list(power))
        least = MOVING * float(np.abs(speed).max(initial=0.0))
        forward, backward = speed > least, speed < -least
        if min(forward.sum(), backward.sum()) < VISITED_ROWS:
            continue
        onward, back = float(values[forward].mean()), float(values[backward].mean())
        if max(onward, back) < ABOVE_NOISE:
            continue
        directions[axis] = "positive" if onward > ONE_WAY * back else "negative" if back > ONE_WAY * onward else "both"
    return directions


def _column(group: RepeatGroup, whitened: InNoiseUnits, quantity: str, axis: int) -> np.ndarray:
    values: np.ndarray = getattr(group, quantity)[whitened.first_row :, axis]
    return values


def _runs(is_on: np.ndarray) -> list[tuple[int, int]]:
    """Begin and end (exclusive) of every run of true values."""
    steps = np.diff(np.concatenate([[0], is_on.astype(int), [0]]))
    return list(zip(np.flatnonzero(steps == 1).tolist(), np.flatnonzero(steps == -1).tolist(), strict=True))


def _closed(is_on: np.ndarray, width: int) -> np.ndarray:
    """Runs with shorter gaps than `width` between them joined, and what is then shorter than half of it left out."""
    closed = is_on.copy()
    for (_, a), (b, _) in itertools.pairwise(_runs(is_on)):
        if b - a < width:
            closed[a:b] = True
    for a, b in _runs(closed):
        if b - a < width // 2:
            closed[a:b] = False
    return closed


def _fill_unvisited(is_on: np.ndarray, is_visited: np.ndarray) -> np.ndarray:
    """A gap that nothing visited, between two places that have the mismatch, has it too."""
    filled = is_on.copy()
    visited = np.flatnonzero(is_visited)
    for a, b in itertools.pairwise(visited):
        if is_on[a] and is_on[b]:
            filled[a : b + 1] = True
    return filled
