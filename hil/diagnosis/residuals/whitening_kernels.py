"""What every free run goes through on its way to whitened numbers, as machine code: a record of two thousand rows takes NumPy's small
operations longer than its simulation.

Arrays are float64 or complex128 and C-contiguous; results are written into the last argument.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from virtual_bus.plant.jit import FAST_MATH

compiled = njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST_MATH)


@compiled
def add_scaled(factor, values, total):
    """Add values (n,) times a factor to a total (n,): slices, so that their indices are known not to be negative and lie side by side in
    the processor's vectors.
    """
    for row in range(len(total)):
        total[row] += factor * values[row]


@compiled
def filter_and_weigh(filters, values, weights, filtered):
    """Prediction errors of every channel, times a weight by row.

    Parameters
    ----------
    filters : (C, order + 1)
    values : (C, N)
    weights : (N - order,)
    filtered : (C, at least N - order)
        Zeros.
    """
    order, count = filters.shape[1] - 1, len(weights)
    for channel in range(len(filters)):
        errors = filtered[channel, :count]
        for lag in range(order + 1):
            add_scaled(filters[channel, lag], values[channel, order - lag : order - lag + count], errors)
        for row in range(count):
            errors[row] *= weights[row]


@compiled
def mix_channels(roots, lines, mixed):
    """Every line's channels through a matrix of its own: roots (K, C, C), lines (K, C), mixed (K, C)."""
    channels = lines.shape[1]
    for line in range(len(mixed)):
        for to in range(channels):
            total = 0.0j
            for channel in range(channels):
                total += roots[line, to, channel] * lines[line, channel]
            mixed[line, to] = total


@compiled
def take_carried(gradients, weights, imu, encoders, values):
    """Values less what local polynomials of some of their channels say of others, see carried.py.

    Parameters
    ----------
    gradients : (orders, A, I, N)
    weights : (orders, window, window)
        Of the values in a window, for the derivative of their polynomial at each of its rows.
    imu : (I,)
        Channels that change.
    encoders : (A,)
        Others, which they change by.
    values : (C, N)
        Changed in place.
    """
    orders, count, window = len(weights), values.shape[1], weights.shape[1]
    half = window // 2
    inner = count - window + 1
    for axis in range(len(encoders)):
        column = values[encoders[axis]]
        for order in range(orders):
            slopes = np.zeros(count)
            for row in range(half):
                slopes[row] = np.sum(weights[order, row] * column[:window])
                slopes[count - 1 - row] = np.sum(weights[order, window - 1 - row] * column[count - window :])
            for k in range(window):
                add_scaled(weights[order, half, k], column[k : k + inner], slopes[half : half + inner])
            for channel in range(len(imu)):
                left, gradient = values[imu[channel]], gradients[order, axis, channel]
                for row in range(count):
                    left[row] -= gradient[row] * slopes[row]
