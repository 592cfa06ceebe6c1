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
ACCURACY = 1e-3
"""Relative error of efforts and of columns, since equations are linearised and motions smoothed: what a set of effects and changes of
numbers would add up to, one by one, is as unsure. It keeps large changes that cancel each other from being fitted to noise."""
MOST = 500.0
"""Factor by which a level may differ from where the search begins; disturbances begin at a five-hundredth of all that a drive gives."""


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
    start = _logs(begin)
    least, most = start - np.log(MOST), start + np.log(MOST)
    least[2 * n : 2 * n + len(lowest)] = np.maximum(least[2 * n : 2 * n + len(lowest)], np.log(_positive(lowest)))
    needed = np.sqrt(np.mean([np.mean(one.signals.needed[some] ** 2, axis=0) for one, *_ in beside], axis=0))
    least[:n] = np.maximum(least[:n], np.log(_positive(ACCURACY * needed)))
    shapes = np.arange(2 * n + len(lowest) + _tones(begin), len(start))
    least[shapes], most[shapes] = start[shapes] - np.log(2.0), start[shapes] + np.log(2.0)  # an octave
    start, most = np.maximum(start, least), np.maximum(most, least)

    def less_likely(logs: np.ndarray) -> tuple[float, np.ndarray]:
        levels, jolted = _with_logs(begin, logs), np.exp(2.0 * logs[n : 2 * n])
        value, slopes = 0.0, np.zeros(len(logs))
        for one, efforts, ends, left, present in beside:
            lin = one.linearised(levels)
            filtered = whitening(lin, present, None, np.tile(jolted, (len(present), 1)))
            squares, begun, process, jolts, reading = _scores(
                lin.stride, lin.transition, lin.of_effort, lin.of_rise, lin.observation, lin.through, filtered.gains, filtered.roots,
                efforts, ends, left, present,
            )  # fmt: skip
            value += 0.5 * (squares + len(left) * filtered.log_determinant)
            states = lin.process * process + lin.start * begun
            phasors = states[len(states) - 2 * _tones(begin) :].reshape(-1, 2).sum(axis=1)
            slopes[: shapes[0] if len(shapes) else None] -= np.concatenate(
                [states[2 * n : 3 * n], jolted * jolts, lin.noise * reading, phasors]
            )
        return value, slopes

    def bounded(logs: np.ndarray) -> tuple[float, np.ndarray]:
        try:
            value, slopes = less_likely(logs)
            for shape in shapes:
                further = np.where(np.arange(len(logs)) == shape, logs + step, logs)
                slopes[shape] = (less_likely(further)[0] - value) / step
        except np.linalg.LinAlgError:  # so uneven that a covariance is lost to rounding: the step was too long
            return nowhere, np.zeros(len(logs))
        return value, slopes

    first, step = less_likely(start)[0], float(np.sqrt(np.finfo(float).eps))
    nowhere = first + abs(first) + 1.0
    bounds = np.column_stack([least, most])
    found = scipy.optimize.minimize(bounded, start, jac=True, method="L-BFGS-B", bounds=bounds)
    return _with_logs(begin, found.x), -float(found.fun)


def _tones(levels: Levels) -> int:
    return 0 if levels.tones is None else len(levels.tones.joints)


def _logs(levels: Levels) -> np.ndarray:
    """Return logarithms of disturbances, jolts, sensors' noise, tones' sizes, and of their frequencies and widths."""
    tones = [] if levels.tones is None else [levels.tones.sizes, levels.tones.frequencies_Hz, levels.tones.widths_Hz]
    jolts = levels.disturbance if levels.jolts is None else levels.jolts
    every = np.concatenate([levels.disturbance, jolts, levels.sensors, *tones])
    logs: np.ndarray = np.log(_positive(every))
    return logs


def _positive(levels: np.ndarray) -> np.ndarray:
    """Return levels whose logarithms are finite."""
    shown: np.ndarray = np.clip(levels, np.finfo(float).tiny, np.finfo(float).max)
    return shown


def _with_logs(levels: Levels, logs: np.ndarray) -> Levels:
    n, count = len(levels.disturbance), _tones(levels)
    ends = np.cumsum([n, n, len(levels.sensors), count, count])
    disturbance, jolts, sensors, sizes, frequencies, widths = np.split(np.exp(logs), ends)
    tones = levels.tones
    if tones is not None:
        tones = replace(tones, sizes=sizes, frequencies_Hz=frequencies, widths_Hz=widths)
    return replace(levels, disturbance=disturbance, jolts=jolts, sensors=sensors, tones=tones)


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
