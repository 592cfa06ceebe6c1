"""Do held-out recordings want the values of a set's parameters that training wants?

A right law keeps its numbers from motion to motion, an imitation of something else bends them anew. Chow's test (1960) of two sets of
coefficients: with A the information on the set's parameters in training and B held out (the machine's numbers free within what training
leaves open) and g the gradient there at training's values, the values differ by d = B^-1 g, of covariance T A^-1 + T' B^-1. In units of
what the held-out recordings tell, with B = H H', the deviations H^-1 g have the covariance T H' A^-1 H + T', whose directions are
independent. Along each, T and T' are the variance of the noise along the response (`gate.Scatter`: what the repeats' strengths scatter by,
which may be a hundred times what the noise model says) and what the equations may err by: an equation errs by a share of what it removes in
one motion and in another way in the other, along its own response if it is unlucky (`erring`). A variance that is known from three
or four repeats makes the sum of squares F and not chi-squared.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import scipy.stats

from hil.diagnosis.fitting.coordinates import difference, nearest_form
from hil.diagnosis.fitting.refit import Fitted, sensitivities_to_effects
from hil.diagnosis.judging.gate import Scatter
from hil.diagnosis.judging.held_out import HeldOut
from hil.diagnosis.ranking.taken_over import acting, without_those_taken_over
from hil.diagnosis.tuning.free_run import HELD_OUT, FreeRuns
from hil.diagnosis.tuning.projection import Projection
from hil.diagnosis.tuning.retune import Tuning
from virtual_bus.effects.effect import Parameter
from virtual_bus.effects.registry import effects

DRIFTED = 1e-3
"""Chance of as much drift under one law below which two motions do not share it. On benchmark machines that are named rightly it is 0.006
at least; where friction by acceleration is called by other frictions' names, below 1e-50."""

SEEN = 1e-9
"""Of the largest information in training, below which a direction is not known from there."""

SHOWN = 1e-6
"""The same of held-out recordings: what they do not show says nothing."""

KNOWN = 1e6
"""Variance from training, in units of the held-out recordings' own, beyond which a direction has nothing to be compared with."""


def chance_of_drift(
    runs: FreeRuns, tuning: Tuning, held_out: HeldOut, fitted: Fitted, erring: tuple[float, float], moved: Fitted | None = None
) -> float:
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
    moved : Fitted or None
        The set where both motions want it: how far the held-out recordings' values are from there is asked of the simulation there.
    """
    near = fitted if moved is None else moved
    followed = held_out.follow(near.offset, near.settings)
    if followed is None:
        return 1.0
    response = sensitivities_to_effects(runs, tuning, replace(near, offset=near.offset + followed.moved), HELD_OUT)
    if response is None:
        return 1.0
    forms = [nearest_form(*each) for each in zip(fitted.effects, near.values, fitted.values, strict=True)]
    response = response * [-1.0 if forms[e][k] == -near.values[e][k] != 0.0 else 1.0 for e, k in fitted.free]
    settings = runs.machine.plant
    projection = Projection.of(without_those_taken_over(tuning, fitted.settings, settings))
    left = np.column_stack([projection.left(column) for column in fitted.jacobian.T])
    sizes, unseen = np.linalg.norm(response, axis=0), np.linalg.norm(left, axis=0)
    sizes = np.where(sizes > 0.0, sizes, np.maximum(unseen, 1e-300))  # held-out recordings may not see one at all
    left, response = left / sizes, response / sizes
    shown, along = np.linalg.eigh(held_out.information(response, acting(tuning, fitted.settings, settings)))
    counts = shown > SHOWN * max(shown[-1], 1e-300)
    shown, along = np.sqrt(shown[counts]), along[:, counts]
    # the numbers are nearly where they cost least, so that only the set's own parameters have a gradient
    beyond = along.T @ response.T @ (held_out.measured - followed.predicted) / shown
    so_far = sizes * [difference(_parameter(fitted, e, k), forms[e][k], fitted.values[e][k]) for e, k in fitted.free]
    deviations = beyond + shown * (along.T @ so_far)
    seen, apart = np.linalg.eigh(left.T @ left)
    values = apart / np.sqrt(np.maximum(seen, SEEN * max(seen[-1], 1.0)))  # independent in training, each of variance 1
    directions, variances, weights = np.linalg.svd((along * shown).T @ values, full_matrices=False)
    known = variances**2 < KNOWN
    if not np.any(known):
        return 1.0
    freed = followed.misfit - float(beyond @ beyond)  # with the values that these recordings want
    levels = [max(1.0, fitted.cost / len(tuning.predicted)), max(1.0, freed / len(followed.predicted))]
    scatter, squared = Scatter(runs), 0.0
    for direction, variance, weight in zip(directions.T[known], variances[known] ** 2, weights[known], strict=True):
        strays = scatter.along((left @ values @ weight)[: len(tuning.predicted)])
        there, here = (level * strays + energy for level, energy in zip(levels, erring, strict=True))
        squared += float(direction @ deviations) ** 2 / (there * variance + here)
    count, freedom = int(np.sum(known)), scatter.freedom
    scale = (freedom - 2.0) / freedom  # of an inverse chi-squared distribution whose mean is 1
    return float(scipy.stats.f.sf(squared / count / scale, count, freedom))


def _parameter(fitted: Fitted, effect: int, number: int) -> Parameter:
    return effects()[fitted.effects[effect].effect].parameters[number]
