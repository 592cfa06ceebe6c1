"""Effects refitted together with the machine file's numbers, by free runs: Gauss-Newton within bounds and a trust region.

Nocedal and Wright 2006, ch. 4 and 10. Sensitivities of the effects' parameters are taken anew at every step, those of the tuned numbers,
which a small effect hardly changes, are mended by the steps taken and taken anew where these do not bring what they say.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass, field, replace
from itertools import islice

import numpy as np

from hil.diagnosis.fitting.coordinates import WEAKER, Coordinates, Point, weaker
from hil.diagnosis.fitting.information import Form, information_of, simpler_forms
from hil.diagnosis.fitting.tuned_sensitivities import TunedSensitivities
from hil.diagnosis.fitting.visited import Visited
from hil.diagnosis.result import EffectAt
from hil.diagnosis.starting.candidates import setting_of
from hil.diagnosis.tuning.free_run import FreeRuns, Trial
from hil.diagnosis.tuning.least_squares import least_within
from hil.diagnosis.tuning.retune import PRIOR, Tuning, bounded_step, sensitivities_from, sensitivity_trials
from virtual_bus.settings import EffectSetting

STEPS = 12
ENOUGH = 1e-3
"""Relative decrease of the cost, or decrease below 0.5 in units of noise, at which a fit has ended."""

POLISHING_ROUNDS = 8
POLISHING_STEPS = 3
POLISHED_GAIN = 2.0
"""Decrease of the cost by which a round of polishing calls for another."""

GOOD, FAIR = 0.7, 0.3
"""Shares of the expected decrease of the cost above which the region doubles and stays as it is."""

SHRINK, SHRUNK_AT_MOST = 0.3, 4
RELINEARISED, RELINEARISED_NEAR = 6, 1
"""Times at most that the tuned numbers' sensitivities are taken anew in one fit, far from the noise and near it: near it, polishing
does so for the few that are worth it."""

NEAR = 2.0
"""Misfit, in units of the noise's, below which a fit is near it."""

HOPELESS_AFTER = 4
"""Steps after which a fit ends that is worse than no effect and cannot come below it at the pace of its last step."""

WORTH_LINEARISING = 4.0
"""Expected decrease of the cost, in units of noise, from which on that is worth its free runs."""

MANY, LONG = 30, 2_000_000
"""Tuned numbers, and entries of their sensitivities, beyond which these are most of what fits cost: only there fits wait with them and are
left when behind. With fewer, a fit that is never left and takes them at once costs seconds and ends lower: without, a pair on a machine of
two axes may be lost. 27 numbers are LONG from half a minute of ten channels at 256 Hz on."""

UNFAIR = 2
"""Tries in a row that bring less than their sensitivities said before these are taken anew: one is mended by what it showed itself."""

FOLLOWED_AT_MOST = 4
"""Steps of the tuned numbers beside a start. Numbers that are nearly degenerate go along a bent valley: the first step leads out of it by
far more than was to be won, and those after it back to its floor."""

MADE_UP_FOR = 0.5
"""Share of what a start costs more than no effect that is left where its tuned numbers have made up for most of it."""

LOST_AFTER = 3
"""Steps after which a fit may be found to be behind for good."""

QUICKENING = 2.0
"""What the steps left may gain each, in units of the last one's, before a fit is hopeless or behind for good."""

NEARLY = 0.9
"""Share of the best fit's gain: those that gain less are no rivals."""

RIDGE = 1e-9

SIDE_BY_SIDE, HELD_ENTRIES = 16, 64_000_000
"""Fits at a time, so that runs of several go side by side, and fewer where they might hold more entries of sensitivities than that: each
holds the tuned numbers' own, 7.5 million of them for a minute of the C-arm."""

Answers = list[np.ndarray | None]


@dataclass(frozen=True, eq=False)
class Fitted:
    """A set of effects with the parameters that fit best.

    Attributes
    ----------
    effects : tuple of EffectAt
    values : tuple of (parameters,) arrays
        In the catalogue's order.
    offset : (P,) array
        Tuned coordinates, see retune.py.
    predicted : (M,) array
        Whitened free run.
    cost : float
        |residual|^2 + |offset|^2 on the training groups.
    free : tuple of (effect number, parameter number)
        Of the columns of `jacobian`.
    jacobian : (M, F) array
        Of the prediction with the free effect parameters, in their units.
    information : (F,) array
        Energies, in units of noise, that the recordings lose by changes of the free parameters as large as these may be beforehand, with
        the tuned numbers free (`information.py`): what a parameter that the recordings do not see has none of.
    simpler : tuple of Form
        The set without some of its laws' terms.
    """

    effects: tuple[EffectAt, ...]
    values: tuple[np.ndarray, ...]
    offset: np.ndarray
    predicted: np.ndarray
    cost: float
    free: tuple[tuple[int, int], ...]
    jacobian: np.ndarray
    information: np.ndarray
    simpler: tuple[Form, ...] = ()

    @property
    def settings(self) -> tuple[EffectSetting, ...]:
        return tuple(setting_of(effect, values) for effect, values in zip(self.effects, self.values, strict=True))

    @property
    def freedom(self) -> int:
        """Parameters that were fitted."""
        return len(self.free)


