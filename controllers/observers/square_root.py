"""Square-root algebra of the filters: covariances as triangular factors, combined by orthogonal transformations only.

A covariance P is kept as an upper triangular U with P = UᵀU: its rows are deviations. Stacking deviations and triangularising adds
covariances; nothing is ever subtracted, so nothing can become indefinite (Kaminski, Bryson, Schmidt 1971).
"""

from __future__ import annotations

import numpy as np

from controllers.compiled import exactly_compiled


@exactly_compiled
def triangularise(rows, count, columns):
    """Replace rows[:count, :columns] by the upper triangular R of their QR decomposition, diagonal not negative, zeros below.

    Householder reflections applied row by row, so that the inner loops run along memory.
    """
    work = np.empty(columns)
    for j in range(min(columns, count)):
        norm2 = 0.0
        last = j
        for i in range(j, count):
            if rows[i, j] != 0.0:
                norm2 += rows[i, j] * rows[i, j]
                last = i
        if norm2 == 0.0:
            continue
        pivot = rows[j, j]
        norm = np.sqrt(norm2)
        if last > j:
            head = pivot + norm if pivot >= 0.0 else pivot - norm
            scale = 2.0 / (norm2 - pivot * pivot + head * head)
            for k in range(j + 1, columns):
                work[k] = head * rows[j, k]
            for i in range(j + 1, last + 1):
                v = rows[i, j]
                if v != 0.0:
                    for k in range(j + 1, columns):
                        work[k] += v * rows[i, k]
            for k in range(j + 1, columns):
                work[k] *= scale
                rows[j, k] -= head * work[k]
            for i in range(j + 1, last + 1):
                v = rows[i, j]
                if v != 0.0:
                    for k in range(j + 1, columns):
                        rows[i, k] -= v * work[k]
                rows[i, j] = 0.0
            rows[j, j] = -norm if pivot >= 0.0 else norm
        if rows[j, j] < 0.0:
            for k in range(j, columns):
                rows[j, k] = -rows[j, k]
    for i in range(columns, count):
        for k in range(columns):
            rows[i, k] = 0.0


@exactly_compiled
def update(array, measured, states, innovation, x, factor):
    """Measurement update in array form: (5.5), (5.10), (5.25), (5.26) without forming or subtracting a covariance.

    Parameters
    ----------
    array : (measured + states or more, measured + states) array
        Rows of deviations of [z, x]: the noise's rows [V, 0] with VᵀV = R (and what else only moves z), then one row per state deviation.
        Triangularised in place beforehand.
    measured, states : int
    innovation : (measured,) array
        z - ẑ; replaced by its whitened self.
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
        for k in range(states):
            x[k] += array[j, measured + k] * w
    for i in range(states):
        for k in range(states):
            factor[i, k] = array[measured + i, measured + k]
    return nis
