"""Orthogonal experiments for several inputs: Hadamard and DFT matrices (thesis Sec. 3.3, (3.9)), or one input at a time."""

from __future__ import annotations

from typing import Literal

import numpy as np
import scipy.linalg

Mixing = Literal["orthogonal", "single"]


def mixing_matrix(inputs: int, mixing: Mixing) -> np.ndarray:
    """Return the unitary T of (3.9), (n_u, n_u).

    It is Hadamard/sqrt(n_u) (errata) for powers of two, else DFT/sqrt(n_u); for single inputs the identity.

    Examples
    --------
    >>> from controllers.hadamard_experiments import mixing_matrix
    >>> (2.0 * mixing_matrix(4, "orthogonal")).tolist()
    [[1.0, 1.0, 1.0, 1.0], [1.0, -1.0, 1.0, -1.0], [1.0, 1.0, -1.0, -1.0], [1.0, -1.0, -1.0, 1.0]]
    """
    if mixing == "single":
        return np.eye(inputs)
    if inputs & (inputs - 1) == 0:
        hadamard: np.ndarray = scipy.linalg.hadamard(inputs) / np.sqrt(inputs)
        return hadamard
    dft: np.ndarray = scipy.linalg.dft(inputs, scale="sqrtn")
    return dft