def refit(
    runs: FreeRuns,
    tuning: Tuning,
    measured: np.ndarray,
    starts: Sequence[tuple[tuple[EffectAt, ...], tuple[np.ndarray, ...]]],
) -> list[Fitted | None]:
    """Fit several sets of effects, their free runs side by side. None where a set cannot be simulated at all.

    Far from the noise, what is missing has bent the tuned numbers: there every set is also fitted from the nominal ones, and the better fit
    counts.
    """
    visited = Visited.by(runs)
    offsets: list[np.ndarray | None] = [None]
    base = _cost(measured, tuning.predicted, tuning.offset)
    if base > NEAR * len(measured):
        offsets.append(np.zeros_like(tuning.offset))
    tuned, race = TunedSensitivities.of(tuning.jacobian), _Race(base)
    fits = [_fit(tuning, tuned, measured, names, values, STEPS, visited, offset, race) for names, values in starts for offset in offsets]
    done = together(runs, fits, side_by_side(tuning))
    best = []
    for first in range(0, len(done), len(offsets)):
        found = [fit for fit in done[first : first + len(offsets)] if fit is not None]
        best.append(min(found, key=lambda fit: fit.cost) if found else None)
    return best


def polish(runs: FreeRuns, tuning: Tuning, measured: np.ndarray, fits: Sequence[Fitted], rounds: int = POLISHING_ROUNDS) -> list[Fitted]:
    """Fit on, with the tuned numbers' sensitivities taken where the effects are, as long as that helps."""
    visited = Visited.by(runs)
    done = together(runs, [_polished(tuning, measured, fitted, visited, rounds) for fitted in fits], side_by_side(tuning))
    return [before if after is None else after for before, after in zip(fits, done, strict=True)]


def _polished(
    tuning: Tuning, measured: np.ndarray, fitted: Fitted, visited: Visited, rounds: int
) -> Generator[list[Trial], Answers, Fitted | None]:
    for _ in range(rounds):
        at = replace(tuning, offset=fitted.offset, values=tuning.at(fitted.offset), predicted=fitted.predicted)
        tuned = yield from _taken_anew(tuning, fitted.offset, fitted.settings, fitted.predicted)
        again = yield from _fit(at, tuned, measured, fitted.effects, fitted.values, POLISHING_STEPS, visited, None, None)
        if again is None or again.cost > fitted.cost - POLISHED_GAIN:
            return fitted if again is None or again.cost > fitted.cost else again
        fitted = again
    return fitted


def sensitivities_to_effects(runs: FreeRuns, tuning: Tuning, fitted: Fitted, name: str) -> np.ndarray | None:
    """(M, F) of the whitened free run with a set's free parameters, per unit of each; None where the run itself cannot be simulated."""
    fitting, at = Coordinates(tuning, fitted.effects, fitted.values, Visited.by(runs)), Point(fitted.offset, fitted.values)
    moves = fitting.moves(at)
    base, *answers = runs.run([fitting.trial(at), *(fitting.trial(to) for to, _ in moves)], name)
    if base is None:
        return None
    columns = [np.zeros_like(base) if a is None or by == 0.0 else (a - base) / by for a, (_, by) in zip(answers, moves, strict=True)]
    return np.column_stack(columns) * fitting.slopes(at)


