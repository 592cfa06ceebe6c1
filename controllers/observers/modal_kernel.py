"""One step of the observer, compiled: schedule, prediction, measurement update, and the estimate that is published.

One skeleton serves the three filters of Sec. 5.3; they differ in where the model is asked:
KF (Sec. 5.3.1)   output rows from the machine at rest in the estimated pose;
EKF (Sec. 5.3.2)  differences over one deviation either way, about the estimate (5.12);
UKF (Sec. 5.3.3)  sigma points at √n deviations with equal weights: (5.15)-(5.26) with κ = 0, and with the Q that (5.19) omits.
With n + κ = 3 and 24 states the centre's weight would be -7 and the covariance indefinite.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from controllers.compiled import exactly_called, exactly_compiled
from controllers.observers.modal_equations import SENSOR_SIGNALS, prepare, readings, signals, transition
from controllers.observers.square_root import triangularise, update

KALMAN, EXTENDED, UNSCENTED = 0, 1, 2

REST_STEP = 1e-4
"""Difference step of the KF's output rows, in units of the states: the outputs are at most sines of a pose, so the error is 1e-9."""


class Memory(NamedTuple):
    """What a compiled observer changes. Preallocated."""

    x: np.ndarray  # (states,)
    factor: np.ndarray  # (states, states) U, P = UᵀU
    innovation: np.ndarray  # (measurements,) z - ẑ; NaN where nothing was measured
    points: np.ndarray  # (2 states, states or more)
    seen: np.ndarray  # (2 states, measurements)
    array: np.ndarray  # (2 states + measurements + noise sources, measurements + states)
    lines: np.ndarray  # (6, states or more): scratch


@exactly_called
def process_noise(constants, scheduled, array, first):
    """Rows of deviations that one sample adds, into array[first:]: commands and disturbances through the model, then one state each."""
    n, modes, states, sources = constants.sizes[0], constants.sizes[1], constants.sizes[4], constants.sizes[6]
    period, std, rigid = constants.period_s, constants.noise_std, scheduled.rigid
    for i in range(sources):
        for k in range(states):
            array[first + i, k] = 0.0
    for k in range(n):
        for i in range(n):
            array[first + k, i] = 0.5 * period * period * rigid[i, k] * std[k]
            array[first + k, n + i] = period * rigid[i, k] * std[k]
        for i in range(modes):
            gain = scheduled.encoders[i, 2 * n + k] * std[k]
            array[first + k, 2 * n + i] = scheduled.modes[i, 6] * gain
            array[first + k, 2 * n + modes + i] = scheduled.modes[i, 7] * gain
    for source in range(n, sources):
        array[first + source, 2 * n + 2 * modes + source - n] = std[source]
    for j in range(constants.sizes[7]):
        row = first + n + j
        if constants.quadrature[j] >= 0:
            array[row, constants.quadrature[j]] = constants.colour[j, 4]
        for i in range(n):
            push = scheduled.directions[i, j] * std[n + j]
            array[row, i] = 0.5 * period * period * push
            array[row, n + i] = period * push
        for i in range(modes):
            push = scheduled.directions[n + i, j] * std[n + j]
            array[row, 2 * n + i] = scheduled.modes[i, 6] * push
            array[row, 2 * n + modes + i] = scheduled.modes[i, 7] * push


@exactly_called
def predict(constants, scheduled, memory, kind):
    """Time update to the next sample: (5.7), (5.9) or (5.17)-(5.19) with Q.

    Without adapted modes the transition is linear: deviations go through it by themselves, and sigma points would find the same.
    """
    states = constants.sizes[4]
    x, factor, points, array, after, nothing = memory.x, memory.factor, memory.points, memory.array, memory.lines[0], memory.lines[1]
    prepare(constants, x, scheduled)
    u = scheduled.acting
    rows = states
    transition(constants, scheduled, x, u, after)
    if constants.sizes[3] == 0:
        nothing[:] = 0.0
        for i in range(states):
            transition(constants, scheduled, factor[i], nothing, array[i])
    else:
        distance = np.sqrt(float(states)) if kind == UNSCENTED else 1.0
        for i in range(states):
            for sign in range(2):
                for k in range(states):
                    nothing[k] = x[k] + (distance if sign == 0 else -distance) * factor[i, k]
                transition(constants, scheduled, nothing, u, points[2 * i + sign])
        half = 0.5 / distance
        for i in range(states):
            for k in range(states):
                array[i, k] = half * (points[2 * i, k] - points[2 * i + 1, k])
        if kind == UNSCENTED:
            for k in range(states):
                total = 0.0
                for i in range(2 * states):
                    total += points[i, k]
                after[k] = total / (2 * states)
            for i in range(states):
                for k in range(states):
                    array[rows + i, k] = half * (points[2 * i, k] + points[2 * i + 1, k] - 2.0 * after[k])
            rows += states
    process_noise(constants, scheduled, array, rows)
    triangularise(array, rows + constants.sizes[6], states)
    for i in range(states):
        x[i] = after[i]
        for k in range(states):
            factor[i, k] = array[i, k]


