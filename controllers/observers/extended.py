"""Extended Kalman filter (thesis Sec. 5.3.2): differences over one standard deviation to either side of the estimate (5.12)."""

from __future__ import annotations

import numpy as np

from controllers.compiled import exactly_called, exactly_compiled
from controllers.observers.kalman import SLOPE_STEP
from controllers.observers.linear_part import prepare, signals, transition
from controllers.observers.modal_equations import MODE_SIGNALS, Constants, Scheduled, adapted_step, first_bias, moving, readings


@exactly_called
def ends(
    constants: Constants, scheduled: Scheduled, here: np.ndarray, line: np.ndarray, distance: float, row: np.ndarray, bend: np.ndarray
) -> None:
    """Step adapted modes from both ends of a deviation `line` about `here`: half the difference into `row`, half the sum into `bend`."""
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


@exactly_compiled
def linearised(constants: Constants, scheduled: Scheduled, x: np.ndarray, F: np.ndarray, H: np.ndarray) -> None:
    """Write transition matrix F (states, states) and output rows H (measurements, states) at a state, by differences (5.12)."""
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
