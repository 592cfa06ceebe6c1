"""Where the explainable mismatch is: by channel, time, frequency, position, speed, effort and direction.

What is located is the difference that the named effects make (free runs with and without them), or, where nothing is named, the mean
residual with the noise's share taken off. It is where any channel exceeds one repeat's noise: the channel's noise rms over time and in bins
of pose, speed and effort, its noise spectrum over frequency. Channels' shares are those of power in units of their noise spectra, so that
no channel counts more for its unit, from the first line of a tapered record on, as frequencies are: a constant, of which every recording
has one line, too few to say what its noise is, counts by the fifth that tapering leaves of it there.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hil.diagnosis.recorded.dropout import OF_IMU
from hil.diagnosis.residuals.mismatch import Mismatch
from hil.diagnosis.residuals.whitened import InNoiseUnits, in_noise_units, white_in_noise_units
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


def locate(found: Mismatch, effect: Sequence[np.ndarray] | None = None) -> Location:
    """Locate the mismatch of all groups together.

    Parameters
    ----------
    found : Mismatch
        Beside the simulation whose mismatch is meant: the re-tuned one, say.
    effect : sequence of (N, C) arrays, optional
        Per group, what the named effects add to the simulation, beside which lost readings are located, too. In the channels' shares coarse
        lattices count as well. Without it the mean residual is located, which has none of these.
    """
    signals = [group.mean - group.simulated for group in found.groups] if effect is None else list(effect)
    whitened = [in_noise_units(found.noise, signal) for signal in signals]
    lost = [
        np.zeros((0, *signal.shape)) if effect is None or g.lost is None else g.lost
        for g, signal in zip(found.groups, signals, strict=True)
    ]
    whitened = [_with_lost(found, one, off) for one, off in zip(whitened, lost, strict=True)]
    left = [1.0 / group.repeats if effect is None else 0.0 for group in found.groups]  # noise power in the mean of repeats
    total = sum(np.maximum((w.power[1:] - noise).sum(axis=0), 0.0) for w, noise in zip(whitened, left, strict=True))
    if effect is not None and found.lattices:
        total = total + sum(_rounding(found, one) for one in whitened)
    if not np.any(total > 0.0):
        return Location()
    squares = [signal**2 + np.mean(off**2, axis=0) if len(off) else signal**2 for signal, off in zip(signals, lost, strict=True)]
    powers = [square / found.noise.std**2 - noise for square, noise in zip(squares, left, strict=True)]
    where = Location(
        channels={name: float(share) for name, share in zip(found.channels, total / np.sum(total), strict=True)},
        time_s=_times(found, powers),
        frequency_hz=_bands(whitened, left),
        position=_by_axis(found, powers, "position"),
        speed=_by_axis(found, powers, "speed"),
        effort=_by_axis(found, powers, "effort"),
        direction=_directions(found, powers),
    )
    return replace(where, shares=_shares(found, where, np.concatenate(powers).sum(axis=1), _over_frequency(where, whitened, left)))


def _with_lost(found: Mismatch, whitened: InNoiseUnits, lost: np.ndarray) -> InNoiseUnits:
    """With the power of lost readings (R, N, C), which come at other times in every repeat, in the mean of the repeats."""
    if not len(lost):
        return whitened
    return replace(whitened, power=whitened.power + np.mean([in_noise_units(found.noise, off).power for off in lost], axis=0))


def _rounding(found: Mismatch, whitened: InNoiseUnits) -> np.ndarray:
    """(C,) power of what lattices that were read off round (white; Widrow and Kollár 2008, ch. 5), over all lines."""
    steps = np.array([found.lattices[name].step if name in found.lattices else 0.0 for name in found.channels])
    return white_in_noise_units(found.noise, steps / np.sqrt(12.0), whitened.frequencies_Hz[1:]).sum(axis=0)


def _shares(found: Mismatch, where: Location, power: np.ndarray, over_frequency: float | None) -> dict[str, dict[str, float]]:
    """Of the power above noise of all rows (rows,), what the spans of every dimension hold; of a direction, what is moved in that way."""
    shares: dict[str, dict[str, float]] = {}
    if where.time_s:
        inside = [_within(group.time_s, where.time_s.get(group.labels[0], ())) for group in found.groups]
        shares["time_s"] = {"all": _share(power, np.concatenate(inside))}
    if over_frequency is not None:
        shares["frequency_hz"] = {"all": over_frequency}
    for k, axis in enumerate(found.axes):
        for quantity in ("position", "speed", "effort"):
            spans = getattr(where, quantity).get(axis, ())
            if spans:
                values = np.concatenate([getattr(group, quantity)[:, k] for group in found.groups])
                shares.setdefault(quantity, {})[axis] = _share(power, _within(values, spans))
        if where.direction.get(axis, "both") != "both":
            speed = np.concatenate([group.speed[:, k] for group in found.groups]) * (1.0 if where.direction[axis] == "positive" else -1.0)
            shares.setdefault("direction", {})[axis] = _share(power, speed > MOVING * float(np.abs(speed).max(initial=0.0)))
    return shares


def _over_frequency(where: Location, whitened: Sequence[InNoiseUnits], left: Sequence[float]) -> float | None:
    """Share of the power above noise that the bands hold; None where there are none."""
    if not where.frequency_hz:
        return None
    power = np.concatenate([(w.power[1:] - noise).sum(axis=1) for w, noise in zip(whitened, left, strict=True)])
    return _share(power, np.concatenate([_within(w.frequencies_Hz[1:], where.frequency_hz) for w in whitened]))


def _within(values: np.ndarray, spans: Sequence[Span]) -> np.ndarray:
    """(N,) whether values are in one of the spans; its end is the next bin's, unless it is the last of all."""
    last = values.max(initial=-np.inf)
    inside = [(low <= values) & ((values < high) | ((values == last) & (last <= high))) for low, high in spans]
    return np.any(inside, axis=0) if inside else np.zeros(len(values), dtype=bool)


