"""Square-root algebra of the filters: covariances as triangular factors, combined by orthogonal transformations only.

A covariance P is kept as an upper triangular U with P = UᵀU: its rows are deviations. Stacking deviations and triangularising adds
covariances; nothing is ever subtracted, so nothing can become indefinite (Kaminski, Bryson, Schmidt 1971).
"""

from __future__ import annotations

import numpy as np

from controllers.compiled import exactly_compiled


@exactly_compiled
def triangularise(rows: np.ndarray, count: int, columns: int) -> None:
    """Replace rows[:count, :columns] by the upper triangular R of their QR decomposition, diagonal not negative, zeros below.

    Householder reflections are applied row by row, so that the inner loops run along memory. The pass that applies one reflection also
    gathers the sums of the next: `ahead` is the sum over the rows below its pivot of their first element times the row.

    The inner loops count without sign. For an index that may be negative numba asks at every element whether it counts from the end, and
    the compiler then takes one element at a time instead of four.
    """
    work, ahead, end = np.zeros(columns), np.zeros(columns), np.uint64(columns)
    for i in range(1, count):
        v = rows[i, 0]
        if v != 0.0:
            for k in range(columns):
                ahead[k] += v * rows[i, k]
    for j in range(min(columns, count)):
        below, pivot, following = ahead[j], rows[j, j], j + 1
        begin = np.uint64(following)
        if below > 0.0:
            norm = np.sqrt(pivot * pivot + below)
            head = pivot + norm if pivot >= 0.0 else pivot - norm
            scale = 2.0 / (below + head * head)
            for k in range(begin, end):
                work[k] = scale * (head * rows[j, k] + ahead[k])
                rows[j, k] -= head * work[k]
            rows[j, j] = -norm if pivot >= 0.0 else norm
        if rows[j, j] < 0.0:
            for k in range(np.uint64(j), end):
                rows[j, k] = -rows[j, k]
        for k in range(begin, end):
            ahead[k] = 0.0
        for i in range(following, count):
            v = rows[i, j]
            rows[i, j] = 0.0
            if following == columns:
                continue
            if i == following:
                for k in range(begin, end):
                    rows[i, k] -= v * work[k]
            elif v != 0.0:
                first = rows[i, following] - v * work[following]
                for k in range(begin, end):
                    value = rows[i, k] - v * work[k]
                    rows[i, k] = value
                    ahead[k] += first * value
            elif rows[i, following] != 0.0:
                first = rows[i, following]
                for k in range(begin, end):
                    ahead[k] += first * rows[i, k]


@exactly_compiled
def update(array: np.ndarray, measured: int, states: int, innovation: np.ndarray, x: np.ndarray, factor: np.ndarray) -> float:
    """Do the measurement update in array form: (5.5), (5.10), (5.25), (5.26) without forming or subtracting a covariance.

    Parameters
    ----------
    array : (measured + states or more, measured + states) array
        Rows of deviations of [z, x]: the noise's rows [V, 0] with VᵀV = R (and other rows that move z alone), then one row per state
        deviation. The caller triangularises it in place beforehand.
    measured, states : int
    innovation : (measured,) array
        z - ẑ; replaced by the whitened innovation.
    x : (states,) array
        Corrected in place.
    factor : (states, states) array
        Overwritten by the new U.

    Returns
    -------
    float
        Normalised innovation squared, innovationᵀ P_zz⁻¹ innovation.
    """
    nis = 0.0
    for j in range(measured):  # T11ᵀ w = innovation
        total = innovation[j]
        for i in range(j):
            total -= array[i, j] * innovation[i]
        w = total / array[j, j]
        innovation[j] = w
        nis += w * w
        moves = array[j, measured:]
        for k in range(states):
            x[k] += moves[k] * w
    for i in range(states):
        left = array[measured + i, measured:]
        for k in range(states):
            factor[i, k] = left[k]
    return nis
