"""How far one signal is another one: gain, correlation and delay, and an effort's balance with the motion that takes it."""

from __future__ import annotations

import numpy as np
import scipy.signal

LATEST_S = 0.1
"""The catalogue has delays of drives and sensors up to here: only beyond is a channel shifted."""
EARLY_ROWS = 3
"""No effort comes later than the motion that it causes; rows and filters of recorders make so many."""
SPEED_SHARE = 0.95
"""Of a motion's speed, in power, that counts as nearly all."""
OWN = 0.25
"""Of an effort's deviation, that the motion must explain beside friction and springs, so that its gain is believed: where it takes no
effort to speak of, the file's errors decide."""
UNSURE = 3.0
"""Times what the motion leaves of an effort, that its gain must make of it: what no term has may be as large among the terms."""


def follows(one: np.ndarray, other: np.ndarray, period_s: float) -> tuple[float, float, float]:
    """Return gain, correlation and delay [s] of one channel (N,) over another, at the delay at which they are most alike."""
    first, second = (running(each) for each in (one, other))
    first, second = first - first.mean(), second - second.mean()
    power, own = float(second @ second), float(first @ first)
    if not (power > 0.0 and own > 0.0):
        return 1.0, 0.0, 0.0
    most = min(round(2.0 * LATEST_S / period_s) + EARLY_ROWS, len(one) // 4)
    products = scipy.signal.correlate(first, second, mode="full", method="fft")[len(second) - 1 - most : len(second) + most]
    best = int(np.argmax(np.abs(products)))
    return float(products[best]) / power, abs(float(products[best])) / np.sqrt(power * own), (best - most) * period_s


def running(values: np.ndarray, rows: int = 5) -> np.ndarray:
    """Return the running mean of a signal (N,) over so many rows (N - rows + 1,)."""
    return np.convolve(values, np.ones(rows) / rows, mode="valid")


def fastest_Hz(position: np.ndarray, period_s: float) -> float:
    """Return the frequency [Hz] below which a motion's speed has nearly all its power; 0 where nothing moves."""
    frequencies, power = scipy.signal.periodogram(np.diff(position), 1.0 / period_s, window="hann")
    whole = np.cumsum(power)
    return float(frequencies[np.searchsorted(whole, SPEED_SHARE * whole[-1])]) if whole[-1] > 0.0 else 0.0


def balanced(
    given: np.ndarray, needed: np.ndarray, position: np.ndarray, speed: np.ndarray, with_springs: bool
) -> tuple[float, float, bool]:
    """Return the share of the effort's power that motion leaves, the gain of what is needed, and whether that is believed.

    Friction may be other than in the file and, `with_springs`, all that depends on position, as gravity. Of a motion of one frequency
    nobody knows an inertia from a spring.
    """
    smooth = np.tanh(3.0 * speed / (float(np.std(speed)) or 1.0))
    centred = (position - position.mean()) / (float(np.std(position)) or 1.0)
    springs = (centred, centred**2, centred**3, np.sin(position), np.cos(position)) if with_springs else ()
    matrix = np.column_stack((needed, speed, smooth, np.ones(len(speed)), *springs))
    norms = np.maximum(np.sqrt(np.mean(matrix**2, axis=0)), 1e-12)
    matrix = matrix / norms
    target = given - given.mean()
    power = float(target @ target)
    if power <= 0.0:
        return 1.0, 1.0, False
    weights = np.linalg.lstsq(matrix, given, rcond=1e-6)[0]
    own = matrix[:, 0] - matrix[:, 1:] @ np.linalg.lstsq(matrix[:, 1:], matrix[:, 0], rcond=1e-6)[0]
    left = given - matrix @ weights
    is_believed = bool(abs(weights[0]) * np.std(own) > max(OWN * np.std(given), UNSURE * np.std(left)))
    return float(left @ left) / power, float(weights[0]) / norms[0], is_believed