def _share(power: np.ndarray, inside: np.ndarray) -> float:
    whole = float(power.sum())
    return float(np.clip(power[inside].sum() / whole, 0.0, 1.0)) if whole > 0.0 else 0.0


def locate_outcome(
    found: Mismatch, retuned: Sequence[np.ndarray], change: Sequence[np.ndarray] | None, *, named: bool, unknown: bool = False
) -> Location:
    """Where the named effects act, or, where none is named, where the re-tuned simulation is off.

    Parameters
    ----------
    found : Mismatch
    retuned : sequence of (N, C) arrays
        Simulated rows per group.
    change : sequence of (N, C) arrays or None
        What the named effects add to the simulation; nothing where they were read off the recordings: lost readings are where they are
        lost, and where a lattice was read off, too, all are in their channels.
    named : bool
    unknown : bool
        Whether physics is left that no effect explains: beside what was read off alone, that is what is located.
    """
    adds = change is not None and any(np.any(rows) for rows in change)
    if not named or change is None or (unknown and not adds):
        return locate(found.with_simulated(retuned))
    if adds or not found.read_off:
        return locate(found, change)
    where = Location() if found.lattices else locate(found, change)
    return where if where.channels else Location(channels=_read_off_shares(found))


def _read_off_shares(found: Mismatch) -> dict[str, float]:
    """Shares of the channels that something was read off, the IMU's spread over those of its channels that are recorded."""
    places = dict(found.read_off)
    shares = dict.fromkeys(found.channels, 0.0)
    for at in places:
        own = [name for name in found.channels if name == at] or [name for name in found.channels if name.startswith(OF_IMU)]
        for name in own:
            shares[name] += 1.0 / (len(places) * len(own))
    return shares


