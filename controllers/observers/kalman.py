"""Kalman filter (thesis Sec. 5.3.1): output rows linearised about the rigid machine.

The rows are taken about the undeformed machine at the predicted pose and speeds: the readings due to its motion are a known input,
everything else is linear. The time update (5.7) is that of `filter_step` with a linear model.
"""

from __future__ import annotations

from controllers.compiled import exactly_called
from controllers.observers.linear_part import alone, signals
from controllers.observers.memory import Memory
from controllers.observers.modal_equations import Constants, Scheduled, first_gain, misread, readings

SLOPE_STEP = 1e-4
"""Difference step of the Kalman filter's output rows, in units of the states: outputs are at most sines of a pose, so the error is 1e-9."""


@exactly_called
def look_at_rigid(constants: Constants, scheduled: Scheduled, memory: Memory) -> None:
    """Write ẑ into lines[5], and its change by deviation i into seen[i], both about the rigid machine as it moves.

    Gravity, centripetal and Coriolis accelerations, and the rates that a tilted sensor reads, are those of the axes' pose and speeds.
    """
    n, states, measurements = constants.sizes[0], constants.sizes[4], constants.sizes[5]
    x, factor, seen, lines = memory.x, memory.factor, memory.seen, memory.lines
    single, sensed, upper, lower, shifted, mean = lines[0], lines[1], lines[2], lines[3], lines[4], lines[5]
    width = scheduled.sees.shape[1]
    single[:] = 0.0
    for k in range(2 * n):
        single[k] = x[k]
    signals(constants, scheduled, single, scheduled.command, sensed)
    readings(constants, scheduled, sensed, mean)
    single[:] = 0.0
    for i in range(states):
        for j in range(measurements):
            seen[i, j] = 0.0
    for k in range(first_gain(constants)):  # signals are linear in a state, readings are not in signals
        single[k] = SLOPE_STEP
        alone(constants, scheduled, single, k, shifted)
        single[k] = 0.0
        for j in range(width):
            shifted[j] += sensed[j]
        readings(constants, scheduled, shifted, upper)
        for j in range(width):
            shifted[j] = 2.0 * sensed[j] - shifted[j]
        readings(constants, scheduled, shifted, lower)
        deviation = x[k] if k >= 2 * n else 0.0
        for j in range(measurements):
            upper[j] = (upper[j] - lower[j]) / (2.0 * SLOPE_STEP)
            mean[j] += upper[j] * deviation
        for i in range(k + 1):
            for j in range(measurements):
                seen[i, j] += factor[i, k] * upper[j]
    for j in range(measurements):  # gains multiply what a sensor reads of the bent machine
        upper[j] = mean[j]
    for i in range(states):
        misread(constants, factor[i], upper, seen[i])
    misread(constants, x, upper, mean)
