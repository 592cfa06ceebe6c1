"""Excitation designed from a first, broad measurement: steps 2 and 3 of Sec. 3.3.

Lines are set where the measured response changes, spaced so that it changes by the same share from line to line, as far as the change
stands out of the noise. With responses at several poses the fastest change of any pose counts, so the whole range of a moving resonance
gets dense lines. Power goes where the measured standard deviation is large beside the response, so that the next measurement has the same
relative uncertainty everywhere.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hil.errors import IdentificationError
from hil.identification.result import FrequencyResponse

SIGNIFICANT = 3.0  # standard deviations by which a change from line to line must stand out
WEIGHT_RANGE = 3.0  # weights stay within this factor of their mean: beyond it a few lines would take the whole crest
LEAST_DENSITY = 0.15  # of the mean: lines per hertz left where the response is smooth, which keeps local windows together
SURROUNDINGS = 1.3  # factor in frequency over which the largest magnitude is what changes are a share of: antiresonances are no peaks
EXCITATION_RMS = "excitation_rms"  # key in a response's settings, followed by an input's name
SPREAD = 2  # measured lines to either side over which a change counts: a resonance lies between lines


@dataclass(frozen=True)
class ExcitationDesign:
    """What the next experiment excites.

    Attributes
    ----------
    lines : (L,) harmonics of the new base period. frequencies_Hz : (L,)
    weights : (L,) relative amplitudes, mean square 1.
    period_samples : of the new base period. sample_rate_Hz : f_s.
    """

    lines: np.ndarray
    frequencies_Hz: np.ndarray
    weights: np.ndarray
    period_samples: int
    sample_rate_Hz: float


def design_excitation(
    responses: Sequence[FrequencyResponse],
    *,
    lines: int,
    band_Hz: tuple[float, float],
    period_samples: int,
    odd: bool = True,
    without: Sequence[int] = (1,),
) -> ExcitationDesign:
    """Choose lines and weights of the next experiment.

    Parameters
    ----------
    responses : of one or more poses, with a covariance.
    lines : how many. band_Hz : between which frequencies.
    period_samples : N of the experiment designed for.
    odd : odd harmonics only, which keeps even distortions off the excited lines.
    without : harmonics to leave out, the jog's.

    Raises
    ------
    IdentificationError
        A band the responses do not cover; fewer harmonics in it than lines asked for.
    """
    first = responses[0]
    rate = first.sample_rate_Hz
    harmonics = np.arange(1, (period_samples + 1) // 2)
    at_Hz = harmonics * rate / period_samples
    usable = (at_Hz >= band_Hz[0]) & (at_Hz <= band_Hz[1]) & ~np.isin(harmonics, without)
    if odd:
        usable &= harmonics % 2 == 1
    harmonics, at_Hz = harmonics[usable], at_Hz[usable]
    if len(harmonics) < lines:
        raise IdentificationError(
            f"{lines} lines asked for, {len(harmonics)} {'odd ' if odd else ''}harmonics of {rate / period_samples:.4g} Hz lie between"
            f" {band_Hz[0]:g} and {band_Hz[1]:g} Hz: lengthen the period or ask for fewer"
        )
    for response in responses:
        measured = response.frequencies_Hz
        if measured[0] > band_Hz[0] * 1.5 or measured[-1] < band_Hz[1] / 1.5:
            raise IdentificationError(
                f"the response covers {measured[0]:g} to {measured[-1]:g} Hz, not the band {band_Hz[0]:g} to {band_Hz[1]:g} Hz"
            )
    density = np.max([_on(at_Hz, response, _change_per_hertz(response)) for response in responses], axis=0)
    chosen = _spread_by_density(density, lines)
    weights = np.max([_on(at_Hz, response, _uncertainty(response)) for response in responses], axis=0)[chosen]
    weights = np.clip(weights / np.sqrt(np.mean(weights**2)), 1.0 / WEIGHT_RANGE, WEIGHT_RANGE)
    return ExcitationDesign(harmonics[chosen], at_Hz[chosen], weights / np.sqrt(np.mean(weights**2)), period_samples, rate)


def _change_per_hertz(response: FrequencyResponse) -> np.ndarray:
    """Return the largest relative change of an element per hertz (L,), less noise, spread over neighbouring lines."""
    G, variance = response.G, response.standard_deviation("noise" if response.total_covariance is None else "total") ** 2
    step = np.diff(response.frequencies_Hz)[:, None, None]
    size = _largest_around(response.frequencies_Hz, np.abs(G))
    size = np.maximum(size[1:], size[:-1])
    noise = variance[1:] + variance[:-1]
    change = np.abs(np.diff(G, axis=0)) ** 2
    real = np.where(change > SIGNIFICANT**2 * noise, np.sqrt(np.maximum(change - noise, 0.0)), 0.0)
    between = np.max(real / (size * step), axis=(1, 2))
    at_lines = np.maximum(np.concatenate((between[:1], between)), np.concatenate((between, between[-1:])))
    padded = np.pad(at_lines, SPREAD, mode="edge")
    fastest: np.ndarray = np.max([padded[k : k + len(at_lines)] for k in range(2 * SPREAD + 1)], axis=0)
    return fastest


def _largest_around(frequencies_Hz: np.ndarray, magnitude: np.ndarray) -> np.ndarray:
    """Return the largest magnitude within a factor of SURROUNDINGS in frequency, (L, n_y, n_u)."""
    low = np.searchsorted(frequencies_Hz, frequencies_Hz / SURROUNDINGS)
    high = np.searchsorted(frequencies_Hz, frequencies_Hz * SURROUNDINGS, side="right")
    return np.stack([magnitude[a:b].max(axis=0) for a, b in zip(low, high, strict=True)])


def _uncertainty(response: FrequencyResponse) -> np.ndarray:
    """Return the relative standard deviation (L,) of the worst output, each output judged by its best-known element."""
    deviation = response.standard_deviation("noise" if response.total_covariance is None else "total")
    least_sure: np.ndarray = np.max(np.min(deviation / np.abs(response.G), axis=2), axis=1)
    return least_sure


def _on(at_Hz: np.ndarray, response: FrequencyResponse, values: np.ndarray) -> np.ndarray:
    interpolated: np.ndarray = np.interp(at_Hz, response.frequencies_Hz, values)
    return interpolated


def _spread_by_density(density: np.ndarray, count: int) -> np.ndarray:
    """Return indices of `count` candidates, equally many per unit of density everywhere, none twice."""
    density = np.maximum(density, LEAST_DENSITY * density.mean() if density.any() else 1.0)
    share = density / density.sum() * count
    for _ in range(len(density)):
        full = share >= 1.0
        if abs(share.sum() - count) < 1e-9 and not (share > 1.0).any():
            break
        share[full] = 1.0
        rest = count - full.sum()
        if rest <= 0 or full.all():
            break
        share[~full] *= rest / share[~full].sum()
    steps = np.floor(np.cumsum(share) + 1e-9)
    return np.flatnonzero(np.diff(np.concatenate(([0.0], steps))) > 0)[:count]
