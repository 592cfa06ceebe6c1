"""Position, speed and acceleration of one joint from its samples: a Kalman smoother whose jerk is constant between rows and white.

Rauch, Tung and Striebel 1965; the process is the piecewise constant one of Bar-Shalom, Li, Kirubarajan 2001, chapter 6: the smoothed
acceleration is linear between rows, exactly, and speed and position are its integrals. Samples may be uneven or missing. The jerk's level,
which is the smoother's bandwidth, is the likeliest one; so is the noise of the samples, which is no less than their resolution makes it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.optimize

from hil.diagnosis.residuals.propagation import times, times_transposed
from virtual_bus.compilation.jit import compiled_for_threads

STATES = 3
SLOW = 0.03
"""Share of the sample rate above which the slow motion follows no more: up to there an acceleration that is linear between two samples
is right to (2 pi 0.03)^2/8 = 0.4 %."""
TINY = 1e-12
"""rad or m: no machine moves less."""
FINEST = 1e-9
"""Share of the samples' spread: noise below it is that of rounding."""
STARTS = ((0.0, 0.0), (0.0, -6.0), (-4.0, 0.0))
"""Where searches for the levels of jerk and noise begin, in powers of ten about what the third differences say: a motion that is fast for
its samples has two optima, one of which takes its fast part for noise."""
UNKNOWN = 10.0
"""Standard deviation of the first state, in units of what the samples' position, speed and acceleration have: no more is known of it."""


@dataclass(frozen=True)
class Smoothed:
    """A motion on a grid of N rows.

    Attributes
    ----------
    position, speed, acceleration : (N,) arrays
        [rad or m], and per second, and per second squared.
    position_deviation, speed_deviation, acceleration_deviation : (N,) arrays
        Their standard deviations.
    slow : (N, 4) array
        Position, speed and acceleration without what is faster than SLOW, and how unsure the speed's direction is: while a joint moves by
        less than a step of its encoder within the smoother's memory, what the encoder rounds away is no white noise.
    noise : float
        Standard deviation of a sample [rad or m].
    jerk : float
        Power spectral density of the jerk [(rad or m)^2/s^5].
    """

    position: np.ndarray
    speed: np.ndarray
    acceleration: np.ndarray
    position_deviation: np.ndarray
    speed_deviation: np.ndarray
    acceleration_deviation: np.ndarray
    slow: np.ndarray
    noise: float
    jerk: float

    def memory_s(self, period_s: float) -> float:
        """Return how long [s] a sample tells of the motion: noise and jerk are as large over it."""
        return float((self.noise**2 * period_s / self.jerk) ** (1.0 / 6.0)) if self.jerk > 0.0 else 0.0


