"""Where the mismatch is: by channel, time, frequency, position, speed, effort and direction.

What is located is the difference that the named effects make along the recorded motion, or, where nothing is named, what is left; both
behind the filter that makes noise white, so that the noise of one repeat has unit variance in every row and every channel.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hil.diagnosis.result import Location, Span

EVERYWHERE = 0.9
"""Share of what was visited from which a mismatch is not localised."""
TIME_WINDOW_s = 0.25
"""Power is averaged over it: a few cycles of the frequencies in which loops show disturbances."""
LINES = 5
"""Neighbouring lines that power is averaged over."""
GAP_OCTAVES = 1.0 / 6.0
"""Bands closer than this are one."""
BINS = 24
"""Of position, speed and effort between the extremes visited."""
VISITED_ROWS = 5
"""A bin with fewer rows says nothing."""
MOVING = 0.05
"""Share of an axis's top speed below which it has no direction."""
ONE_WAY = 4.0
"""Ratio of mean power in one direction to that in the other from which the mismatch counts as one-way."""


@dataclass(frozen=True, eq=False)
class Mismatch:
    """What is to be located in one experiment.

    Attributes
    ----------
    begins : tuple of (str, float)
        Recordings of it, and when row 0 is in each [s].
    time_s : (N,) array
    white : (N, C) array
        In units of one repeat's noise, white.
    left : float
        Noise power in it.
    position, speed, effort : (N, axes) arrays
        Of the axes [rad or m, per second, drives' units].
    """

    begins: tuple[tuple[str, float], ...]
    time_s: np.ndarray
    white: np.ndarray
    left: float
    position: np.ndarray
    speed: np.ndarray
    effort: np.ndarray

    @property
    def power(self) -> np.ndarray:
        """Above noise (N, C)."""
        return np.asarray(self.white**2 - self.left)

    @property
    def lines(self) -> tuple[np.ndarray, np.ndarray]:
        """Frequencies (L,) [Hz], and power above noise (L, C) there, in units of the noise's."""
        rows = len(self.time_s)
        spectrum = np.abs(np.fft.rfft(self.white, axis=0)) ** 2 / rows - self.left
        return np.fft.rfftfreq(rows, self.time_s[1] - self.time_s[0]), spectrum


def locate(axes: Sequence[str], found: Sequence[Mismatch], channels: dict[str, float]) -> Location:
    """Locate the mismatch of all experiments together; `channels` are its shares of the channels."""
    if not any(np.any(one.power > 0.0) for one in found):
        return Location()
    where = Location(
        channels=channels,
        time_s=_times(found),
        frequency_hz=_bands(found),
        position=_by_axis(axes, found, "position"),
        speed=_by_axis(axes, found, "speed"),
        effort=_by_axis(axes, found, "effort"),
        direction=_directions(axes, found),
    )
    return replace(where, shares=_shares(axes, found, where))


def _shares(axes: Sequence[str], found: Sequence[Mismatch], where: Location) -> dict[str, dict[str, float]]:
    """Of the power above noise, what the spans of every dimension hold; of a direction, what is moved in that way."""
    power = np.concatenate([one.power.sum(axis=1) for one in found])
    shares: dict[str, dict[str, float]] = {}
    if where.time_s:
        inside = [_within(one.time_s + one.begins[0][1], where.time_s.get(one.begins[0][0], ())) for one in found]
        shares["time_s"] = {"all": _share(power, np.concatenate(inside))}
    if where.frequency_hz:
        lines = [one.lines for one in found]
        of_lines = np.concatenate([spectrum[1:].sum(axis=1) for _, spectrum in lines])
        shares["frequency_hz"] = {"all": _share(of_lines, np.concatenate([_within(f[1:], where.frequency_hz) for f, _ in lines]))}
    for k, axis in enumerate(axes):
        for quantity in ("position", "speed", "effort"):
            spans = getattr(where, quantity).get(axis, ())
            if spans:
                values = np.concatenate([getattr(one, quantity)[:, k] for one in found])
                shares.setdefault(quantity, {})[axis] = _share(power, _within(values, spans))
        if where.direction.get(axis, "both") != "both":
            speed = np.concatenate([one.speed[:, k] for one in found]) * (1.0 if where.direction[axis] == "positive" else -1.0)
            shares.setdefault("direction", {})[axis] = _share(power, speed > MOVING * float(np.abs(speed).max(initial=0.0)))
    return shares


def _within(values: np.ndarray, spans: Sequence[Span]) -> np.ndarray:
    """(N,) whether values are in one of the spans; its end is the next bin's, unless it is the last of all."""
    last = values.max(initial=-np.inf)
    inside = [(low <= values) & ((values < high) | ((values == last) & (last <= high))) for low, high in spans]
    return np.any(inside, axis=0) if inside else np.zeros(len(values), dtype=bool)


def _share(power: np.ndarray, inside: np.ndarray) -> float:
    whole = float(power.sum())
    return float(np.clip(power[inside].sum() / whole, 0.0, 1.0)) if whole > 0.0 else 0.0


