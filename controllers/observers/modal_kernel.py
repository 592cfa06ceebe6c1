"""One step of the observer, compiled: schedule, prediction, measurement update, and the estimate that is published.

One skeleton serves the three filters of Sec. 5.3; they differ in where the model is asked:
KF (Sec. 5.3.1)   output rows about the rigid machine, unbent, at the predicted pose and speeds: what its motion makes the sensors read
                  is a known input, all else linear;
EKF (Sec. 5.3.2)  differences over one deviation either way, about the estimate (5.12);
UKF (Sec. 5.3.3)  sigma points at √n deviations with equal weights: (5.15)-(5.26) with κ = 0, and with the Q that (5.19) omits.
With n + κ = 3 and 24 states the centre's weight would be -7 and the covariance indefinite.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from controllers.compiled import exactly_called, exactly_compiled
from controllers.observers.linear_part import arrived, carried, heading, others_seen, others_stepped, prepare, signals, stays, transition
from controllers.observers.modal_equations import MODE_SIGNALS, adapted_step, first_bias, moving, readings, rounded
from controllers.observers.square_root import triangularise, update

KALMAN, EXTENDED, UNSCENTED = 0, 1, 2

SLOPE_STEP = 1e-4
"""Difference step of the KF's output rows, in units of the states: the outputs are at most sines of a pose, so the error is 1e-9."""