def side_by_side(tuning: Tuning) -> int:
    """How many fits are made at a time."""
    return max(2, min(SIDE_BY_SIDE, HELD_ENTRIES // max(tuning.jacobian.size, 1)))


def together(runs: FreeRuns, fits: Sequence[Generator[list[Trial], Answers, Fitted | None]], at_a_time: int) -> list[Fitted | None]:
    """Run generators that ask for trials side by side: while one works on its answers, those of the others are under way."""
    done: list[Fitted | None] = [None] * len(fits)
    asked: dict[int, Callable[[], Answers]] = {}
    waiting = iter(range(len(fits)))
    while True:
        for number in islice(waiting, at_a_time - len(asked)):
            asked[number] = runs.begin(next(fits[number]))
        if not asked:
            return done
        for number, answers in list(asked.items()):
            try:
                asked[number] = runs.begin(fits[number].send(answers()))
            except StopIteration as end:
                done[number] = end.value
                del asked[number]


@dataclass(eq=False)
class _Race:
    """What the fits of one call have come to: `base` is the cost without what they add."""

    base: float
    lowest: dict[tuple[EffectAt, ...], float] = field(default_factory=dict)

    def enter(self, names: tuple[EffectAt, ...], cost: float) -> None:
        self.lowest[names] = min(cost, self.lowest.get(names, np.inf))

    def is_lost(self, names: tuple[EffectAt, ...], least: float) -> bool:
        """Whether a fit that comes no lower than this is neither its set's best nor a rival of the best set."""
        return least > self.lowest[names] or self.base - least < NEARLY * (self.base - min(self.lowest.values()))


def _fit(
    tuning: Tuning,
    tuned: TunedSensitivities,
    measured: np.ndarray,
    names: tuple[EffectAt, ...],
    values: tuple[np.ndarray, ...],
    steps: int,
    visited: Visited,
    offset: np.ndarray | None,
    race: _Race | None,
) -> Generator[list[Trial], Answers, Fitted | None]:
    """Gauss-Newton in a trust region, as a generator of trials, from the tuned numbers or from this offset.

    Without a race a fit goes on, and the sensitivities are of this very point.
    """
    fitting = Coordinates(tuning, names, values, visited)
    base = _cost(measured, tuning.predicted, tuning.offset) if offset is None else np.inf
    at = fitting.point(tuning.offset.copy() if offset is None else offset, values)
    found = yield from _begun(fitting, tuning, tuned, measured, names[-1], at, base)
    if found is None:
        return None
    cost, at, predicted = found
    stale = RELINEARISED if NEAR * len(measured) < cost < base else RELINEARISED_NEAR
    radius, gained, unfair = 1.0, 0.0, 0
    is_large = are_costly(tuning)
    is_fresh, was_held = race is None or (offset is not None and not is_large), False
    if offset is not None and not is_large:
        tuned = yield from _taken_anew(tuning, at.offset, fitting.settings(at), predicted)
    for number in range(steps):
        if number >= HOPELESS_AFTER and cost - QUICKENING * gained * (steps - number) > base:
            break
        if race is not None:
            race.enter(names, cost)
            if is_large and number >= LOST_AFTER and not was_held and race.is_lost(names, cost - QUICKENING * gained * (steps - number)):
                break
        jacobian, taken_at = (yield from _sensitivities(fitting, at, predicted)), at
        hessian, gradient = _normal_equations(tuned, jacobian, measured - predicted, at.offset)
        gained, shrunk = 0.0, 0
        while shrunk < SHRUNK_AT_MOST:
            reach = fitting.reach(at, radius)
            step = bounded(hessian, gradient, *reach)
            expected = float(2.0 * step @ gradient - step @ hessian @ step)
            to = fitting.moved(at, step)
            (answer,) = yield [fitting.trial(to)]
            gain = -np.inf if answer is None else cost - _cost(measured, answer, to.offset)
            fair = gain > FAIR * expected
            unfair = 0 if fair else unfair + 1
            if unfair >= (UNFAIR if is_large else 1) and stale and not is_fresh and expected > WORTH_LINEARISING:
                stale, is_fresh = stale - 1, True
                tuned = yield from _taken_anew(tuning, at.offset, fitting.settings(at), predicted)
                hessian, gradient = _normal_equations(tuned, jacobian, measured - predicted, at.offset)
                if gain <= 0.0:
                    continue
            if answer is not None and gain > 0.0:
                radius *= 2.0 if gain > GOOD * expected else 1.0 if fair else 0.5
                own = step[len(at.offset) :]
                moved = to.offset - at.offset
                if is_large:
                    tuned = tuned.after(moved, float(own @ own) / PRIOR**2, answer - predicted - tuned.along(moved) - jacobian @ own)
                at, predicted, cost, gained = to, answer, cost - gain, gain
                is_fresh = False
                break
            radius = SHRINK * min(radius, float(np.abs(step).max()))
            shrunk += 1
        was_held = fitting.was_held(step, reach)
        if gained == 0.0 or (gained < max(ENOUGH * cost * len(at.offset) / len(measured), 0.5) and not was_held):
            break
    else:  # its steps ran out on the way; where a fit goes on, it takes them itself
        if race is not None:
            jacobian, taken_at = (yield from _sensitivities(fitting, at, predicted)), at
    jacobian = jacobian * (fitting.slopes(taken_at) / fitting.slopes(at))  # sizes are those of the point where a fit ends
    if race is not None:
        race.enter(names, cost)
    hessian, _ = _normal_equations(tuned, jacobian, measured - predicted, at.offset)
    described = fitting.described(at)
    information = information_of(hessian, len(at.offset), described)
    simpler = simpler_forms(hessian, len(at.offset), described)
    return Fitted(names, at.values, at.offset, predicted, cost, fitting.free, jacobian * fitting.slopes(at), information, simpler)


def _begun(
    fitting: Coordinates, tuning: Tuning, tuned: TunedSensitivities, measured: np.ndarray, last: EffectAt, at: Point, base: float
) -> Generator[list[Trial], Answers, tuple[float, Point, np.ndarray] | None]:
    """Where a fit begins, with its cost and prediction: at its start; if that is worse than no effect, with the tuned numbers where the
    filter had them beside it, which found this start with the numbers following; else with the last effect weaker. None where nothing can
    be simulated.

    A weaker effect is always nearer to none. Where the numbers made up for most of what the whole one costs, a weaker one counts if it is
    better than no effect: a friction that warms at a thirtieth of its strength does not warm, and a fit that begins there ends there.
    """
    found: tuple[float, Point, np.ndarray] | None = None
    whole = np.inf  # what it costs at its start
    weaker_ones = iter([Point(at.offset, weaker(last, at.values, share)) for share in WEAKER])
    start: Point | None = at
    followed = 0
    while start is not None and (found is None or found[0] > base):
        (answer,) = yield [fitting.trial(start)]
        following = None
        if answer is not None:
            cost = _cost(measured, answer, start.offset)
            whole = cost if start is at else whole  # only of whole starts numbers can have made up for something
            is_followed = found is not None and found[1].values is at.values and found[0] - base < MADE_UP_FOR * (whole - base)
            if found is None or (cost < found[0] and (cost < base or start.values is at.values or not is_followed)):
                found = cost, start, answer
            if found[0] > base and start.values is at.values and followed < FOLLOWED_AT_MOST:
                gradient = tuned.across(measured - answer) - start.offset
                hessian = tuned.square + np.eye(len(tuned.square))
                step = bounded_step(tuning, hessian, gradient, start.offset)
                if followed or cost - float(2.0 * step @ gradient - step @ hessian @ step) < base:
                    following, followed = Point(start.offset + step, at.values), followed + 1
        start = next(weaker_ones, None) if following is None else following
    return found


def _taken_anew(
    tuning: Tuning, offset: np.ndarray, settings: tuple[EffectSetting, ...], predicted: np.ndarray
) -> Generator[list[Trial], Answers, TunedSensitivities]:
    """Sensitivities at a point."""
    trials, differences = sensitivity_trials(tuning, offset, settings)
    return TunedSensitivities.of(sensitivities_from((yield trials), differences, predicted))


def _sensitivities(fitting: Coordinates, at: Point, predicted: np.ndarray) -> Generator[list[Trial], Answers, np.ndarray]:
    """(M, F) of a prediction with the free parameters, in units of their size; 0 where a neighbour cannot be simulated or is none."""
    moves = fitting.moves(at)
    answers = yield [fitting.trial(move) for move, _ in moves]
    jacobian = np.zeros((len(predicted), len(moves)))
    for column, ((_, difference), answer) in enumerate(zip(moves, answers, strict=True)):
        jacobian[:, column] = 0.0 if answer is None or difference == 0.0 else (answer - predicted) / difference
    return jacobian


def _normal_equations(
    tuned: TunedSensitivities, added: np.ndarray, residual: np.ndarray, offset: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Of |residual - [J, J_added] step|^2 + |offset + step_tuned|^2."""
    products = tuned.across(np.column_stack([added, residual]))
    across, along = products[:, :-1], products[:, -1]
    hessian = np.block([[tuned.square + np.eye(len(tuned.square)), across], [across.T, added.T @ added]])
    return hessian, np.concatenate([along - offset, added.T @ residual])


def are_costly(tuning: Tuning) -> bool:
    """Whether sensitivities to the tuned numbers are most of what fits cost."""
    return len(tuning.offset) > MANY or tuning.jacobian.size > LONG


def bounded(hessian: np.ndarray, gradient: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """The step to the least of a quadratic cost within bounds."""
    root = np.linalg.cholesky(hessian + np.diag(RIDGE * np.diag(hessian) + RIDGE)).T
    target = np.linalg.solve(root.T, gradient)
    return least_within(root, target, np.minimum(low, -1e-12), np.maximum(high, 1e-12))


def _cost(measured: np.ndarray, predicted: np.ndarray, offset: np.ndarray) -> float:
    return float(np.sum((measured - predicted) ** 2) + np.sum(offset**2))
