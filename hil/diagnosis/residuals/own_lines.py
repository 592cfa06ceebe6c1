"""Lines of a disturbance that the held-out recordings have and the repeats do not.

Noise is what repeats differ by. A disturbance in a narrow band at another frequency in every recording (a pump, a fan, a neighbour's
machine) is in the repeats' spectra where theirs was, not where the held-out recording's is. There it is as much as several times all other
noise, and what held-out recordings say of sets of effects would count as little as that leaves. What no fitted set explains there, in a
narrow band in which training does not stand out, is taken for noise: these lines count by the power they have, as all others do by theirs.

Missing physics acts in training as well, or spans more than a band, and is left as it is. A mode that only the held-out motion excites, and
that no candidate explains, cannot be told from a disturbance.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

STANDS_OUT = 3.0
"""Mean square of whitened lines near each other, of noise 1, from which they are something else: of five lines chance has it with a
probability of 7e-8 with three channels, 7e-6 with two and 9e-4 with one."""

COUNTS = 2.0
"""Mean square from which a line beside the band counts by its own power."""

BAND, SKIRTS, LINES = 0.1, 0.5, 3
"""Half widths of a band and of what may still belong to it, over its frequency, and the least of a band in lines. Of a resonance that is
8 % wide, 76 % lie within the band."""

SMOOTHED, LINES_SMOOTHED = 0.03, 2
"""Half width of the mean over neighbouring lines, over frequency, and the least."""

SLOWEST_Hz = 1.0
"""Of a band: vibrations of floors and of what stands beside are faster (ISO 2631-2 and the vibration criteria of instruments begin here),
and what a slow motion lacks is slower."""

LEAST_LINES = 70
"""Of a record: in a shorter one a band is a tenth of all there is, and no line."""

NARROW = 0.5
"""Share of all that stands out which lies in the bands: less is no line."""

ALSO_THERE = 2.0
"""Mean square of training's lines in a band, from which what stands out is there too."""


def own_lines(
    held_out: Sequence[Sequence[np.ndarray]], training: Sequence[Sequence[np.ndarray]], rate_Hz: float, most: int
) -> list[np.ndarray | None]:
    """Weights of the held-out groups' lines; None where all count as they are.

    Parameters
    ----------
    held_out, training : sequence (groups) of sequence (sets of effects) of (N, C) array
        Whitened residuals. What one of the sets explains is no disturbance.
    rate_Hz : float
        Of the rows.
    most : int
        Bands that disturbances may have at once: one an axis.

    Returns
    -------
    list of (K,) array or None
        For every group, on `numpy.fft.rfftfreq(N)`.
    """
    there = [(_frequencies(group, rate_Hz), _left_by_all(group, rate_Hz)) for group in training]
    return [_weights(_frequencies(group, rate_Hz), _left_by_all(group, rate_Hz), there, most) for group in held_out]


def weighted(rows: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """(N, C) rows with their lines weighted. Linear."""
    return np.fft.irfft(np.fft.rfft(rows, axis=0) * weights[:, None], len(rows), axis=0)


def _frequencies(group: Sequence[np.ndarray], rate_Hz: float) -> np.ndarray:
    return np.fft.rfftfreq(len(group[0]), 1.0 / rate_Hz)


def _left_by_all(group: Sequence[np.ndarray], rate_Hz: float) -> np.ndarray:
    """(K,) least mean square, over the sets, of the lines near every one."""
    frequencies = _frequencies(group, rate_Hz)
    half = np.maximum(SMOOTHED * frequencies, LINES_SMOOTHED * frequencies[1])
    first = np.searchsorted(frequencies, frequencies - half, side="left")
    last = np.searchsorted(frequencies, frequencies + half, side="right")
    least = np.full(len(frequencies), np.inf)
    for rows in group:
        power = np.mean(np.abs(np.fft.rfft(rows, axis=0)) ** 2, axis=1) / len(rows)
        total = np.concatenate([[0.0], np.cumsum(power)])
        least = np.minimum(least, (total[last] - total[first]) / (last - first))
    return least


def _weights(frequencies: np.ndarray, power: np.ndarray, training: Sequence[tuple[np.ndarray, np.ndarray]], most: int) -> np.ndarray | None:
    if len(power) < LEAST_LINES:
        return None
    excess = np.where(power > STANDS_OUT, power - 1.0, 0.0)
    elsewhere = np.max([np.interp(frequencies, places, there) for places, there in training], axis=0)
    free, own, near = power.copy(), np.zeros(len(power), dtype=bool), np.zeros(len(power), dtype=bool)
    free[frequencies < max(SLOWEST_Hz, (LINES + 1) * frequencies[1])] = 0.0
    found = 0
    while found < most:
        k = int(np.argmax(free))
        if free[k] <= STANDS_OUT:
            break
        apart = np.abs(frequencies - frequencies[k])
        band = apart <= max(BAND * frequencies[k], LINES * frequencies[1])
        free[band] = 0.0
        if np.mean(elsewhere[band]) < ALSO_THERE:
            found += 1
            own |= band
            near |= apart <= max(SKIRTS * frequencies[k], LINES * frequencies[1])
    if excess[own].sum() <= NARROW * excess.sum():
        return None
    return np.where(near & (power > COUNTS) & (elsewhere < ALSO_THERE), 1.0 / np.sqrt(np.maximum(power, 1.0)), 1.0)
