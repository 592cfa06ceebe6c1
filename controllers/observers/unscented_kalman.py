"""Unscented Kalman filter (thesis Sec. 5.3.3): sigma points at √n deviations with equal weights.

(5.15)-(5.26) with κ = 0, and with the Q that (5.19) omits. With n + κ = 3 and 24 states the centre's weight would be -7 and the
covariance indefinite. The EKF uses the same pairs of points at one standard deviation and leaves their curvature out.
"""

from __future__ import annotations

import numpy as np

from controllers.compiled import exactly_called
from controllers.filtering.square_root import triangularise
from controllers.observers.linear_part import carried, others_seen, signals
from controllers.observers.memory import UNSCENTED, Memory
from controllers.observers.modal_equations import Constants, Scheduled, first_gain, misread, readings


@exactly_called
def bent(constants: Constants, memory: Memory, distance: float) -> int:
    """Write the means of the adapted modes' sigma points into lines[0], the deviations of pairs from them into rows of `array`.

    Returns
    -------
    int
        Number of rows written.
    """
    n, modes, states = constants.sizes[0], constants.sizes[1], constants.sizes[4]
    count: int = 2 * constants.sizes[3]
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
def look_around(constants: Constants, scheduled: Scheduled, memory: Memory, kind: int) -> None:
    """Write ẑ into lines[5], half a pair's difference into seen[i] and the deviation of its mean from ẑ into seen[states + i].

    Serves EKF and UKF. The last deviations move gains and biases alone, which only change the readings.
    """
    states, measurements = constants.sizes[4], constants.sizes[5]
    x, factor, seen, lines, array = memory.x, memory.factor, memory.seen, memory.lines, memory.array
    here, moved, sensed, centre, mean = lines[1], lines[2], lines[3], lines[4], lines[5]
    gains = first_gain(constants)
    distance = np.sqrt(float(states)) if kind == UNSCENTED else 1.0
    signals(constants, scheduled, x, scheduled.command, here)
    readings(constants, scheduled, here, mean)
    for i in range(gains):
        carried(constants, scheduled.sees, factor[i], i, moved)
        others_seen(constants, factor[i], moved)
        for sign in range(2):
            step = distance if sign == 0 else -distance
            for k in range(scheduled.sees.shape[1]):
                sensed[k] = here[k] + step * moved[k]
            readings(constants, scheduled, sensed, array[2 * i + sign])
    for j in range(measurements):
        centre[j] = mean[j]
    if kind == UNSCENTED:
        weight = 0.5 / states
        for j in range(measurements):
            total = 2.0 * (states - gains) * mean[j]
            for i in range(2 * gains):
                total += array[i, j]
            mean[j] = total * weight
    half = 0.5 / distance
    for i in range(gains):
        for j in range(measurements):
            seen[i, j] = half * (array[2 * i, j] - array[2 * i + 1, j])
            seen[states + i, j] = half * (array[2 * i, j] + array[2 * i + 1, j] - 2.0 * mean[j])
    for i in range(gains, states):
        for j in range(measurements):
            seen[i, j] = 0.0
            seen[states + i, j] = 2.0 * half * (centre[j] - mean[j])  # both points of such a pair see the centre
    for i in range(states):
        misread(constants, factor[i], centre, seen[i])
    misread(constants, x, centre, mean)
