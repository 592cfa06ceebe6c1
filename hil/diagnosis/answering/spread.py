"""How far the parameters of a fit may be from the truth.

With A the sensitivities in units of noise and L the inverse variances of what is known beforehand (a tuned number's prior; of an effect's
parameter no more than its range), a fit ends at

    estimate - truth = H^-1 A' noise - H^-1 L (truth - start),    H = A'A + L,

so every parameter is a sum over the recordings, along a functional (a row of H^-1 A'), and of what it was beforehand: the variance is that
of the noise along the functional, and H^-1 L H^-1. The noise model is one opinion of the first. How the sum scatters from repeat to repeat
(`gate.Scatter`) and what the fit leaves along it (`structure_left.py`) are others, and the largest counts. A variance that is known
from three or four repeats makes it a t distribution.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import scipy.stats

from hil.diagnosis.fitting.coordinates import FINE_SHARE, Coordinates, Point
from hil.diagnosis.fitting.refit import Fitted
from hil.diagnosis.fitting.visited import Visited
from hil.diagnosis.judging.gate import Scatter
from hil.diagnosis.judging.structure_left import StructureLeft
from hil.diagnosis.tuning.free_run import TRAIN, FreeRuns
from hil.diagnosis.tuning.retune import Tuning, sensitivities

TWO_SIDED_95 = 1.96
"""Deviations of a normal distribution."""

ROUNDING = 1e-12
"""Of the largest eigenvalue of H, its columns of size one: directions below are not seen, whatever differences of runs say of them."""

RANGE_OVER_DEVIATION_SQUARED = 12.0
"""Square of a range over the variance of what may be anywhere in it."""


def spread_of(runs: FreeRuns, tuning: Tuning, fitted: Fitted | None) -> np.ndarray:
    """(P + F,) of tuned coordinates and, where there are effects, their free parameters: 1.96 of it to either side hold 95 %."""
    offset = tuning.offset if fitted is None else fitted.offset
    known, predicted = np.ones(len(offset)), tuning.predicted
    columns = tuning.jacobian
    if fitted is not None:  # beside the effects: what scales a machine's every number alike scales its friction too
        columns = np.hstack([sensitivities(runs, tuning, offset, fitted.settings), _to_effects(runs, tuning, fitted)])
        ranges = Coordinates(tuning, fitted.effects, fitted.values, Visited.by(runs)).ranges()
        known = np.concatenate([known, RANGE_OVER_DEVIATION_SQUARED / ranges**2])
        predicted = fitted.predicted
    scatter, structure, residual = Scatter(runs), StructureLeft(runs, TRAIN), runs.measured() - predicted

    def variance(functional: np.ndarray) -> float:
        return max(scatter.along(functional), structure.along(functional, residual))

    return spread(columns, known, variance, scatter.freedom)


def spread(columns: np.ndarray, known: np.ndarray, variance: Callable[[np.ndarray], float], freedom: float) -> np.ndarray:
    """(K,) of parameters that fit recordings best.

    Parameters
    ----------
    columns : (M, K) array
        Sensitivities in units of the noise model's.
    known : (K,) array
        Inverse variances beforehand.
    variance : callable
        Of the noise along a functional (M,), in units of the noise model's: its expectation.
    freedom : float
        Degrees of freedom with which that is known.
    """
    if not columns.shape[1]:  # of a machine that stood still
        return np.zeros(0)
    gram = columns.T @ columns
    size = np.sqrt(np.diag(gram) + known)
    prior = known / size**2
    energies, directions = np.linalg.eigh(gram / np.outer(size, size) + np.diag(prior))
    unseen = energies < ROUNDING * energies[-1]
    energies = np.where(unseen, np.maximum(prior @ directions**2, np.finfo(float).tiny), energies)
    beforehand = prior @ ((directions / energies) @ directions.T) ** 2 / size**2
    weights = (directions * np.where(unseen, 0.0, 1.0 / energies)) @ directions.T / np.outer(size, size)
    noise = np.zeros(len(size))
    for k, own in enumerate(weights.T):
        functional = columns @ own
        noise[k] = float(functional @ functional) * variance(functional)
    return np.sqrt(as_normal(freedom) ** 2 * noise + beforehand)


def as_normal(freedom: float) -> float:
    """Standard deviation of the normal distribution that has as much within 1.96 of it as the t distribution of a sum whose variance is
    expected to be one.
    """
    return float(scipy.stats.t.ppf(0.975, freedom)) * np.sqrt((freedom - 2.0) / freedom) / TWO_SIDED_95


def _to_effects(runs: FreeRuns, tuning: Tuning, fitted: Fitted) -> np.ndarray:
    """(M, F) of the prediction with the free parameters, per unit of each, by central differences.

    One-sided ones are off by half a difference's curvature, which makes directions look determined that are not; and a part in a thousand
    of a frequency turns a phase by radians at a long record's end. So what moves the simulation by more than noise moves an estimate is
    taken again, nearer.
    """
    fitting, at = Coordinates(tuning, fitted.effects, fitted.values, Visited.by(runs)), Point(fitted.offset, fitted.values)

    def differences(shares: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        moves = fitting.around(at, shares)
        answers = runs.run([fitting.trial(to) for up, down, _ in moves for to in (up, down)])
        changes = np.zeros((len(moves), len(fitted.predicted))).T
        for k, (up, down) in enumerate(zip(answers[::2], answers[1::2], strict=True)):
            if up is not None and down is not None:
                changes[:, k] = up - down
        return changes, np.array([apart for *_, apart in moves])

    shares = np.full(len(fitting.free), FINE_SHARE)
    changes, _ = differences(shares)
    changes, apart = differences(shares / np.maximum(np.linalg.norm(changes, axis=0), 1.0))
    return changes / np.where(apart > 0.0, apart, 1.0)  # nothing changes between neighbours that are one number
