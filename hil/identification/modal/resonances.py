"""Resonances that a frequency response supports: frequency, damping ratio and their 95 % bounds, from a parametric fit with covariance.

Pairs of poles, common to all elements, are fitted by maximum likelihood (`hil.identification.modal.one_pose`, Sec. 5.4.3), as many as the
BIC finds in the data. The poles' covariance follows from that of the response; frequency and damping take theirs from it to first order.
Where the model leaves more than noise, the covariance is scaled by what it leaves. Weights that are estimated from few periods cost
efficiency, by which it is scaled, too. A machine that jogs shows its modes averaged over that motion.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import special

from hil.errors import IdentificationError
from hil.identification.modal.one_pose import PoseModes, choose_pairs
from hil.identification.result import FrequencyResponse

METHOD = "maximum-likelihood fit of common pole pairs, as many as the BIC finds; bounds from the response's covariance"

LIGHT = 0.5
"""Damping ratio from which a pair of poles is no resonance: its response has hardly a peak."""

KNOWN_Hz = 0.1
"""Widest bound of a frequency, to either side and as a share of it, with which a pair of poles counts as a resonance of the machine."""

KNOWN_DAMPING = 1.0
"""The same of a damping ratio: with more it is not told from an undamped one."""

FEWEST_DOF = 3.0
"""Complex degrees of freedom with which the cost of estimated weights is finite; fewer count as these."""

BELOW = 1.0
"""Fewest lines below a resonance and above it, within which it must lie: a peak at the edge of the band is a guess."""


@dataclass(frozen=True)
class Resonance:
    """A vibrating mode.

    Attributes
    ----------
    frequency_Hz, damping : undamped natural frequency and damping ratio.
    frequency_ci95_Hz, damping_ci95 : lower and upper bound at 95 %.
    output, input : names of the element in which its peak stands out most from the noise.
    covariance : of frequency [Hz] and damping ratio.
    """

    frequency_Hz: float
    damping: float
    frequency_ci95_Hz: tuple[float, float]
    damping_ci95: tuple[float, float]
    output: str
    input: str
    covariance: tuple[tuple[float, float], tuple[float, float]]

    @property
    def line(self) -> str:
        """Return the resonance in words."""
        half_Hz = 0.5 * (self.frequency_ci95_Hz[1] - self.frequency_ci95_Hz[0])
        half = 0.5 * (self.damping_ci95[1] - self.damping_ci95[0])
        digits = int(np.clip(1 - np.floor(np.log10(max(half_Hz, 1e-6))), 1, 6))
        places = int(np.clip(1 - np.floor(np.log10(max(100.0 * half, 1e-6))), 1, 6))
        return (
            f"{self.frequency_Hz:.{digits}f} Hz ± {half_Hz:.{digits}f} Hz, damping {100.0 * self.damping:.{places}f} %"
            f" ± {100.0 * half:.{places}f} %, clearest in {self.input} -> {self.output}"
        )


@dataclass(frozen=True)
class Resonances:
    """The resonances of a frequency response.

    Attributes
    ----------
    found : rising in frequency.
    reason : why there are none; "" where there are some.
    misfit : what the fit leaves in units of the noise's variance, 1 for noise alone; NaN where nothing was fitted.
    """

    found: tuple[Resonance, ...]
    reason: str
    misfit: float


def resonances(response: FrequencyResponse, probability: float = 0.95) -> Resonances:
    """Return the resonances in the band of a frequency response that its covariance supports.

    Parameters
    ----------
    response : FrequencyResponse
        With independent errors from line to line for the bounds to hold: BLA or robust local methods.
    probability : float
        Of the bounds.

    Examples
    --------
    A resonance at 8 Hz with 5 % of damping, sampled at 200 Hz, and noise.

    >>> import hil
    >>> import numpy as np
    >>> from scipy.signal import lfilter
    >>> (plan,) = hil.Multisine(period_s=2.0, periods=4, jog=None).plans(hil.open_machine("turntable"))
    >>> command, noise = plan.excitation[:, 0], np.random.default_rng(0).normal(0.0, 1e-6, plan.rows)
    >>> pole = np.exp(2.0 * np.pi * 8.0 * (-0.05 + 1j * np.sqrt(1.0 - 0.05**2)) / 200.0)
    >>> answered = lfilter([0.0, 1e-3], [1.0, -2.0 * pole.real, abs(pole) ** 2], command) + noise
    >>> signals = {"time": ("s", np.arange(plan.rows) / 200.0), "excitation_turn": ("A", command), "command_turn": ("A", command)}
    >>> signals["position_turn"] = ("rad", answered)
    >>> recording = hil.Recording({name: hil.Channel(*each) for name, each in signals.items()}, {"experiment": plan.metadata})
    >>> (mode,) = hil.resonances(hil.identify(recording, "fast_bla")).found
    >>> round(mode.frequency_Hz, 2), round(mode.damping, 3)
    (8.0, 0.05)
    """
    if response.noise_covariance is None:
        return Resonances((), "the response has no noise covariance; record two periods or more", np.nan)
    try:
        with np.errstate(all="ignore"):
            fit = choose_pairs(response)
    except IdentificationError as error:
        return Resonances((), str(error), np.nan)
    except (np.linalg.LinAlgError, ValueError) as error:
        return Resonances((), f"no pair of poles fits the response ({error})", np.nan)
    found = tuple(each for k in range(len(fit.a0)) if (each := _resonance(response, fit, k, probability)) is not None)
    low, high = response.frequencies_Hz[[0, -1]]
    return Resonances(found, "" if found else f"no resonance between {low:.3g} and {high:.4g} Hz stands out from the noise", fit.misfit)


def _resonance(response: FrequencyResponse, fit: PoseModes, k: int, probability: float) -> Resonance | None:
    """Return a pair of poles as a resonance; None where it is none, or not known well enough."""
    a0, a1, count = float(fit.a0[k]), float(fit.a1[k]), len(fit.a0)
    lines_Hz = response.frequencies_Hz
    if a0 <= 0.0 or a1 <= 0.0:
        return None
    omega = np.sqrt(a0)
    frequency, damping = omega / (2.0 * np.pi), a1 / (2.0 * omega)
    if damping >= LIGHT or np.sum(lines_Hz < frequency) < BELOW or np.sum(lines_Hz > frequency) < BELOW:
        return None
    slope = np.array([[1.0 / (4.0 * np.pi * omega), 0.0], [-damping / (2.0 * a0), 1.0 / (2.0 * omega)]])
    at = [k, count + k]
    scale = max(fit.misfit, 1.0) * _cost_of_weights(response)
    covariance = slope @ fit.pole_covariance[np.ix_(at, at)] @ slope.T * scale
    half = special.ndtri(0.5 + 0.5 * probability) * np.sqrt(np.maximum(np.diagonal(covariance), 0.0))
    if not (half[0] < KNOWN_Hz * frequency and half[1] < KNOWN_DAMPING * damping):
        return None
    output, source = _clearest(response, fit, k)
    return Resonance(
        float(frequency),
        float(damping),
        (float(frequency - half[0]), float(frequency + half[0])),
        (float(damping - half[1]), float(damping + half[1])),
        output,
        source,
        ((float(covariance[0, 0]), float(covariance[0, 1])), (float(covariance[1, 0]), float(covariance[1, 1]))),
    )


def _cost_of_weights(response: FrequencyResponse) -> float:
    """Return by how much the variance of a fit is larger for weights 1 / s^2 that are estimated with nu complex degrees of freedom.

    It is E[w^2 s^2] / E[w]^2 for w = 1 / s^2 of a gamma variable of shape nu, (nu - 1) / (nu - 2), and finite from three on.
    """
    nu = max(float(np.median(response.noise_dof)), FEWEST_DOF)
    return (nu - 1.0) / (nu - 2.0)


def _clearest(response: FrequencyResponse, fit: PoseModes, k: int) -> tuple[str, str]:
    """Return the output and the input between which a pair's peak is largest against the noise at the nearest line."""
    omega = np.sqrt(fit.a0[k])
    peak = np.abs(fit.N0[k] + 1j * omega * fit.N1[k]) / (omega * fit.a1[k])
    near = int(np.argmin(np.abs(response.frequencies_Hz - omega / (2.0 * np.pi))))
    noise = response.standard_deviation("noise")[near]
    i, j = np.unravel_index(int(np.argmax(peak / np.maximum(noise, np.finfo(float).tiny))), peak.shape)
    return response.output_names[i], response.input_names[j]
