"""Levels of the noise: of the disturbances on the joints and of the sensors, the likeliest ones.

The likelihood's slopes come from the adjoint states of the Bryson-Frazier smoother (Segal and Weinstein 1989).
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import scipy.optimize

from hil.diagnosis.residuals.equation_errors import EquationErrors, Levels
from hil.diagnosis.residuals.propagation import exactly_compiled, times, transposed_times
from hil.diagnosis.residuals.whitening import whitening

LONGEST_ROWS = 1200
"""Rows of a recording that levels are taken from: a level's error over so many is a thirtieth."""
ACCURACY = 1e-3
"""Relative error of efforts and of columns, since equations are linearised and motions smoothed: what a set of effects and changes of
numbers would add up to, one by one, is as unsure. It keeps large changes that cancel each other from being fitted to noise."""
MOST = 500.0
"""Factor by which a level may differ from where the search begins; disturbances begin at a five-hundredth of all that a drive gives."""


def levels_from(
    parts: Sequence[tuple[EquationErrors, np.ndarray, np.ndarray, np.ndarray]], begin: Levels, lowest: np.ndarray
) -> tuple[Levels, float]:
    """Return the likeliest levels at this corner, and the log likelihood of noise alone, up to a constant.

    Logarithms of the levels are sought by a quasi-Newton method within bounds (L-BFGS-B, Byrd, Lu, Nocedal and Zhu 1995). Expectation
    maximisation crawls where a disturbance is below what the sensors show in one row, and stays far from the likeliest levels.

    Parameters
    ----------
    parts : sequence of (EquationErrors, missing, missing ends, left)
        What is to be explained by noise, beside the equations that it passes through. Parts beside the same ones follow each other, and
        lack the same readings.
    begin : Levels
    lowest : (m + axes,) array
        What a sensor's lattice alone makes of its noise.
    """
    n = len(begin.disturbance)
    some = slice(0, LONGEST_ROWS)
    stacked = []
    for one, same in itertools.groupby(parts, key=lambda part: part[0]):
        rows_of = zip(*((efforts[some], ends[some], left[some]) for _, efforts, ends, left in same), strict=True)
        efforts, ends, left = (np.stack(each, axis=-1) for each in rows_of)
        stacked.append((one, efforts, ends, np.nan_to_num(left), ~np.isnan(left[..., 0])))
    start = _logs(begin)
    least, most = start - np.log(MOST), start + np.log(MOST)
    least[2 * n : 2 * n + len(lowest)] = np.maximum(least[2 * n : 2 * n + len(lowest)], np.log(_positive(lowest)))
    needed = np.sqrt(np.mean([np.mean(one.signals.needed[some] ** 2, axis=0) for one, *_ in stacked], axis=0))
    least[:n] = np.maximum(least[:n], np.log(_positive(ACCURACY * needed)))
    shapes = np.arange(2 * n + len(lowest) + _tones(begin), len(start))
    least[shapes], most[shapes] = start[shapes] - np.log(2.0), start[shapes] + np.log(2.0)  # an octave
    start, most = np.maximum(start, least), np.maximum(most, least)

    def less_likely(logs: np.ndarray) -> tuple[float, np.ndarray]:
        levels, jolted = _with_logs(begin, logs), np.exp(2.0 * logs[n : 2 * n])
        value, slopes = 0.0, np.zeros(len(logs))
        for one, efforts, ends, left, present in stacked:
            lin = one.linearised(levels)
            filtered = whitening(lin, present, None, np.tile(jolted, (len(present), 1)))
            rows, channels, count = left.shape
            whitened = np.zeros((rows * channels, count))
            filtered.columns(efforts, ends, left, 0, np.zeros((lin.transition.shape[1], count)), whitened)
            value += 0.5 * (float(np.sum(whitened**2)) + count * filtered.log_determinant)
            begun, process, jolts, reading = _scores(
                lin.stride, lin.transition, lin.of_effort, lin.observation, filtered.gains, filtered.roots, whitened.reshape(left.shape),
                present,
            )  # fmt: skip
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
    return np.asarray(np.log(_positive(every)))


