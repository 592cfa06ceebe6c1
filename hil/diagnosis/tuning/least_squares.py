"""Least squares within bounds, whatever LAPACK's singular values do."""

from __future__ import annotations

import numpy as np
import scipy.optimize


def least_within(rows: np.ndarray, wanted: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """The least of |rows x - wanted|^2 within bounds.

    Singular values do not converge for each of the matrices that an active set asks for (one of 61 columns and a condition of 2e8, say); an
    interior method asks for others.

    Parameters
    ----------
    rows : (M, N) array
    wanted : (M,) array
    low, high : (N,) arrays

    Returns
    -------
    (N,) array
    """
    try:
        found = scipy.optimize.lsq_linear(rows, wanted, bounds=(low, high), method="bvls").x
    except np.linalg.LinAlgError:
        found = scipy.optimize.lsq_linear(rows, wanted, bounds=(low, high), method="trf").x
    return np.asarray(found)
