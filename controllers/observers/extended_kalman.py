"""Extended Kalman filter (thesis Sec. 5.3.2): differences over one standard deviation to either side of the estimate (5.12)."""

from __future__ import annotations

import numpy as np

from controllers.compiled import exactly_called, exactly_compiled
from controllers.observers.kalman import SLOPE_STEP
from controllers.observers.linear_part import prepare, signals, transition
from controllers.observers.modal_equations import MODE_SIGNALS, Constants, Scheduled, adapted_step, misread, moving, readings


@exactly_called
def ends(
    constants: Constants, scheduled: Scheduled, here: np.ndarray, line: np.ndarray, distance: float, row: np.ndarray, bend: np.ndarray
) -> None:
    """Step adapted modes from both ends of a deviation `line` about `here`: half the difference into `row`, half the sum into `bend`.

    Loops, because sums of arrays bring the text of numba's error about their shapes, which takes seconds to compile.
    """
    n, modes, half = constants.sizes[0], constants.sizes[1], 0.5 / distance
    there = np.empty(MODE_SIGNALS)
    for k in range(constants.sizes[3]):
        mode, place = constants.adapted[k], moving(constants) + MODE_SIGNALS * k
        for i in range(MODE_SIGNALS):
            there[i] = here[place + i] + distance * line[place + i]
        upper = adapted_step(constants, scheduled, mode, there)
        for i in range(MODE_SIGNALS):
            there[i] -= 2.0 * distance * line[place + i]
        lower = adapted_step(constants, scheduled, mode, there)
        for part in range(2):  # deflection, speed
            row[2 * n + part * modes + mode] = half * (upper[part] - lower[part])
            bend[2 * k + part] = half * (upper[part] + lower[part])


@exactly_compiled
def next_and_read(
    constants: Constants, scheduled: Scheduled, x: np.ndarray, command: np.ndarray, after: np.ndarray, read: np.ndarray
) -> None:
    """Write the state (states,) one sample after x while a command (axes,) acts, and the sensors' readings (measurements,) in x.

    The readings are without gains and biases (`misreading`); the model is the one last prepared.
    """
    seen = np.empty(scheduled.sees.shape[1])
    transition(constants, scheduled, x, command, after)
    signals(constants, scheduled, x, command, seen)
    readings(constants, scheduled, seen, read)


@exactly_compiled
def misreading(constants: Constants, x: np.ndarray, read: np.ndarray, misread_by: np.ndarray) -> None:
    """Add to `misread_by` (measurements,) what the gains and biases of x make of readings (measurements,)."""
    misread(constants, x, read, misread_by)


def linearised(constants: Constants, scheduled: Scheduled, x: np.ndarray, F: np.ndarray, H: np.ndarray) -> None:
    """Write transition matrix F (states, states) and output rows H (measurements, states) at a state, by differences (5.12)."""
    u, shifted, measurements = scheduled.command, x.copy(), len(H)
    prepare(constants, x, scheduled)
    u[:] = 0.0
    after, read = np.zeros((2, len(x))), np.zeros((2, measurements))
    for k in range(len(x)):
        for sign, step in enumerate((SLOPE_STEP, -SLOPE_STEP)):
            shifted[k] = x[k] + step
            next_and_read(constants, scheduled, shifted, u, after[sign], read[sign])
            misreading(constants, shifted, read[sign].copy(), read[sign])
        shifted[k] = x[k]
        F[:, k] = (after[0] - after[1]) / (2.0 * SLOPE_STEP)
        H[:, k] = (read[0] - read[1]) / (2.0 * SLOPE_STEP)