def _positive(levels: np.ndarray) -> np.ndarray:
    """Return levels whose logarithms are finite."""
    return np.asarray(np.clip(levels, np.finfo(float).tiny, np.finfo(float).max))


def _with_logs(levels: Levels, logs: np.ndarray) -> Levels:
    n, count = len(levels.disturbance), _tones(levels)
    ends = np.cumsum([n, n, len(levels.sensors), count, count])
    disturbance, jolts, sensors, sizes, frequencies, widths = np.split(np.exp(logs), ends)
    tones = levels.tones
    if tones is not None:
        tones = replace(tones, sizes=sizes, frequencies_Hz=frequencies, widths_Hz=widths)
    return replace(levels, disturbance=disturbance, jolts=jolts, sensors=sensors, tones=tones)


@exactly_compiled
def _scores(
    stride: int,
    transition: np.ndarray,
    of_effort: np.ndarray,
    observation: np.ndarray,
    gains: np.ndarray,
    roots: np.ndarray,
    whitened: np.ndarray,
    present: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return sums over rows, and over parts whose whitened innovations (N, m, parts) are given, of adjoint squares less their variances.

    These are of the state at row 0 (s,), of what every later row adds to it (s,), of efforts held over a row (n,), and of readings (m,).
    """
    rows, channels, parts = whitened.shape
    size, joints = transition.shape[1], of_effort.shape[2]
    adjoint, carried, weight, work = np.zeros((size, parts)), np.zeros((size, parts)), np.zeros((size, size)), np.zeros((size, size))
    inverse, of_gain = np.zeros((channels, channels)), np.zeros((size, channels))
    u, more = np.zeros((channels, parts)), np.zeros((channels, parts))
    weighed, across = np.zeros((channels, size)), np.zeros((channels, size))
    pushed, of_push = np.zeros((joints, parts)), np.zeros((size, joints))
    start, process, jolts, reading = np.zeros(size), np.zeros(size), np.zeros(joints), np.zeros(channels)
    for k in range(rows - 1, -1, -1):
        h, gain, before = observation[k // stride], gains[k], max(k - 1, 0) // stride
        transposed_times(roots[k], roots[k], inverse)
        times(weight, gain, of_gain)
        transposed_times(roots[k], whitened[k], u)
        transposed_times(gain, adjoint, more)
        u += more
        for c in range(channels):
            if present[k, c]:
                reading[c] -= parts * inverse[c, c]
                for i in range(size):
                    reading[c] -= parts * gain[i, c] * of_gain[i, c]
                for part in range(parts):
                    reading[c] += u[c, part] ** 2
        transposed_times(h, u, carried)
        adjoint -= carried
        times(of_gain, h, work)
        weight -= work  # (1 - gain h), and then h' of what that leaves
        times(inverse, h, weighed)
        transposed_times(gain, weight, across)
        weighed -= across
        transposed_times(h, weighed, work)
        weight += work
        added = process if k > 0 else start
        for i in range(size):
            added[i] -= parts * weight[i, i]
            for part in range(parts):
                added[i] += adjoint[i, part] ** 2
        if k > 0:
            times(weight, of_effort[before], of_push)
            transposed_times(of_effort[before], adjoint, pushed)
            for j in range(joints):
                for i in range(size):
                    jolts[j] -= parts * of_effort[before, i, j] * of_push[i, j]
                for part in range(parts):
                    jolts[j] += pushed[j, part] ** 2
        transposed_times(transition[before], adjoint, carried)
        for i in range(size):
            for part in range(parts):
                adjoint[i, part] = carried[i, part]
        times(weight, transition[before], work)
        transposed_times(transition[before], work, weight)
    return start, process, jolts, reading
