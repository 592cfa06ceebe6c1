"""Judging on recordings that nothing was fitted to.

The effects stay as they were fitted. The machine file's numbers may move within what the training recordings left open of them: a number
that training could not see is no evidence against a name when the held-out motion shows it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy.linalg

from hil.diagnosis.free_run import HELD_OUT, FreeRuns, Trial
from hil.diagnosis.retune import Tuning, quick_sensitivities
from virtual_bus.settings import EffectSetting

OPEN = 10.0
"""Factor on the tuned numbers' covariance: the noise along their responses is larger than the model's in places, and where it is not they
are known well all the same. Of 1, 2, 4, 10 and 30 the one from which on held-out falls on development nulls became no rarer; of the
deviations of true effects it takes less than a tenth, a fifth where a number imitates them."""


KNOWN_BEST = 1e-10
"""Of the largest variance, below which a direction's is not told from zero: its inverse would swamp the others in rounding."""


def precision_of(covariance: np.ndarray) -> np.ndarray:
    """(P, P) inverse of a covariance, positive definite whatever its rounding."""
    if not len(covariance):
        return covariance
    variances, directions = np.linalg.eigh(0.5 * (covariance + covariance.T))
    return (directions / np.maximum(variances, KNOWN_BEST * variances[-1])) @ directions.T


class HeldOut:
    """The held-out groups seen from a tuning.

    With the prediction's covariance 1 + J P J' (P the tuned numbers' covariance after training, times OPEN), a residual's misfit is
    r' (1 + J P J')^-1 r = min over d of |r - J d|^2 + d' P^-1 d.
    """

    def __init__(self, runs: FreeRuns, tuning: Tuning) -> None:
        self._runs = runs
        self._tuning = tuning
        self.measured = runs.measured(HELD_OUT)
        base = runs.run_one(Trial(tuning.values), HELD_OUT)
        self.base = np.zeros_like(self.measured) if base is None else base
        self._jacobian = quick_sensitivities(runs, tuning, self.base, (), HELD_OUT)
        self._factor = scipy.linalg.cho_factor(self._jacobian.T @ self._jacobian + precision_of(OPEN * tuning.covariance))

    def product(self, one: np.ndarray, other: np.ndarray) -> float:
        """one' (1 + J P J')^-1 other."""
        a, b = self._jacobian.T @ one, self._jacobian.T @ other
        return float(one @ other - a @ scipy.linalg.cho_solve(self._factor, b))

    def predictions(self, sets: Sequence[tuple[np.ndarray, tuple[EffectSetting, ...]]]) -> list[np.ndarray | None]:
        """(M,) whitened free runs at these tuned coordinates and effects."""
        return self._runs.run([Trial(self._tuning.at(offset), effects) for offset, effects in sets], HELD_OUT)

    def misfit(self, predicted: np.ndarray | None) -> float:
        """Of a prediction; its expectation is the number of its entries where the prediction is right."""
        if predicted is None:
            return 1e300
        residual = self.measured - predicted
        return self.product(residual, residual)

    def deviations(self, before: np.ndarray | None, after: np.ndarray | None) -> float:
        """How far the residual goes along a predicted change, in standard deviations of noise, or of what is left if larger."""
        if before is None or after is None:
            return -np.inf
        change = after - before
        length = self.product(change, change)
        level = max(1.0, self.misfit(after) / max(len(self.measured), 1))
        return self.product(change, self.measured - before) / np.sqrt(length * level) if length > 0.0 else 0.0