class Memory(NamedTuple):
    """What a compiled observer changes. Preallocated."""

    x: np.ndarray  # (states,)
    factor: np.ndarray  # (states, states) U, P = UᵀU
    innovation: np.ndarray  # (measurements,) z - ẑ; NaN where nothing was measured
    bends: np.ndarray  # (states, 2 adapted): how the mean of a pair of sigma points strays, one sample on
    seen: np.ndarray  # (2 states, measurements)
    array: np.ndarray  # (2 states + measurements + noise sources, measurements + states)
    lines: np.ndarray  # (6, states, signals or columns of `steps`, whichever are most): scratch


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

    Adapted modes alone are asked at both ends of a deviation; of the rest sigma points would find what the table says.
    """
    states, adapted, first = constants.sizes[4], constants.sizes[3], moving(constants)
    x, factor, array, after, here, line = memory.x, memory.factor, memory.array, memory.lines[0], memory.lines[1], memory.lines[2]
    prepare(constants, x, scheduled)
    heading(constants, scheduled, x, scheduled.command, here)
    arrived(constants, scheduled, here, after)
    stays(constants, x, after)
    distance = np.sqrt(float(states)) if kind == UNSCENTED else 1.0
    for i in range(states):
        carried(constants, scheduled.steps, factor[i], i, line)
        for k in range(first):
            array[i, k] = line[k]
        stays(constants, factor[i], array[i])
        if adapted > 0:
            others_stepped(constants, factor[i], line)
            ends(constants, scheduled, here, line, distance, array[i], memory.bends[i])
    rows = states
    if adapted > 0 and kind == UNSCENTED:
        rows += bent(constants, memory, distance)
    process_noise(constants, scheduled, array, rows)
    triangularise(array, rows + constants.sizes[6], states)
    for i in range(states):
        x[i] = after[i]
        for k in range(states):
            factor[i, k] = array[i, k]


@exactly_called
def ends(constants, scheduled, here, line, distance, row, bend):
    """Adapted modes at both ends of a deviation `line` from `here`: half the difference into `row`, half the sum into `bend`."""
    n, modes, half = constants.sizes[0], constants.sizes[1], 0.5 / distance
    for k in range(constants.sizes[3]):
        mode, place = constants.adapted[k], moving(constants) + MODE_SIGNALS * k
        there = here[place : place + MODE_SIGNALS] + distance * line[place : place + MODE_SIGNALS]
        upper = adapted_step(constants, scheduled, mode, there)
        there -= 2.0 * distance * line[place : place + MODE_SIGNALS]
        lower = adapted_step(constants, scheduled, mode, there)
        for part in range(2):  # deflection, speed
            row[2 * n + part * modes + mode] = half * (upper[part] - lower[part])
            bend[2 * k + part] = half * (upper[part] + lower[part])


@exactly_called
def bent(constants, memory, distance):
    """Means of the sigma points of adapted modes into lines[0], and how pairs stray from them into rows of the array: returns how many."""
    n, modes, states, count = constants.sizes[0], constants.sizes[1], constants.sizes[4], 2 * constants.sizes[3]
    bends, after = memory.bends, memory.lines[0]
    for b in range(count):
        total = 0.0
        for i in range(states):
            total += bends[i, b]
        after[2 * n + b % 2 * modes + constants.adapted[b // 2]] = distance * total / states
        for i in range(states):
            bends[i, b] -= total / states
    triangularise(bends, states, count)
    for i in range(count):
        for k in range(states):
            memory.array[states + i, k] = 0.0
        for b in range(count):
            memory.array[states + i, 2 * n + b % 2 * modes + constants.adapted[b // 2]] = bends[i, b]
    return count


@exactly_called
def look_at_rigid(constants, scheduled, memory):
    """Rows of the KF: ẑ into lines[5], what deviation i changes in it into seen[i], both about the rigid machine as it moves.

    Gravity, centripetal and Coriolis accelerations, and rates seen from a tilted sensor, are those of the axes' pose and speeds.
    """
    n, states, measurements = constants.sizes[0], constants.sizes[4], constants.sizes[5]
    x, factor, seen, lines, u = memory.x, memory.factor, memory.seen, memory.lines, scheduled.command
    rigid, sensed, upper, lower, slopes, mean = lines[0], lines[1], lines[2], lines[3], lines[4], lines[5]
    biases = first_bias(constants)
    rigid[:] = 0.0
    for k in range(2 * n):
        rigid[k] = x[k]
    signals(constants, scheduled, rigid, u, sensed)
    readings(constants, scheduled, sensed, mean)
    for i in range(states):
        for j in range(measurements):
            seen[i, j] = factor[i, biases + j - 2 * n] if j >= 2 * n else 0.0
    for j in range(2 * n, measurements):
        mean[j] += x[biases + j - 2 * n]
    for k in range(biases):
        kept = rigid[k]
        rigid[k] = kept + SLOPE_STEP
        signals(constants, scheduled, rigid, u, sensed)
        readings(constants, scheduled, sensed, upper)
        rigid[k] = kept - SLOPE_STEP
        signals(constants, scheduled, rigid, u, sensed)
        readings(constants, scheduled, sensed, lower)
        rigid[k] = kept
        for j in range(measurements):
            slopes[j] = (upper[j] - lower[j]) / (2.0 * SLOPE_STEP)
            mean[j] += slopes[j] * (x[k] - kept)
        for i in range(k + 1):
            for j in range(measurements):
                seen[i, j] += factor[i, k] * slopes[j]


@exactly_called
def look_around(constants, scheduled, memory, kind):
    """Rows of EKF and UKF: ẑ into lines[5], half the difference of a pair into seen[i], how its mean strays from ẑ into seen[states + i].

    The last deviations move biases alone, which only shift what is read.
    """
    n, states, measurements = constants.sizes[0], constants.sizes[4], constants.sizes[5]
    x, factor, seen, lines, array = memory.x, memory.factor, memory.seen, memory.lines, memory.array
    here, moved, sensed, centre, mean = lines[1], lines[2], lines[3], lines[4], lines[5]
    biases = first_bias(constants)
    distance = np.sqrt(float(states)) if kind == UNSCENTED else 1.0
    signals(constants, scheduled, x, scheduled.command, here)
    readings(constants, scheduled, here, mean)
    for i in range(biases):
        carried(constants, scheduled.sees, factor[i], i, moved)
        others_seen(constants, factor[i], moved)
        for sign in range(2):
            step = distance if sign == 0 else -distance
            for k in range(scheduled.sees.shape[1]):
                sensed[k] = here[k] + step * moved[k]
            readings(constants, scheduled, sensed, array[2 * i + sign])
    centre[:] = mean
    if kind == UNSCENTED:
        weight = 0.5 / states
        for j in range(measurements):
            total = 2.0 * (states - biases) * mean[j]
            for i in range(2 * biases):
                total += array[i, j]
            mean[j] = total * weight
    half = 0.5 / distance
    for i in range(biases):
        for j in range(measurements):
            seen[i, j] = half * (array[2 * i, j] - array[2 * i + 1, j])
            seen[states + i, j] = half * (array[2 * i, j] + array[2 * i + 1, j] - 2.0 * mean[j])
    for i in range(biases, states):
        for j in range(measurements):
            seen[i, j] = 0.0
            seen[states + i, j] = 2.0 * half * (centre[j] - mean[j])  # both points of such a pair see the centre
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
        look_at_rigid(constants, scheduled, memory)
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


@exactly_compiled
def linearised(constants, scheduled, x, F, H):  # type: ignore[no-untyped-def]
    """Transition matrix F (states, states) and output rows H (measurements, states) at a state, by differences (5.12)."""
    n, states, measurements = constants.sizes[0], constants.sizes[4], constants.sizes[5]
    biases = first_bias(constants)
    prepare(constants, x, scheduled)
    u = scheduled.command
    u[:] = 0.0
    shifted, sensed = x.copy(), np.zeros(scheduled.sees.shape[1])
    after, read = np.zeros((2, states)), np.zeros((2, measurements))
    for k in range(states):
        for sign in range(2):
            shifted[k] = x[k] + (SLOPE_STEP if sign == 0 else -SLOPE_STEP)
            transition(constants, scheduled, shifted, u, after[sign])
            signals(constants, scheduled, shifted, u, sensed)
            readings(constants, scheduled, sensed, read[sign])
            for j in range(2 * n, measurements):
                read[sign, j] += shifted[biases + j - 2 * n]
        shifted[k] = x[k]
        for i in range(states):
            F[i, k] = (after[0, i] - after[1, i]) / (2.0 * SLOPE_STEP)
        for j in range(measurements):
            H[j, k] = (read[0, j] - read[1, j]) / (2.0 * SLOPE_STEP)


@exactly_compiled
def filter_rows(constants, scheduled, memory, kind, is_first, acted, measured, summaries):  # type: ignore[no-untyped-def]
    """N samples, one after the other: one in the loop, all of a recording for tuning. One function, for compiling takes long.

    `acted` (N, axes) commands until each, which drives round; `summaries` (N, 3) get what `correct` returns. `is_first`: nothing came
    before the first of them.
    """
    for k in range(len(measured)):
        rounded(constants, acted[k], scheduled.command)
        if is_first and k == 0:
            prepare(constants, memory.x, scheduled)
        else:
            predict(constants, scheduled, memory, kind)
        summaries[k, 0], summaries[k, 1], summaries[k, 2] = correct(constants, scheduled, memory, kind, measured[k])


@exactly_compiled
def next_and_read(constants, scheduled, x, command, after, read):  # type: ignore[no-untyped-def]
    """State (states,) a sample after x while a command (axes,) acts, and what the sensors (measurements,) read in x but for their biases.

    Of the model as it was last prepared.
    """
    seen = np.empty(scheduled.sees.shape[1])
    transition(constants, scheduled, x, command, after)
    signals(constants, scheduled, x, command, seen)
    readings(constants, scheduled, seen, read)
