"""Do held-out recordings want the values of a set's parameters that training wants?

A right law keeps its numbers from motion to motion, an imitation of something else bends them anew. Chow's test (1960) of two sets of
coefficients: with A the information on the set's parameters in training and B held out (the machine's numbers free within what training
leaves open) and g the gradient there at training's values, the values differ by d = B^-1 g, of covariance T A^-1 + T' B^-1, and
g' (T B A^-1 B + T' B)^-1 g is chi-squared where one law holds in both. An equation errs by a share of what it removes in one motion
and in another way in the other, along its own response if it is unlucky (`naming.erring`): that counts in T beside the level of the noise.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import scipy.stats

from hil.diagnosis.free_run import HELD_OUT, FreeRuns
from hil.diagnosis.held_out import HeldOut
from hil.diagnosis.projection import Projection
from hil.diagnosis.refit import Fitted, sensitivities_to_effects
from hil.diagnosis.retune import Tuning

DRIFTED = 1e-3
"""Chance of as much drift under one law from which two motions do not share it. On development cases that are named rightly it is 0.006 at
least; where friction by acceleration is called by other frictions' names, below 1e-50."""

SEEN = 1e-9
"""Of the largest information in training, below which a direction is not known from there."""

APART = 1e-6
"""The same of what is compared: directions that neither shows say nothing."""


def chance_of_drift(runs: FreeRuns, tuning: Tuning, held_out: HeldOut, fitted: Fitted, erring: tuple[float, float]) -> float:
    """Probability of values that differ by as much between training and held-out recordings where one law holds.

    Parameters
    ----------
    runs : FreeRuns
    tuning : Tuning
        Without effects.
    held_out : HeldOut
    fitted : Fitted
        The probability is 1 where its held-out run cannot be simulated.
    erring : pair of float
        Energies, in training and held out, by which its equations may err.
    """
    followed = held_out.follow(fitted.offset, fitted.settings)
    if followed is None:
        return 1.0
    response = sensitivities_to_effects(runs, tuning, replace(fitted, offset=fitted.offset + followed.moved), HELD_OUT)
    if response is None:
        return 1.0
    projection = Projection.of(tuning)
    left = np.column_stack([projection.left(column) for column in fitted.jacobian.T])
    sizes = np.maximum(np.linalg.norm(left, axis=0), SEEN * np.linalg.norm(response, axis=0))  # training may not see one at all
    left, response = left / np.maximum(sizes, 1e-300), response / np.maximum(sizes, 1e-300)
    there = held_out.information(response)
    gradient = response.T @ (held_out.measured - followed.predicted)  # the numbers are nearly where they cost least
    freed = followed.misfit - _in_deviations(gradient, there)[0]  # with the values that these recordings want
    levels = fitted.cost / len(tuning.predicted), freed / len(followed.predicted)
    known, level = (max(1.0, noise) + energy for noise, energy in zip(levels, erring, strict=True))
    variances, directions = np.linalg.eigh(left.T @ left)
    inverse = (directions / np.maximum(variances, SEEN * max(variances[-1], 1.0))) @ directions.T
    squared, freedom = _in_deviations(gradient, known * there @ inverse @ there + level * there)
    return float(scipy.stats.chi2.sf(squared, freedom)) if freedom else 1.0


def _in_deviations(gradient: np.ndarray, covariance: np.ndarray) -> tuple[float, int]:
    """g' V^-1 g and how many directions of V count."""
    scale = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    variances, directions = np.linalg.eigh(covariance / scale[:, None] / scale)
    along = directions.T @ (gradient / scale)
    counts = variances > APART * variances[-1]
    return float(np.sum(along[counts] ** 2 / variances[counts])), int(np.sum(counts))