def _smooth(power: np.ndarray, width: int) -> np.ndarray:
    """(M, C) mean over a window about every row."""
    sums = np.cumsum(np.vstack([np.zeros(power.shape[1]), power]), axis=0)
    low = np.clip(np.arange(len(power)) - width // 2, 0, len(power))
    high = np.clip(low + width, 0, len(power))
    return np.asarray((sums[high] - sums[low]) / np.maximum(high - low, 1)[:, None])


def _times(found: Mismatch, powers: Sequence[np.ndarray]) -> dict[str, tuple[Span, ...]]:
    """Intervals per recording, or period of one in its own time; empty when they cover nearly everything or nothing."""
    spans: dict[str, tuple[Span, ...]] = {}
    marked = rows = 0
    width = max(1, round(TIME_WINDOW_s * found.noise.rate_Hz))
    for group, power in zip(found.groups, powers, strict=True):
        is_on = _joined(np.any(_smooth(power, width) > 1.0, axis=1), width // 2)
        marked, rows = marked + int(is_on.sum()), rows + len(is_on)
        found_here = [(float(group.time_s[a]), float(group.time_s[b - 1])) for a, b in _runs(is_on)]
        windows = group.windows if len(group.windows) == len(group.labels) else group.windows[:1] * len(group.labels)
        for label, window in zip(group.labels, windows, strict=True):
            later = (window.start - windows[0].start) / found.noise.rate_Hz
            spans[label] = tuple((begin + later, end + later) for begin, end in found_here)
    return {} if not 0 < marked < EVERYWHERE * rows else {label: found_here for label, found_here in spans.items() if found_here}


def _bands(whitened: Sequence[InNoiseUnits], left: Sequence[float]) -> tuple[Span, ...]:
    """Frequency intervals in which any channel's power is above its noise; () when they cover nearly every octave there is."""
    longest = max(whitened, key=lambda w: len(w.frequencies_Hz))
    frequency = longest.frequencies_Hz
    is_on = np.zeros(len(frequency), dtype=bool)
    for w, noise in zip(whitened, left, strict=True):
        power = w.power - noise
        power[0] = 0.0  # a constant has no octave
        above = (_smooth(power, LINES) > 1.0).any(axis=1)
        is_on |= np.interp(frequency, w.frequencies_Hz, above.astype(float)) > 0.5
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


def _by_axis(found: Mismatch, powers: Sequence[np.ndarray], quantity: str) -> dict[str, tuple[Span, ...]]:
    """Intervals of one quantity per axis, of its visited bins."""
    spans = {}
    power = np.concatenate(list(powers))
    for k, axis in enumerate(found.axes):
        edges, mean, is_visited = binned(np.concatenate([getattr(group, quantity)[:, k] for group in found.groups]), power)
        if is_visited.sum() < 3:
            continue
        is_on = is_visited & (mean > 1.0).any(axis=1)
        if 0 < is_on.sum() < EVERYWHERE * is_visited.sum():
            spans[axis] = tuple((float(edges[a]), float(edges[b])) for a, b in _runs(_fill_unvisited(is_on, is_visited)))
    return spans


def binned(values: np.ndarray, power: np.ndarray, bins: int = BINS) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Edges (bins + 1,), mean power (bins, C) and whether a bin was visited (bins,)."""
    low, high = float(values.min()), float(values.max())
    if not high > low:
        return np.array([low, high]), power.mean(axis=0)[None], np.array([True])
    edges = np.linspace(low, high, bins + 1)
    place = np.clip(((values - low) / (high - low) * bins).astype(int), 0, bins - 1)
    rows = np.bincount(place, minlength=bins)
    sums = np.column_stack([np.bincount(place, weights=column, minlength=bins) for column in power.T])
    return edges, sums / np.maximum(rows, 1)[:, None], rows >= VISITED_ROWS


def _directions(found: Mismatch, powers: Sequence[np.ndarray]) -> dict[str, str]:
    """Whether the mismatch belongs to one direction of motion; an axis that does not move both ways has none."""
    directions = {}
    values = np.concatenate(list(powers)).sum(axis=1)
    for k, axis in enumerate(found.axes):
        speed = np.concatenate([group.speed[:, k] for group in found.groups])
        least = MOVING * float(np.abs(speed).max(initial=0.0))
        forward, backward = speed > least, speed < -least
        if min(forward.sum(), backward.sum()) < VISITED_ROWS:
            continue
        onward, back = float(values[forward].mean()), float(values[backward].mean())
        if max(onward, back) < 1.0:
            continue
        directions[axis] = "positive" if onward > ONE_WAY * back else "negative" if back > ONE_WAY * onward else "both"
    return directions


def _runs(is_on: np.ndarray) -> list[tuple[int, int]]:
    """Begin and end (exclusive) of every run of true values."""
    steps = np.diff(np.concatenate([[0], is_on.astype(int), [0]]))
    return list(zip(np.flatnonzero(steps == 1).tolist(), np.flatnonzero(steps == -1).tolist(), strict=True))


def _joined(is_on: np.ndarray, width: int) -> np.ndarray:
    """Runs with shorter gaps than `width` between them made one."""
    joined = is_on.copy()
    for (_, a), (b, _) in itertools.pairwise(_runs(is_on)):
        if b - a < width:
            joined[a:b] = True
    return joined


def _fill_unvisited(is_on: np.ndarray, is_visited: np.ndarray) -> np.ndarray:
    """A gap that nothing visited, between two places that have the mismatch, has it too."""
    filled = is_on.copy()
    visited = np.flatnonzero(is_visited)
    for a, b in itertools.pairwise(visited):
        if is_on[a] and is_on[b]:
            filled[a : b + 1] = True
    return filled