def _smooth(power: np.ndarray, width: int) -> np.ndarray:
    """(M, C) mean over a window about every row."""
    sums = np.cumsum(np.vstack([np.zeros(power.shape[1]), power]), axis=0)
    low = np.clip(np.arange(len(power)) - width // 2, 0, len(power))
    high = np.clip(low + width, 0, len(power))
    return np.asarray((sums[high] - sums[low]) / np.maximum(high - low, 1)[:, None])


def _times(found: Sequence[Mismatch]) -> dict[str, tuple[Span, ...]]:
    """Intervals per recording; empty when they cover nearly everything or nothing."""
    spans: dict[str, tuple[Span, ...]] = {}
    marked = rows = 0
    for one in found:
        width = max(1, round(TIME_WINDOW_s / (one.time_s[1] - one.time_s[0])))
        is_on = _joined(np.any(_smooth(one.power, width) > 1.0, axis=1), width // 2)
        marked, rows = marked + int(is_on.sum()), rows + len(is_on)
        for name, begin in one.begins:
            here = tuple((begin + float(one.time_s[a]), begin + float(one.time_s[b - 1])) for a, b in _runs(is_on))
            spans[name] = (*spans.get(name, ()), *here)
    return {} if not 0 < marked < EVERYWHERE * rows else {label: found_here for label, found_here in spans.items() if found_here}


def _bands(found: Sequence[Mismatch]) -> tuple[Span, ...]:
    """Frequency intervals in which any channel's power is above its noise; () when they cover nearly every octave there is."""
    lines = [one.lines for one in found]
    frequency = max((f for f, _ in lines), key=len)
    is_on = np.zeros(len(frequency), dtype=bool)
    for f, spectrum in lines:
        power = np.vstack([np.zeros((1, spectrum.shape[1])), spectrum[1:]])  # a constant has no octave
        above = (_smooth(power, LINES) > 1.0).any(axis=1)
        is_on |= np.interp(frequency, f, above.astype(float)) > 0.5
    is_on[0] = False
    step = frequency[1]
    spans: list[Span] = []
    for a, b in _runs(is_on):
        low, high = float(frequency[a] - 0.5 * step), float(frequency[b - 1] + 0.5 * step)
        if spans and np.log2(low / spans[-1][1]) < GAP_OCTAVES:
            spans[-1] = (spans[-1][0], high)
        else:
            spans.append((low, high))
    covered = sum(np.log2(high / low) for low, high in spans)
    whole = np.log2(frequency[-1] / (0.5 * step))
    return tuple(spans) if 0.0 < covered < EVERYWHERE * whole else ()


def _by_axis(axes: Sequence[str], found: Sequence[Mismatch], quantity: str) -> dict[str, tuple[Span, ...]]:
    """Intervals of one quantity per axis, of its visited bins."""
    spans = {}
    power = np.concatenate([one.power for one in found])
    for k, axis in enumerate(axes):
        edges, mean, is_visited = _binned(np.concatenate([getattr(one, quantity)[:, k] for one in found]), power)
        is_on = is_visited & (mean > 1.0).any(axis=1)
        if is_visited.sum() >= 3 and 0 < is_on.sum() < EVERYWHERE * is_visited.sum():
            spans[axis] = tuple((float(edges[a]), float(edges[b])) for a, b in _runs(_fill_unvisited(is_on, is_visited)))
    return spans


def _binned(values: np.ndarray, power: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Edges (BINS + 1,), mean power (BINS, C) and whether a bin was visited (BINS,)."""
    low, high = float(values.min()), float(values.max())
    if not high > low:
        return np.array([low, high]), power.mean(axis=0)[None], np.array([True])
    edges = np.linspace(low, high, BINS + 1)
    place = np.clip(((values - low) / (high - low) * BINS).astype(int), 0, BINS - 1)
    rows = np.bincount(place, minlength=BINS)
    sums = np.column_stack([np.bincount(place, weights=column, minlength=BINS) for column in power.T])
    return edges, sums / np.maximum(rows, 1)[:, None], rows >= VISITED_ROWS


def _directions(axes: Sequence[str], found: Sequence[Mismatch]) -> dict[str, str]:
    """Whether the mismatch belongs to one direction of motion; an axis that does not move both ways has none."""
    directions = {}
    values = np.concatenate([one.power for one in found]).sum(axis=1)
    for k, axis in enumerate(axes):
        speed = np.concatenate([one.speed[:, k] for one in found])
        least = MOVING * float(np.abs(speed).max(initial=0.0))
        forward, backward = speed > least, speed < -least
        if min(forward.sum(), backward.sum()) < VISITED_ROWS:
            continue
        onward, back = float(values[forward].mean()), float(values[backward].mean())
        if max(onward, back) >= 1.0:
            directions[axis] = "positive" if onward > ONE_WAY * back else "negative" if back > ONE_WAY * onward else "both"
    return directions


def _runs(is_on: np.ndarray) -> list[tuple[int, int]]:
    """Begin and end (exclusive) of every run of true values."""
    steps = np.diff(np.concatenate([[0], is_on.astype(int), [0]]))
    return list(zip(np.flatnonzero(steps == 1).tolist(), np.flatnonzero(steps == -1).tolist(), strict=True))


def _joined(is_on: np.ndarray, width: int) -> np.ndarray:
    """Make runs with shorter gaps than `width` between them one."""
    joined = is_on.copy()
    for (_, a), (b, _) in itertools.pairwise(_runs(is_on)):
        if b - a < width:
            joined[a:b] = True
    return joined


def _fill_unvisited(is_on: np.ndarray, is_visited: np.ndarray) -> np.ndarray:
    """Add gaps that nothing visited, between two places that have the mismatch."""
    filled = is_on.copy()
    visited = np.flatnonzero(is_visited)
    for a, b in itertools.pairwise(visited):
        if is_on[a] and is_on[b]:
            filled[a : b + 1] = True
    return filled
