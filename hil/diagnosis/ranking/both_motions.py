"""Sets of effects with the parameters that training and held-out recordings want together.

What training hardly shows of a parameter, another motion may show well: the second order of an IMU's low pass is nothing to slow sweeps,
and where training's noise has put it, the right law misses a fast motion by more than a wrong one without such a parameter does. The
evidence of a law on both motions is that of its best parameters for both, less what the second motion narrows them by:

    min over p of cost(p) / T + held out(p) / T' + log det(1 + A / T + B / T') - log det(1 + A / T),

A and B the information on the parameters, in units of how far they may be off beforehand, the machine's numbers following, T and T' what
equations may err by in both (`naming.tempers_of`): where a law is far from the other motion, that one says little of its parameters. Where
the least is more than what training's own parameters cost, these stay: then they are known from training. Gates ask about training's.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hil.diagnosis.fitting.coordinates import Coordinates, Point
from hil.diagnosis.fitting.information import Narrowed
from hil.diagnosis.fitting.refit import Fitted, bounded, sensitivities_to_effects
from hil.diagnosis.fitting.visited import Visited
from hil.diagnosis.judging.held_out import Followed, HeldOut
from hil.diagnosis.judging.judgement import Contender
from hil.diagnosis.ranking.taken_over import acting, without_those_taken_over
from hil.diagnosis.tuning.free_run import HELD_OUT, FreeRuns
from hil.diagnosis.tuning.projection import Projection
from hil.diagnosis.tuning.retune import LARGEST_CHANGE, PRIOR, Tuning

STEPS = 3
HALVED_AT_MOST = 3

BENDING = 2.0
"""What a set may gain by its steps, in units of what the first one is expected to bring, before it is behind the best set for good."""

WORTH_A_STEP = 2.0
"""Expected decrease, in units of what the equations err by, below which parameters are where both motions want them."""


def with_both_motions(
    runs: FreeRuns, tuning: Tuning, held_out: HeldOut, contenders: Sequence[Contender], tempers: tuple[float, float] = (1.0, 1.0)
) -> tuple[Contender, ...]:
    """Sets as both motions want them, where that is likelier than as training does; `tempers` are T and T'."""
    found = {id(one): one for one in contenders}
    least = np.inf
    for one in sorted(contenders, key=lambda each: _misfit(each, tempers)):
        least = min(least, _misfit(one, tempers))
        found[id(one)] = _moved(runs, tuning, held_out, one, least, tempers)
        least = min(least, _misfit(found[id(one)], tempers))
    return tuple(found[id(one)] for one in contenders)


def _misfit(one: Contender, tempers: tuple[float, float]) -> float:
    return (one.fitted if one.moved is None else one.moved).cost / tempers[0] + one.left_held_out / tempers[1]


def _moved(runs: FreeRuns, tuning: Tuning, held_out: HeldOut, one: Contender, least: float, tempers: tuple[float, float]) -> Contender:
    """The set with the parameters that both motions want; `least` is the misfit on both of the best set so far."""
    (here, there), fitted = tempers, one.fitted
    before = held_out.follow(fitted.offset, fitted.settings)
    if before is None or not fitted.free:
        return one
    fitting = Coordinates(tuning, fitted.effects, fitted.values, Visited.by(runs))
    settings = runs.machine.plant
    projection, acts = Projection.of(without_those_taken_over(tuning, fitted.settings, settings)), acting(tuning, fitted.settings, settings)
    free = np.abs(tuning.offset) < LARGEST_CHANGE / PRIOR - 1e-6
    at, followed, price, narrowed = fitted, before, 0.0, None
    for number in range(STEPS):
        point = Point(at.offset, at.values)
        seen = sensitivities_to_effects(runs, tuning, replace(at, offset=at.offset + followed.moved), HELD_OUT)
        if seen is None:
            break
        slopes = fitting.slopes(point)
        seen, own = seen / slopes, fitted.jacobian / slopes
        left = projection.left(own.T).T
        seen = seen + held_out.change_by_numbers(_following(left, len(own), free), acts)
        trained, both = left.T @ left / here, left.T @ left / here + held_out.information(seen, acts) / there
        if number == 0:
            narrowed = Narrowed.of(here * trained, there * (both - trained), fitting.described(point))
            price = 2.0 * narrowed.cost(here, there)
        residual = np.concatenate([runs.measured() - at.predicted, -at.offset[free]])
        gradient = left.T @ residual / here + seen.T @ (held_out.measured - followed.predicted) / there
        count = len(at.offset)
        low, high = (bound[count:] for bound in fitting.reach(point, 1.0))
        step = bounded(both, gradient, low, high)
        expected = float(2.0 * step @ gradient - step @ both @ step)
        if expected < WORTH_A_STEP or (number == 0 and (expected < price or _misfit(one, tempers) - BENDING * expected > least)):
            break
        numbers = _following(left, len(own), free) @ step
        better = _stepped(runs, held_out, fitting, at, followed, np.concatenate([numbers, step]), tempers)
        if better is None:
            break
        at, followed = better
    if (at.cost - fitted.cost) / here + (followed.misfit - before.misfit) / there + price >= 0.0:
        return one
    by_moving = fitted.cost - at.cost, before.misfit - followed.misfit
    return replace(
        one,
        gained=one.gained + by_moving[0],
        gained_held_out=one.gained_held_out + by_moving[1],
        by_moving=by_moving,
        left_held_out=followed.misfit,
        moved=at,
        narrowed=narrowed,
    )


def _following(left: np.ndarray, rows: int, free: np.ndarray) -> np.ndarray:
    """(P, F) how the machine's numbers go with the parameters, so that training changes least."""
    numbers = np.zeros((len(free), left.shape[1]))
    numbers[free] = left[rows:]
    return numbers


def _stepped(
    runs: FreeRuns,
    held_out: HeldOut,
    fitting: Coordinates,
    at: Fitted,
    followed: Followed,
    step: np.ndarray,
    tempers: tuple[float, float],
) -> tuple[Fitted, Followed] | None:
    """After a step that lowers the misfit of both motions; None where none does."""
    bound = LARGEST_CHANGE / PRIOR
    for halved in range(HALVED_AT_MOST):
        to = fitting.moved(Point(at.offset, at.values), 0.5**halved * step)
        to = replace(to, offset=np.clip(to.offset, -bound, bound))
        predicted = runs.run_one(fitting.trial(to))
        if predicted is None:
            continue
        residual = runs.measured() - predicted
        cost = float(residual @ residual + to.offset @ to.offset)
        found = replace(at, values=to.values, offset=to.offset, predicted=predicted, cost=cost)
        there = held_out.follow(found.offset, found.settings)
        if there is not None and (cost - at.cost) / tempers[0] + (there.misfit - followed.misfit) / tempers[1] < 0.0:
            return found, there
    return None
