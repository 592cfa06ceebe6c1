"""Continuous-time controller terms, discretised at the sample rate (Tustin, exact at the term's own frequency).

Each returns rows (n, 6) for `controllers.sections`; `cascade` stacks them.
"""

from __future__ import annotations

import numpy as np
import scipy.signal

from controllers.errors import DesignError


def cascade(*terms: np.ndarray) -> np.ndarray:
    """Stack terms (n_i, 6) in series: (sum n_i, 6)."""
    return np.vstack(terms)


def gain(value: float) -> np.ndarray:
    """Return a constant gain as one section."""
    return np.array([[value, 0.0, 0.0, 1.0, 0.0, 0.0]])


def pid(proportional: float, integral: float, derivative: float, derivative_filter_Hz: float, sample_rate_Hz: float) -> np.ndarray:
    """Kp + Ki/s + Kd s / (s/w_f + 1), w_f = 2 pi derivative_filter_Hz; Tustin exact at derivative_filter_Hz.

    Gains in command unit per position unit, per position unit and second, and times second.
    """
    w = 2.0 * np.pi * derivative_filter_Hz
    numerator = [proportional / w + derivative, proportional + integral / w, integral]
    return _tustin(numerator, [1.0 / w, 1.0, 0.0], derivative_filter_Hz, sample_rate_Hz)


def lead(center_Hz: float, phase_deg: float, sample_rate_Hz: float) -> np.ndarray:
    """Return a lead with its largest phase, `phase_deg`, at `center_Hz` and unit gain there."""
    if not 0.0 < phase_deg < 90.0:
        raise DesignError(f"lead of {phase_deg:g} deg: one term gives between 0 and 90 deg; use two of {phase_deg / 2:g} deg")
    root_spread = np.tan(np.radians(45.0 + phase_deg / 2.0))
    w = 2.0 * np.pi * center_Hz
    return _tustin([root_spread / w, 1.0], [1.0 / w, root_spread], center_Hz, sample_rate_Hz)


def lag(pole_Hz: float, zero_Hz: float, sample_rate_Hz: float) -> np.ndarray:
    """(s + w_zero) / (s + w_pole): gain zero/pole at low, 1 at high frequency; pole_Hz = 0 is an integrator with its corner at zero_Hz."""
    if not 0.0 <= pole_Hz < zero_Hz:
        raise DesignError(f"lag with pole at {pole_Hz:g} Hz and zero at {zero_Hz:g} Hz: the pole must be below the zero and not negative")
    return _tustin([1.0, 2.0 * np.pi * zero_Hz], [1.0, 2.0 * np.pi * pole_Hz], zero_Hz, sample_rate_Hz)


def notch(frequency_Hz: float, depth: float, damping: float, sample_rate_Hz: float) -> np.ndarray:
    """(s^2 + 2 depth damping w s + w^2) / (s^2 + 2 damping w s + w^2): gain `depth` at the notch, 1 far from it."""
    w = 2.0 * np.pi * frequency_Hz
    return _tustin([1.0, 2.0 * depth * damping * w, w * w], [1.0, 2.0 * damping * w, w * w], frequency_Hz, sample_rate_Hz)


def lowpass(frequency_Hz: float, damping: float, sample_rate_Hz: float) -> np.ndarray:
    """Return the second-order low pass w^2 / (s^2 + 2 damping w s + w^2)."""
    w = 2.0 * np.pi * frequency_Hz
    return _tustin([w * w], [1.0, 2.0 * damping * w, w * w], frequency_Hz, sample_rate_Hz)


def _tustin(numerator: list[float], denominator: list[float], match_Hz: float, sample_rate_Hz: float) -> np.ndarray:
    """Return one section (1, 6) whose response at match_Hz is the continuous term's."""
    if not 0.0 < match_Hz < sample_rate_Hz / 2.0:
        raise DesignError(
            f"a term at {match_Hz:g} Hz at {sample_rate_Hz:g} Hz sample rate: it must lie between 0 and {sample_rate_Hz / 2.0:g} Hz"
        )
    # bilinear() maps s to 2 fs (z - 1)/(z + 1); this fs makes the map exact at match_Hz
    warped_rate = np.pi * match_Hz / np.tan(np.pi * match_Hz / sample_rate_Hz)
    b, a = scipy.signal.bilinear(numerator, denominator, warped_rate)
    section = np.zeros((1, 6))
    section[0, : len(b)] = b
    section[0, 3 : 3 + len(a)] = a
    if abs(1.0 + section[0, 4:].sum()) < 1e-12:
        # a pole meant for z = 1 is put there exactly: an integrator off by rounding would drift over a long run
        section[0, 4] = -1.0 - section[0, 5]
    return section