@compiled_for_threads
def _filter(
    gaps: np.ndarray,
    samples: np.ndarray,
    noise: float,
    jerk: float,
    spread: np.ndarray,
    states: np.ndarray,
    covariances: np.ndarray,
    ahead: np.ndarray,
) -> float:
    """Run forward; return minus twice the log likelihood. States and covariances (N, 3), (N, 3, 3) after each row; `ahead` before it."""
    rows = len(samples)
    total = 0.0
    for i in range(3):
        ahead[0, i] = 0.0
        for j in range(3):
            covariances[0, i, j] = 0.0
    first = 0
    while first < rows - 1 and np.isnan(samples[first]):
        first += 1
    x0, x1, x2 = samples[first], 0.0, 0.0
    p00, p01, p02, p11, p12, p22 = spread[0], 0.0, 0.0, spread[1], 0.0, spread[2]
    for k in range(rows):
        if k > 0:
            h = gaps[k - 1]
            h2 = h * h
            x0 += h * x1 + 0.5 * h2 * x2
            x1 += h * x2
            # P = F P F' + Q, F = [[1, h, h^2/2], [0, 1, h], [0, 0, 1]]
            a0 = p00 + h * p01 + 0.5 * h2 * p02
            a1 = p01 + h * p11 + 0.5 * h2 * p12
            a2 = p02 + h * p12 + 0.5 * h2 * p22
            b1 = p11 + h * p12
            b2 = p12 + h * p22
            p00 = a0 + h * a1 + 0.5 * h2 * a2 + jerk * h2 * h2 * h / 36.0
            p01 = a1 + h * a2 + jerk * h2 * h2 / 12.0
            p02 = a2 + jerk * h2 * h / 6.0
            p11 = b1 + h * b2 + jerk * h2 * h / 4.0
            p12 = b2 + jerk * h2 / 2.0
            p22 = p22 + jerk * h
        ahead[k, 0], ahead[k, 1], ahead[k, 2] = x0, x1, x2
        if not np.isnan(samples[k]):
            s = p00 + noise
            e = samples[k] - x0
            g0, g1, g2 = p00 / s, p01 / s, p02 / s
            if k > first + 3:
                total += np.log(s) + e * e / s
            x0 += g0 * e
            x1 += g1 * e
            x2 += g2 * e
            p22 -= g2 * p02
            p12 -= g1 * p02
            p11 -= g1 * p01
            p02 *= noise / s
            p01 *= noise / s
            p00 *= noise / s
        states[k, 0], states[k, 1], states[k, 2] = x0, x1, x2
        covariances[k, 0, 0], covariances[k, 0, 1], covariances[k, 0, 2] = p00, p01, p02
        covariances[k, 1, 0], covariances[k, 1, 1], covariances[k, 1, 2] = p01, p11, p12
        covariances[k, 2, 0], covariances[k, 2, 1], covariances[k, 2, 2] = p02, p12, p22
    return total


@compiled_for_threads
def _smooth(gaps: np.ndarray, jerk: float, states: np.ndarray, covariances: np.ndarray, ahead: np.ndarray, scratch: np.ndarray) -> None:
    """Run backward, in place. `scratch` (4, 3, 3)."""
    f, predicted, gain, inverse = scratch[0], scratch[1], scratch[2], scratch[3]
    for k in range(len(gaps) - 1, -1, -1):
        h = gaps[k]
        h2 = h * h
        f[0, 0], f[0, 1], f[0, 2] = 1.0, h, 0.5 * h2
        f[1, 0], f[1, 1], f[1, 2] = 0.0, 1.0, h
        f[2, 0], f[2, 1], f[2, 2] = 0.0, 0.0, 1.0
        # gain = P F' (F P F' + Q)^-1
        times_transposed(covariances[k], f, gain)
        times(f, gain, predicted)
        predicted[0, 0] += jerk * h2 * h2 * h / 36.0
        predicted[0, 1] += jerk * h2 * h2 / 12.0
        predicted[1, 0] += jerk * h2 * h2 / 12.0
        predicted[0, 2] += jerk * h2 * h / 6.0
        predicted[2, 0] += jerk * h2 * h / 6.0
        predicted[1, 1] += jerk * h2 * h / 4.0
        predicted[1, 2] += jerk * h2 / 2.0
        predicted[2, 1] += jerk * h2 / 2.0
        predicted[2, 2] += jerk * h
        a, b, c = predicted[0, 0], predicted[0, 1], predicted[0, 2]
        d, e, g = predicted[1, 1], predicted[1, 2], predicted[2, 2]
        inverse[0, 0], inverse[0, 1], inverse[0, 2] = d * g - e * e, c * e - b * g, b * e - c * d
        inverse[1, 1], inverse[1, 2], inverse[2, 2] = a * g - c * c, b * c - a * e, a * d - b * b
        determinant = a * inverse[0, 0] + b * inverse[0, 1] + c * inverse[0, 2]
        inverse[1, 0], inverse[2, 0], inverse[2, 1] = inverse[0, 1], inverse[0, 2], inverse[1, 2]
        for i in range(3):
            row0, row1, row2 = gain[i, 0], gain[i, 1], gain[i, 2]
            for j in range(3):
                gain[i, j] = (row0 * inverse[0, j] + row1 * inverse[1, j] + row2 * inverse[2, j]) / determinant
        for i in range(3):
            total = 0.0
            for j in range(3):
                total += gain[i, j] * (states[k + 1, j] - ahead[k + 1, j])
            states[k, i] += total
        for i in range(3):
            for j in range(3):
                inverse[i, j] = covariances[k + 1, i, j] - predicted[i, j]
        times(gain, inverse, f)
        times_transposed(f, gain, inverse)
        for i in range(3):
            for j in range(3):
                covariances[k, i, j] += inverse[i, j]


