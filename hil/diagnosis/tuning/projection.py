"""What of a change of the simulation re-tuning cannot imitate: sensitivities with the tuned parameters projected out, prior included."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import scipy.linalg

from hil.diagnosis.tuning.retune import LARGEST_CHANGE, PRIOR, Tuning

AT_BOUND = 1e-6

KEPT = 2
"""Projections that are asked for again and again: without effects, and beside those found last."""


@dataclass(frozen=True, eq=False)
class Projection:
    """Inner products of whitened vectors (M,) after the best small re-tuning for each.

    min over d of |r - J d|^2 + |offset + d|^2 is a least-squares problem in the vectors (r, -offset) with the columns (J, 1): every product
    here is one of what is left of such augmented vectors. A tuned parameter at its bound is no longer free.
    """

    jacobian: np.ndarray  # (M, F) of the free ones
    offset: np.ndarray  # (F,)
    factor: tuple[np.ndarray, bool]  # of J'J + 1

    @classmethod
    @lru_cache(maxsize=KEPT)
    def of(cls, tuning: Tuning) -> Projection:
        free = np.abs(tuning.offset) < LARGEST_CHANGE / PRIOR - AT_BOUND
        jacobian = np.asfortranarray(tuning.jacobian if free.all() else tuning.jacobian[:, free])
        hessian = jacobian.T @ jacobian + np.eye(jacobian.shape[1])
        return cls(jacobian, tuning.offset[free], scipy.linalg.cho_factor(hessian))

    def left(self, change: np.ndarray) -> np.ndarray:
        """(..., M + F) of changes (..., M) of the simulation, the part that no re-tuning imitates."""
        weights = scipy.linalg.cho_solve(self.factor, (change @ self.jacobian).T).T
        count = change.shape[-1]
        left = np.empty((*change.shape[:-1], count + weights.shape[-1]))  # written in place: of a minute every copy is 50 MB
        np.matmul(weights, self.jacobian.T, out=left[..., :count])
        np.subtract(change, left[..., :count], out=left[..., :count])
        np.negative(weights, out=left[..., count:])
        return left

    def left_of_residual(self, residual: np.ndarray) -> np.ndarray:
        """(M + F,) of a residual at the present tuning, its prior's pull included."""
        weights = scipy.linalg.cho_solve(self.factor, self.jacobian.T @ residual - self.offset)
        return np.concatenate([residual - self.jacobian @ weights, -self.offset - weights])
