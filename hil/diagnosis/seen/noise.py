"""Levels of the noise: of the disturbances on the joints and of the sensors, by expectation maximisation.

Shumway and Stoffer 1982; the smoothed noises come from the adjoint states of the Bryson-Frazier smoother.
"""

from __future__ import annotations

from collections.abc import Sequence

import numba
import numpy as np

from hil.diagnosis.seen.beside import Beside, Levels
from hil.diagnosis.seen.filtering import whitening

ITERATIONS = 8
"""Of expectation maximisation: levels that are a hundred times off arrive within a few per cent."""
LONG_STEP = 0.8
"""Power of the variance's factor that a disturbance's level takes: its own step is 0.5, which is slow; 1 runs past and back for ever."""
LONGEST_ROWS = 1200
"""Rows of a recording that levels are taken from: a level's error over so many is a thirtieth."""


def levels_from(
    parts: Sequence[tuple[Beside, np.ndarray, np.ndarray, np.ndarray]], begin: Levels, lowest: np.ndarray, iterations: int = ITERATIONS
) -> Levels:
    """Return the likeliest levels.

    Parameters
    ----------
    parts : sequence of (Beside, missing, missing ends, left)
        What is to be explained by noise, beside the equations that it passes through.
    begin : Levels
    lowest : (m + axes,) array
        What a sensor's lattice alone makes of its noise.
    """
    disturbance, sensors = begin.disturbance.copy(), begin.sensors.copy()
    n = len(disturbance)
    for _ in range(iterations):
        levels = Levels(disturbance, begin.corner_Hz, sensors)
        process, reading, rows, counts = np.zeros(n), np.zeros(len(sensors)), 0, np.zeros(len(sensors))
        for beside, missing, ends, left in parts:
            some = slice(0, min(len(left), LONGEST_ROWS))
            lin = beside.linearised(levels)
            present = ~np.isnan(left[some])
            filtered = whitening(lin, present)
            p, r = _scores(
                lin.stride, lin.transition, lin.of_effort, lin.of_rise, lin.observation, lin.through, filtered.gains, filtered.roots,
                missing[some], ends[some], np.nan_to_num(left[some]), present,
            )  # fmt: skip
            process += p[2 * n : 3 * n]
            reading += r
            rows += len(present)
            counts += present.sum(axis=0)
        decay = np.exp(-2.0 * np.pi * begin.corner_Hz * parts[0][0].along.observed.period_s)
        q = disturbance**2 * (1.0 - decay**2)
        grown = 1.0 + q * process / max(rows, 1)
        disturbance = disturbance * np.clip(grown, 0.01, 100.0) ** LONG_STEP
        shrunk = 1.0 + sensors**2 * reading / np.maximum(counts, 1.0)
        sensors = np.maximum(sensors * np.sqrt(np.clip(shrunk, 0.01, 100.0)), lowest)
    return Levels(disturbance, begin.corner_Hz, sensors)


@numba.njit(cache=True, fastmath=False)
def _scores(
    stride: int,
    transition: np.ndarray,
    of_effort: np.ndarray,
    of_rise: np.ndarray,
    observation: np.ndarray,
    through: np.ndarray,
    gains: np.ndarray,
    roots: np.ndarray,
    efforts: np.ndarray,
    ends: np.ndarray,
    readings: np.ndarray,
    present: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the sums over rows of adjoint squares less their variances: per state (s,) and per reading (m,)."""
    rows, channels = readings.shape
    size = transition.shape[1]
    innovations = np.zeros((rows, channels))
    x = np.zeros(size)
    for k in range(rows):
        number = k // stride
        v = readings[k] - np.dot(observation[number], x) - np.dot(through[number], efforts[k])
        for c in range(channels):
            if not present[k, c]:
                v[c] = 0.0
        innovations[k] = v
        x = np.dot(transition[number], x + np.dot(gains[k], v))
        x += np.dot(of_effort[number], efforts[k]) + np.dot(of_rise[number], ends[k] - efforts[k])
    adjoint, weight = np.zeros(size), np.zeros((size, size))
    process, reading = np.zeros(size), np.zeros(channels)
    for k in range(rows - 1, -1, -1):
        number = k // stride
        h = observation[number]
        gain = gains[k]
        inverse = np.dot(roots[k].T.copy(), roots[k])
        u = np.dot(inverse, innovations[k]) + np.dot(gain.T.copy(), adjoint)
        variance = inverse + np.dot(np.dot(gain.T.copy(), weight), gain)
        for c in range(channels):
            if present[k, c]:
                reading[c] += u[c] * u[c] - variance[c, c]
        back = np.eye(size) - np.dot(gain, h)
        adjoint = np.dot(back.T.copy(), adjoint) - np.dot(h.T.copy(), np.dot(inverse, innovations[k]))
        weight = np.dot(np.dot(back.T.copy(), weight), back) + np.dot(np.dot(h.T.copy(), inverse), h)
        if k > 0:
            for i in range(size):
                process[i] += adjoint[i] * adjoint[i] - weight[i, i]
            a = transition[(k - 1) // stride]
            adjoint = np.dot(a.T.copy(), adjoint)
            weight = np.dot(np.dot(a.T.copy(), weight), a)
    return process, reading