@exactly_called
def look_at_rest(constants, scheduled, memory):
    """Rows of the KF: ẑ into lines[5], what deviation i changes in it into seen[i], both from the machine at rest in the estimated pose."""
    n, states, measurements = constants.sizes[0], constants.sizes[4], constants.sizes[5]
    x, factor, seen, lines, u = memory.x, memory.factor, memory.seen, memory.lines, scheduled.acting
    rest, sensed, upper, lower, slopes, mean = lines[0], lines[1], lines[2], lines[3], lines[4], lines[5]
    biases = states - (measurements - 2 * n)
    rest[:] = 0.0
    for k in range(n):
        rest[k] = x[k]
    signals(constants, scheduled, rest, u, sensed)
    readings(constants, sensed, mean)
    for i in range(states):
        for j in range(measurements):
            seen[i, j] = factor[i, biases + j - 2 * n] if j >= 2 * n else 0.0
    for j in range(2 * n, measurements):
        mean[j] += x[biases + j - 2 * n]
    for k in range(biases):
        kept = rest[k]
        rest[k] = kept + REST_STEP
        signals(constants, scheduled, rest, u, sensed)
        readings(constants, sensed, upper)
        rest[k] = kept - REST_STEP
        signals(constants, scheduled, rest, u, sensed)
        readings(constants, sensed, lower)
        rest[k] = kept
        for j in range(measurements):
            slopes[j] = (upper[j] - lower[j]) / (2.0 * REST_STEP)
            mean[j] += slopes[j] * (x[k] - kept)
        for i in range(states):
            for j in range(measurements):
                seen[i, j] += factor[i, k] * slopes[j]


@exactly_called
def look_around(constants, scheduled, memory, kind):
    """Rows of EKF and UKF: ẑ into lines[5], half the difference of a pair into seen[i], how its mean strays from ẑ into seen[states + i].

    The last deviations move biases alone, which only shift what is read.
    """
    n, states, measurements = constants.sizes[0], constants.sizes[4], constants.sizes[5]
    x, factor, seen, lines, array, u = memory.x, memory.factor, memory.seen, memory.lines, memory.array, scheduled.acting
    point, here, moved, sensed, nothing, mean = lines[0], lines[1], lines[2], lines[3], lines[4], lines[5]
    is_linear = constants.sizes[3] == 0
    biases = states - (measurements - 2 * n)
    distance = np.sqrt(float(states)) if kind == UNSCENTED else 1.0
    width = 2 * n + constants.sizes[2] * (3 * n + SENSOR_SIGNALS)
    nothing[:] = 0.0
    signals(constants, scheduled, x, u, here)
    readings(constants, here, mean)
    for i in range(biases):
        if is_linear:
            signals(constants, scheduled, factor[i], nothing, moved)
        for sign in range(2):
            step = distance if sign == 0 else -distance
            if is_linear:
                for k in range(width):
                    sensed[k] = here[k] + step * moved[k]
            else:
                for k in range(states):
                    point[k] = x[k] + step * factor[i, k]
                signals(constants, scheduled, point, u, sensed)
            readings(constants, sensed, array[2 * i + sign])
    if kind == UNSCENTED:
        weight = 0.5 / states
        for j in range(measurements):
            total = 2.0 * (states - biases) * mean[j]
            for i in range(2 * biases):
                total += array[i, j]
            mean[j] = total * weight
        here[:] = mean
    half = 0.5 / distance
    for i in range(biases):
        for j in range(measurements):
            seen[i, j] = half * (array[2 * i, j] - array[2 * i + 1, j])
            seen[states + i, j] = half * (array[2 * i, j] + array[2 * i + 1, j] - 2.0 * mean[j])
    for i in range(biases, states):
        for j in range(measurements):
            seen[i, j] = 0.0
            seen[states + i, j] = 0.0
    for j in range(2 * n, measurements):
        bias = biases + j - 2 * n
        mean[j] += x[bias]
        for i in range(states):
            seen[i, j] += factor[i, bias]