def _differences(times: np.ndarray, samples: np.ndarray, order: int, period_s: float) -> np.ndarray:
    """Return the differences of samples that follow one another by a period; of all samples where none do."""
    differences = np.diff(samples, order)
    gaps = np.lib.stride_tricks.sliding_window_view(np.diff(times), order)
    even = (gaps < 1.5 * period_s).all(axis=1)
    return differences[even] if even.any() else differences


def smoothed(times: np.ndarray, samples: np.ndarray, resolution: float, grid: np.ndarray) -> Smoothed:
    """Smooth the samples of a joint and read its motion off on a grid.

    Parameters
    ----------
    times, samples : (M,) arrays
        [s] and [rad or m]; NaN where a sample is missing.
    resolution : float
        Smallest step of a sample [rad or m]; 0 is none.
    grid : (N,) array
        Times to read the motion off at.
    """
    there = np.isfinite(samples)
    times, samples = times[there], samples[there]
    together = np.union1d(times, grid)
    values = np.full(len(together), np.nan)
    values[np.searchsorted(together, times)] = samples
    gaps = np.diff(together)
    period = float(np.median(np.diff(times)))
    differences = [_differences(times, samples, order, period) for order in (1, 2, 3)]
    span = float(np.std(samples)) + resolution + TINY
    rates = [float(np.std(differences[order - 1])) / period**order for order in (1, 2)]
    spread = (UNKNOWN * np.array([span, rates[0] + span, rates[1] + span])) ** 2
    rows = len(together)
    states, covariances, ahead = np.zeros((rows, STATES)), np.zeros((rows, STATES, STATES)), np.zeros((rows, STATES))
    least = max(resolution**2 / 12.0, (FINEST * span) ** 2)

    def cost(levels: np.ndarray) -> float:
        return float(_filter(gaps, values, least + 10.0 ** levels[1], 10.0 ** levels[0], spread, states, covariances, ahead))

    roughness = float(np.median(np.abs(differences[2]))) + 1e-3 * np.sqrt(least)
    start = np.array([2.0 * np.log10(roughness / period**3) + np.log10(period), 2.0 * np.log10(0.3 * roughness)])
    searches = [
        scipy.optimize.minimize(cost, start + np.array(shift), method="Nelder-Mead", options={"xatol": 0.02, "fatol": 0.1, "maxiter": 120})
        for shift in STARTS
    ]
    found = min(searches, key=lambda each: float(each.fun))
    jerk, noise = 10.0 ** found.x[0], least + 10.0 ** found.x[1]
    at = np.searchsorted(together, grid)

    def read(level: float) -> np.ndarray:
        _filter(gaps, values, noise, level, spread, states, covariances, ahead)
        _smooth(gaps, level, states, covariances, ahead, np.zeros((4, STATES, STATES)))
        deviations = np.sqrt(np.maximum(np.diagonal(covariances[at], axis1=1, axis2=2), 0.0))
        return np.column_stack([states[at], deviations])

    fast = read(jerk)
    slow = read(min(jerk, noise * period * (2.0 * np.pi * SLOW / period) ** 6))
    bandwidth = (jerk / (noise * period)) ** (1.0 / 6.0)  # rad/s
    direction = np.hypot(fast[:, 4], resolution * bandwidth)
    names = ("position", "speed", "acceleration", "position_deviation", "speed_deviation", "acceleration_deviation")
    return Smoothed(
        **dict(zip(names, fast.T, strict=True)),
        slow=np.column_stack([slow[:, :3], direction]),
        noise=float(np.sqrt(noise)),
        jerk=float(jerk),
    )
