"""One compiled step of the observer: schedule, prediction and measurement update, for a row or a whole recording.

One skeleton serves the three filters of Sec. 5.3, which differ in the points where the model is evaluated: `kalman`, `extended`,
`unscented`.
"""

from __future__ import annotations

import numpy as np

from controllers.bound import Bound
from controllers.compiled import exactly_called, exactly_compiled
from controllers.filtering.square_root import triangularise, update
from controllers.observers.extended_kalman import ends
from controllers.observers.kalman import look_at_rigid
from controllers.observers.linear_part import arrived, carried, heading, others_stepped, prepare, stays
from controllers.observers.memory import KALMAN, UNSCENTED, Memory
from controllers.observers.modal_equations import Constants, Scheduled, moving, rounded
from controllers.observers.unscented_kalman import bent, look_around


@exactly_called
def process_noise(constants: Constants, scheduled: Scheduled, array: np.ndarray, first: int) -> None:
    """Write the deviations that one sample adds into array[first:]: commands and disturbances through the model, then one state each."""
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
def predict(constants: Constants, scheduled: Scheduled, memory: Memory, kind: int) -> None:
    """Do the time update to the next sample: (5.7), (5.9) or (5.17)-(5.19) with Q.

    Only adapted modes are evaluated at both ends of a deviation; the rest is linear, so sigma points would reproduce the table.
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
def correct(constants: Constants, scheduled: Scheduled, memory: Memory, kind: int, z: np.ndarray) -> tuple[float, int, float]:
    """Do the measurement update with those entries of z (measurements,) that are not NaN: (5.5), (5.6) or (5.21)-(5.26).

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
    memory.correction[:] = 0.0
    memory.whitened[:] = np.nan
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
        triangularise(array, measured + extra, measured)  # curvature counts as noise on z alone
    for i in range(states):
        column = 0
        for j in range(measurements):
            if z[j] == z[j]:
                array[measured + i, column] = seen[i, j]
                column += 1
        deviation = array[measured + i, measured:]
        for k in range(states):
            deviation[k] = factor[i, k]
    triangularise(array, measured + states, measured + states)
    log_volume = 0.0
    for j in range(measured):
        log_volume += 2.0 * np.log(array[j, j])
    nis = update(array, measured, states, whitened, memory.x, factor)
    for j in range(measured):  # whitened innovations have unit variance
        moves = array[j, measured:]
        for k in range(states):
            memory.correction[0, k] += moves[k] * whitened[j]
            memory.correction[1 + j, k] = moves[k]
    column = 0
    for j in range(measurements):
        if z[j] == z[j]:
            memory.whitened[j] = whitened[column]
            column += 1
    return nis, measured, log_volume


@exactly_compiled
def filter_rows(
    filter_: Bound,
    kind: int,
    is_first: bool,
    acted: np.ndarray,
    measured: np.ndarray,
    summaries: np.ndarray,
) -> None:
    """Filter N samples in order: one in the loop, all of a recording for tuning. One function serves both because compiling takes long.

    `acted` (N, axes) holds the commands that acted until each sample, which drives round; `summaries` (N, 3) receives what `correct`
    returns. `is_first`: no sample came before the first of these. `filter_` binds constants, scheduled model and memory first.
    """
    constants, scheduled, memory = filter_.held[0], filter_.held[1], filter_.held[2]
    for k in range(len(measured)):
        rounded(constants, acted[k], scheduled.command)
        if is_first and k == 0:
            prepare(constants, memory.x, scheduled)
        else:
            predict(constants, scheduled, memory, kind)
        summaries[k, 0], summaries[k, 1], summaries[k, 2] = correct(constants, scheduled, memory, kind, measured[k])