@exactly_called
def correct(constants, scheduled, memory, kind, z):
    """Measurement update with whatever of z (measurements,) is a number: (5.5), (5.6) or (5.21)-(5.26).

    Returns
    -------
    (nis, measured, log_volume)
        Normalised innovation squared, its degrees of freedom, and the logarithm of the innovation covariance's determinant.
    """
    states, measurements = constants.sizes[4], constants.sizes[5]
    factor, seen, array, mean, whitened = memory.factor, memory.seen, memory.array, memory.lines[5], memory.lines[0]
    if kind == KALMAN:
        look_at_rest(constants, scheduled, memory)
    else:
        look_around(constants, scheduled, memory, kind)
    measured = 0
    for j in range(measurements):
        measured += z[j] == z[j]
    extra = states if kind == UNSCENTED else 0
    for i in range(measured):
        for k in range(measured + states):
            array[i, k] = 0.0
    column = 0
    for j in range(measurements):
        memory.innovation[j] = z[j] - mean[j]
        if z[j] != z[j]:
            continue
        array[column, column] = constants.measurement_std[j]
        for i in range(extra):
            array[measured + i, column] = seen[states + i, j]
        whitened[column] = memory.innovation[j]
        column += 1
    if measured == 0:
        return 0.0, 0, 0.0
    if extra:
        triangularise(array, measured + extra, measured)  # curvature counts as noise of z alone
    for i in range(states):
        column = 0
        for j in range(measurements):
            if z[j] == z[j]:
                array[measured + i, column] = seen[i, j]
                column += 1
        for k in range(states):
            array[measured + i, measured + k] = factor[i, k]
    triangularise(array, measured + states, measured + states)
    log_volume = 0.0
    for j in range(measured):
        log_volume += 2.0 * np.log(array[j, j])
    return update(array, measured, states, whitened, memory.x, factor), measured, log_volume


@exactly_called
def one_step(constants, scheduled, memory, kind, is_first, u, z, summary):
    """One sample. `u` (axes,) acted since the last one; `summary` (3,) gets what `correct` returns."""
    for i in range(constants.sizes[0]):
        scheduled.acting[i] = u[i]
    if is_first:
        prepare(constants, memory.x, scheduled)
    else:
        predict(constants, scheduled, memory, kind)
    summary[0], summary[1], summary[2] = correct(constants, scheduled, memory, kind, z)


@exactly_called
def gradients(constants, scheduled, x, F, H):
    """Transition matrix F (states, states) and output rows H (measurements, states) at a state, by differences (5.12)."""
    n, states, measurements = constants.sizes[0], constants.sizes[4], constants.sizes[5]
    biases = states - (measurements - 2 * n)
    prepare(constants, x, scheduled)
    u = scheduled.acting
    u[:n] = 0.0
    width = 2 * n + constants.sizes[2] * (3 * n + SENSOR_SIGNALS)
    shifted, sensed = x.copy(), np.zeros(width)
    after, read = np.zeros((2, states)), np.zeros((2, measurements))
    for k in range(states):
        for sign in range(2):
            shifted[k] = x[k] + (REST_STEP if sign == 0 else -REST_STEP)
            transition(constants, scheduled, shifted, u, after[sign])
            signals(constants, scheduled, shifted, u, sensed)
            readings(constants, sensed, read[sign])
            for j in range(2 * n, measurements):
                read[sign, j] += shifted[biases + j - 2 * n]
        shifted[k] = x[k]
        for i in range(states):
            F[i, k] = (after[0, i] - after[1, i]) / (2.0 * REST_STEP)
        for j in range(measurements):
            H[j, k] = (read[0, j] - read[1, j]) / (2.0 * REST_STEP)


@exactly_compiled
def filter_step(constants, scheduled, memory, kind, is_first, u, z, summary):  # type: ignore[no-untyped-def]
    """See `one_step`."""
    one_step(constants, scheduled, memory, kind, is_first, u, z, summary)


@exactly_compiled
def filter_rows(constants, scheduled, memory, kind, commands, measured, summaries):  # type: ignore[no-untyped-def]
    """N rows at once, for tuning."""
    nothing = np.zeros(commands.shape[1])  # what acts in row 0 is not known
    for k in range(len(measured)):
        u = commands[max(k - 2, 0)]  # command k-2 acts from k-1 to k; what acted before row 0 is taken for command 0
        one_step(constants, scheduled, memory, kind, k == 0, u if k else nothing, measured[k], summaries[k])


@exactly_compiled
def linearised(constants, scheduled, x, F, H):  # type: ignore[no-untyped-def]
    """See `gradients`."""
    gradients(constants, scheduled, x, F, H)
