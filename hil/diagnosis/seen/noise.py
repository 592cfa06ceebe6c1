"""Levels of the noise: of the disturbances on the joints and of the sensors, the likeliest ones.

The likelihood's slopes come from the adjoint states of the Bryson-Frazier smoother (Segal and Weinstein 1989).
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace

import numba
import numpy as np
import scipy.optimize

from hil.diagnosis.seen.beside import Beside, Levels
from hil.diagnosis.seen.filtering import whitening

LONGEST_ROWS = 1200
"""Rows of a recording that levels are taken from: a level's error over so many is a thirtieth."""
STEPS = 60
"""Of the search for the likeliest levels, at most."""
LEAST, MOST = 1e-4, 500.0
"""Factors by which a level may differ from where the search begins; disturbances begin at a five-hundredth of all that a drive gives."""
SETTLED = 0.1
"""Units of log likelihood below which a step ends the search."""
UNLIKELY = 1e6
"""In the same units, of levels that the filter cannot be computed with."""


def levels_from(
    parts: Sequence[tuple[Beside, np.ndarray, np.ndarray, np.ndarray]], begin: Levels, lowest: np.ndarray
) -> tuple[Levels, float]:
    """Return the likeliest levels at this corner, and the log likelihood of noise alone, up to a constant.

    Logarithms of the levels are sought by a quasi-Newton method within bounds (L-BFGS-B, Byrd, Lu, Nocedal and Zhu 1995). Expectation
    maximisation crawls where a disturbance is below what the sensors show in one row, and stays far from the likeliest levels.

    Parameters
    ----------
    parts : sequence of (Beside, missing, missing ends, left)
        What is to be explained by noise, beside the equations that it passes through. Parts beside the same ones follow each other, and
        lack the same readings.
    begin : Levels
    lowest : (m + axes,) array
        What a sensor's lattice alone makes of its noise.
    """
    n = len(begin.disturbance)
    some = slice(0, LONGEST_ROWS)
    beside = []
    for one, same in itertools.groupby(parts, key=lambda part: part[0]):
        rows_of = zip(*((efforts[some], ends[some], left[some]) for _, efforts, ends, left in same), strict=True)
        efforts, ends, left = (np.stack(each) for each in rows_of)
        beside.append((one, efforts, ends, np.nan_to_num(left), ~np.isnan(left[0])))
    first = np.concatenate([begin.disturbance, begin.disturbance, begin.sensors])
    least = np.concatenate([LEAST * first[: 2 * n], np.maximum(lowest, LEAST * begin.sensors)])

    def at(logs: np.ndarray) -> Levels:
        disturbance, jolts, sensors = np.split(np.exp(logs), [n, 2 * n])
        return replace(begin, disturbance=disturbance, jolts=jolts, sensors=sensors)

    def less_likely(logs: np.ndarray) -> tuple[float, np.ndarray]:
        levels = at(logs)
        value, slopes = 0.0, np.zeros(len(logs))
        for one, efforts, ends, left, present in beside:
            lin = one.linearised(levels)
            filtered = whitening(lin, present, None, np.tile(levels.jolts**2, (len(present), 1)))
            squares, start, process, jolts, reading = _scores(
                lin.stride, lin.transition, lin.of_effort, lin.of_rise, lin.observation, lin.through, filtered.gains, filtered.roots,
                efforts, ends, left, present,
            )  # fmt: skip
            value += 0.5 * (squares + len(left) * filtered.log_determinant)
            slopes[:n] -= lin.process[2 * n : 3 * n] * process[2 * n : 3 * n] + levels.disturbance**2 * start[2 * n : 3 * n]
            slopes[n : 2 * n] -= levels.jolts**2 * jolts
            slopes[2 * n :] -= lin.noise * reading
        return value, slopes

    def bounded(logs: np.ndarray) -> tuple[float, np.ndarray]:
        try:
            return less_likely(logs)
        except np.linalg.LinAlgError:  # so uneven that a covariance is lost to rounding: the step was too long
            return nowhere, np.zeros(len(logs))

    start = np.log(np.maximum(first, least))
    begun = less_likely(start)[0]
    nowhere = begun + UNLIKELY
    options = {"maxiter": STEPS, "ftol": SETTLED / max(abs(begun), 1.0)}
    bounds = np.log(np.column_stack([least, np.maximum(MOST * first, least)]))
    found = scipy.optimize.minimize(bounded, start, jac=True, method="L-BFGS-B", bounds=bounds, options=options)
    return at(found.x), -float(found.fun)


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
) -> tuple[float, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return sums over parts: squared innovations, and over rows, of adjoint squares less their variances.

    These are of the state at row 0 (s,), of what every later row adds to it (s,), of efforts held over a row (n,), and of readings (m,).
    """
    parts, rows, channels = readings.shape
    size = transition.shape[1]
    innovations = np.zeros((parts, rows, channels))
    x = np.zeros((parts, size))
    for k in range(rows):
        number = k // stride
        for part in range(parts):
            v = readings[part, k] - np.dot(observation[number], x[part]) - np.dot(through[number], efforts[part, k])
            for c in range(channels):
                if not present[k, c]:
                    v[c] = 0.0
            innovations[part, k] = v
            x[part] = np.dot(transition[number], x[part] + np.dot(gains[k], v))
            x[part] += np.dot(of_effort[number], efforts[part, k]) + np.dot(of_rise[number], ends[part, k] - efforts[part, k])
    adjoint, weight = np.zeros((parts, size)), np.zeros((size, size))
    start, process, reading = np.zeros(size), np.zeros(size), np.zeros(channels)
    jolts = np.zeros(of_effort.shape[2])
    squares = 0.0
    for k in range(rows - 1, -1, -1):
        number = k // stride
        h = observation[number]
        gain = gains[k]
        inverse = np.dot(roots[k].T.copy(), roots[k])
        variance = inverse + np.dot(np.dot(gain.T.copy(), weight), gain)
        back = np.eye(size) - np.dot(gain, h)
        before = max(k - 1, 0) // stride
        a, b = transition[before], of_effort[before]
        for part in range(parts):
            v = np.dot(inverse, innovations[part, k])
            squares += np.dot(innovations[part, k], v)
            u = v + np.dot(gain.T.copy(), adjoint[part])
            for c in range(channels):
                if present[k, c]:
                    reading[c] += u[c] * u[c] - variance[c, c]
            adjoint[part] = np.dot(back.T.copy(), adjoint[part]) - np.dot(h.T.copy(), v)
        weight = np.dot(np.dot(back.T.copy(), weight), back) + np.dot(np.dot(h.T.copy(), inverse), h)
        added = process if k > 0 else start
        for part in range(parts):
            for i in range(size):
                added[i] += adjoint[part, i] * adjoint[part, i] - weight[i, i]
            if k > 0:
                pushed, unsure = np.dot(b.T.copy(), adjoint[part]), np.dot(np.dot(b.T.copy(), weight), b)
                for j in range(len(jolts)):
                    jolts[j] += pushed[j] * pushed[j] - unsure[j, j]
            adjoint[part] = np.dot(a.T.copy(), adjoint[part])
        weight = np.dot(np.dot(a.T.copy(), weight), a)
    return squares, start, process, jolts, reading
