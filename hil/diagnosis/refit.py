"""Effects refitted together with the machine file's numbers, by free runs: Gauss-Newton within bounds and a trust region.

Nocedal and Wright 2006, ch. 4 and 10. Sensitivities of the effects' parameters are taken anew at every step, those of the tuned numbers,
which a small effect hardly changes, where a step does not bring what they say.
"""

from __future__ import annotations

from collections.abc import Generator, Sequence
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np
import scipy.optimize

from hil.diagnosis.candidates import setting_of
from hil.diagnosis.free_run import TRAIN, FreeRuns, Trial
from hil.diagnosis.information import Free, information_of
from hil.diagnosis.result import EffectAt
from hil.diagnosis.retune import LARGEST_CHANGE, PRIOR, Tuning, linearised, sensitivities_from, sensitivity_trials
from virtual_bus.effects.effect import Parameter
from virtual_bus.effects.registry import effects
from virtual_bus.settings import EffectSetting

STEPS = 12
ENOUGH = 1e-3
"""Relative decrease of the cost, or decrease below 0.5 in units of noise, at which a fit has ended."""

POLISHING_ROUNDS = 8
POLISHING_STEPS = 3
POLISHED_GAIN = 2.0
"""Decrease of the cost by which a round of polishing calls for another."""

STEP_SHARE = 0.01
"""Difference for sensitivities, as a share of a parameter's size."""

SMALLEST_SHARE = 1e-7
"""Of a parameter's range: the size of one that starts at zero is never taken for less."""

SMALLEST_OF_START = 0.01
"""The same for other parameters, of their start: a range made for machines of tonnes says nothing about a spring of milligrammes."""

NOT_FITTED = ("seed", "side", "sign", "length")
"""Parameters that only take some values: they stay where screening put them."""

LOGARITHMIC = ("vs", "f", "fc", "sigma0", "K", "z_max", "tau", "k", "Np", "Nl")
INVERSE = ("fc",)
"""Corner frequencies: what they do is in proportion to one over them."""

ORDER_UNIT = "cycles/turn"
PHASE_STEP = 0.02

WEAKER = (0.3, 0.1, 0.03)
"""Shares of a start's strength that are tried where the start is worse than no effect."""

TUNED_REACH = 1.0
"""Of a first step in the tuned numbers, in units of their prior."""

GOOD, FAIR = 0.7, 0.3
"""Shares of the expected decrease of the cost above which the region doubles and stays as it is."""

SHRINK, SHRUNK_AT_MOST = 0.3, 4
RELINEARISED, RELINEARISED_NEAR = 6, 1
"""Times at most that the tuned numbers' sensitivities are taken anew in one fit, far from the noise and near it: near it, polishing
does so for the few that are worth it."""

NEAR = 2.0
"""Misfit, in units of the noise's, below which a fit is near it."""

HOPELESS_AFTER = 4
"""Steps after which a fit that is worse than no effect ends."""

WORTH_LINEARISING = 4.0
"""Expected decrease of the cost, in units of noise, from which on that is worth its free runs."""

HELD = 0.99
"""Of the largest step, from which a parameter's step was held by the region; it is at least the parameter's own size there."""

RIDGE = 1e-9

SIDE_BY_SIDE = 4
"""Fits at a time: enough for every process to have work. Each holds the tuned numbers' sensitivities, 67 MB for a minute of the C-arm."""

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
    """

    effects: tuple[EffectAt, ...]
    values: tuple[np.ndarray, ...]
    offset: np.ndarray
    predicted: np.ndarray
    cost: float
    free: tuple[tuple[int, int], ...]
    jacobian: np.ndarray
    information: np.ndarray

    @property
    def settings(self) -> tuple[EffectSetting, ...]:
        return tuple(setting_of(effect, values) for effect, values in zip(self.effects, self.values, strict=True))

    @property
    def freedom(self) -> int:
        """Parameters that were fitted."""
        return len(self.free)


def fitted_parameters(effect: EffectAt) -> int:
    """How many of an effect's parameters are fitted."""
    return sum(parameter.name not in NOT_FITTED for parameter in effects()[effect.effect].parameters)


def refit(
    runs: FreeRuns,
    tuning: Tuning,
    measured: np.ndarray,
    starts: Sequence[tuple[tuple[EffectAt, ...], tuple[np.ndarray, ...]]],
    *,
    steps: int = STEPS,
    is_linearised: bool = False,
) -> list[Fitted | None]:
    """Fit several sets of effects, their free runs side by side. None where a set cannot be simulated at all.

    Far from the noise, what is missing has bent the tuned numbers: there every set is also fitted from the nominal ones, and the better fit
    counts; not where a fit goes on and the tuning `is_linearised` beside its effects.
    """
    way = _way(runs)
    offsets: list[np.ndarray | None] = [None]
    if not is_linearised and _cost(measured, tuning.predicted, tuning.offset) > NEAR * len(measured):
        offsets.append(np.zeros_like(tuning.offset))
    fits = [_fit(tuning, measured, names, values, steps, way, offset, is_linearised) for names, values in starts for offset in offsets]
    done = together(runs, fits)
    best = []
    for first in range(0, len(done), len(offsets)):
        found = [fit for fit in done[first : first + len(offsets)] if fit is not None]
        best.append(min(found, key=lambda fit: fit.cost) if found else None)
    return best


def polish(runs: FreeRuns, tuning: Tuning, measured: np.ndarray, fitted: Fitted) -> Fitted:
    """Fit on, with the tuned numbers' sensitivities taken where the effects are, as long as that helps."""
    for _ in range(POLISHING_ROUNDS):
        at = replace(tuning, offset=fitted.offset, values=tuning.at(fitted.offset), predicted=fitted.predicted)
        at = linearised(runs, at, fitted.settings)
        (again,) = refit(runs, at, measured, [(fitted.effects, fitted.values)], steps=POLISHING_STEPS, is_linearised=True)
        if again is None or again.cost > fitted.cost - POLISHED_GAIN:
            return fitted if again is None or again.cost > fitted.cost else again
        fitted = again
    return fitted


def sensitivities_to_effects(runs: FreeRuns, tuning: Tuning, fitted: Fitted, name: str) -> np.ndarray | None:
    """(M, F) of the whitened free run with a set's free parameters, per unit of each; None where the run itself cannot be simulated."""
    fitting, at = _Fitting(tuning, fitted.effects, fitted.values, _way(runs)), _Point(fitted.offset, fitted.values)
    moves = fitting.moves(at)
    base, *answers = runs.run([fitting.trial(at), *(fitting.trial(to) for to, _ in moves)], name)
    if base is None:
        return None
    columns = [np.zeros_like(base) if a is None else (a - base) / by for a, (_, by) in zip(answers, moves, strict=True)]
    return np.column_stack(columns) * fitting.slopes(at)


def together(runs: FreeRuns, fits: Sequence[Generator[list[Trial], Answers, Fitted | None]]) -> list[Fitted | None]:
    """Run generators that ask for trials side by side, so that every process has work."""
    done: list[Fitted | None] = [None] * len(fits)
    asked: dict[int, list[Trial]] = {}
    waiting = iter(range(len(fits)))
    while True:
        for number in islice(waiting, SIDE_BY_SIDE - len(asked)):
            asked[number] = next(fits[number])
        if not asked:
            return done
        answers = iter(runs.run([trial for trials in asked.values() for trial in trials], TRAIN))
        following: dict[int, list[Trial]] = {}
        for number, trials in asked.items():
            try:
                following[number] = fits[number].send([next(answers) for _ in trials])
            except StopIteration as end:
                done[number] = end.value
        asked = following


def _fit(
    tuning: Tuning,
    measured: np.ndarray,
    names: tuple[EffectAt, ...],
    values: tuple[np.ndarray, ...],
    steps: int,
    way: float,
    offset: np.ndarray | None,
    is_linearised: bool,
) -> Generator[list[Trial], Answers, Fitted | None]:
    """Gauss-Newton in a trust region, as a generator of trials, from the tuned numbers or from this offset.

    The tuned numbers' sensitivities are taken anew where a step does not bring what they say and they are not of this very point.
    """
    fitting = _Fitting(tuning, names, values, way)
    base = _cost(measured, tuning.predicted, tuning.offset) if offset is None else np.inf
    at = _Point(tuning.offset.copy() if offset is None else offset, tuple(np.array(v, dtype=float) for v in values))
    starts = [at, *(_Point(at.offset, _weaker(names[-1], at.values, share)) for share in WEAKER)]
    found: tuple[float, _Point, np.ndarray] | None = None
    for start in starts:
        (answer,) = yield [fitting.trial(start)]
        if answer is not None and (found is None or _cost(measured, answer, start.offset) < found[0]):
            found = _cost(measured, answer, start.offset), start, answer
        if found is not None and found[0] <= base:
            break
    if found is None:
        return None
    cost, at, predicted = found
    tuned = tuning.jacobian
    stale = RELINEARISED if NEAR * len(measured) < cost < base else RELINEARISED_NEAR
    if offset is not None:
        trials, differences = sensitivity_trials(tuning, at.offset, fitting.settings(at))
        tuned = sensitivities_from((yield trials), differences, predicted)
    square = tuned.T @ tuned
    radius = 1.0
    is_fresh = is_linearised or offset is not None
    for number in range(steps):
        if number >= HOPELESS_AFTER and cost > base:
            break
        jacobian = yield from _sensitivities(fitting, at, predicted)
        gained = None
        shrunk = 0
        while shrunk < SHRUNK_AT_MOST:
            hessian, gradient = _normal_equations(square, tuned, jacobian, measured - predicted, at.offset)
            reach = fitting.reach(at, radius)
            step = _bounded_step(hessian, gradient, *reach)
            expected = float(2.0 * step @ gradient - step @ hessian @ step)
            to = fitting.moved(at, step)
            (answer,) = yield [fitting.trial(to)]
            gain = -np.inf if answer is None else cost - _cost(measured, answer, to.offset)
            fair = gain > FAIR * expected
            if not fair and stale and not is_fresh and expected > WORTH_LINEARISING:
                stale, is_fresh = stale - 1, True
                trials, differences = sensitivity_trials(tuning, at.offset, fitting.settings(at))
                tuned = sensitivities_from((yield trials), differences, predicted)
                square = tuned.T @ tuned
                if gain <= 0.0:
                    continue
            if answer is not None and gain > 0.0:
                radius *= 2.0 if gain > GOOD * expected else 1.0 if fair else 0.5
                at, predicted, cost, gained = to, answer, cost - gain, gain
                is_fresh = False
                break
            radius = SHRINK * min(radius, float(np.abs(step).max()))
            shrunk += 1
        if gained is None or (gained < max(ENOUGH * cost * len(at.offset) / len(measured), 0.5) and not fitting.was_held(step, reach)):
            break
    else:  # its steps ran out on the way; where a fit goes on, it takes them itself
        if not is_linearised:
            jacobian = yield from _sensitivities(fitting, at, predicted)
    hessian, _ = _normal_equations(square, tuned, jacobian, measured - predicted, at.offset)
    information = information_of(hessian, len(at.offset), fitting.described(at))
    return Fitted(names, at.values, at.offset, predicted, cost, fitting.free, jacobian * fitting.slopes(at), information)


def _sensitivities(fitting: _Fitting, at: _Point, predicted: np.ndarray) -> Generator[list[Trial], Answers, np.ndarray]:
    """(M, F) of a prediction with the free parameters, in units of their size; 0 where a neighbour cannot be simulated."""
    moves = fitting.moves(at)
    answers = yield [fitting.trial(move) for move, _ in moves]
    jacobian = np.zeros((len(predicted), len(moves)))
    for column, ((_, difference), answer) in enumerate(zip(moves, answers, strict=True)):
        jacobian[:, column] = 0.0 if answer is None else (answer - predicted) / difference
    return jacobian


@dataclass(frozen=True, eq=False)
class _Point:
    """Tuned coordinates and the effects' parameters."""

    offset: np.ndarray
    values: tuple[np.ndarray, ...]


class _Fitting:
    """What is fitted: tuned coordinates, and effects' free parameters in units of their size where the fit is."""

    def __init__(self, tuning: Tuning, names: tuple[EffectAt, ...], starts: tuple[np.ndarray, ...], way: float) -> None:
        self._tuning, self._names = tuning, names
        self._parameters = [effects()[name.effect].parameters for name in names]
        self.free = tuple((e, k) for e, own in enumerate(self._parameters) for k, p in enumerate(own) if p.name not in NOT_FITTED)
        self._least = [_least_size(self._parameters[e][k], starts[e][k], way) for e, k in self.free]

    def settings(self, at: _Point) -> tuple[EffectSetting, ...]:
        return tuple(setting_of(name, own) for name, own in zip(self._names, at.values, strict=True))

    def trial(self, at: _Point) -> Trial:
        return Trial(self._tuning.at(at.offset), self.settings(at))

    def moves(self, at: _Point) -> list[tuple[_Point, float]]:
        """Neighbours in every free parameter, and how far they are in units of its size."""
        found = []
        for (e, k), size in zip(self.free, self._sizes(at), strict=True):
            parameter, value = self._parameters[e][k], at.values[e][k]
            step = PHASE_STEP if _is_phase(parameter) else STEP_SHARE
            if _is_inverse(parameter, value):
                found.append((_Point(at.offset, _with(at.values, e, k, value / (1.0 + step))), step))
                continue
            neighbour = value + step * size
            if neighbour > parameter.high:
                neighbour = value - step * size
            found.append((_Point(at.offset, _with(at.values, e, k, neighbour)), (neighbour - value) / size))
        return found

    def reach(self, at: _Point, radius: float) -> tuple[np.ndarray, np.ndarray]:
        """Lowest and highest step of all coordinates: to their bounds, and not further than they are trusted."""
        bound = LARGEST_CHANGE / PRIOR
        low, high = list(np.maximum(-bound - at.offset, -TUNED_REACH * radius)), list(np.minimum(bound - at.offset, TUNED_REACH * radius))
        for (e, k), size in zip(self.free, self._sizes(at), strict=True):
            parameter, value = self._parameters[e][k], at.values[e][k]
            up = 1.0 if _is_phase(parameter) else 3.0
            down = 0.6 if parameter.name in LOGARITHMIC else up
            if _is_inverse(parameter, value):
                low.append(max(value / parameter.high - 1.0, -0.8 * min(radius, 1.0)))
                high.append(up * radius)
            else:
                low.append(max((parameter.low - value) / size, -down * min(radius, 1.0) if down < 1.0 else -down * radius))
                high.append(min((parameter.high - value) / size, up * radius))
        return np.array(low), np.array(high)

    def was_held(self, step: np.ndarray, reach: tuple[np.ndarray, np.ndarray]) -> bool:
        """Whether a step of the effects' parameters was as large as it may be in the region: much weaker than it should be, an effect gains
        nothing at first.
        """
        own = step[-len(self.free) :]
        return bool(np.any((own >= HELD * reach[1][-len(own) :]) & (own >= HELD)))

    def moved(self, at: _Point, step: np.ndarray) -> _Point:
        """The point a step leads to."""
        offset, values = at.offset + step[: len(at.offset)], at.values
        for (e, k), size, change in zip(self.free, self._sizes(at), step[len(at.offset) :], strict=True):
            parameter, value = self._parameters[e][k], at.values[e][k]
            to = value / (1.0 + change) if _is_inverse(parameter, value) else value + change * size
            values = _with(values, e, k, float(np.clip(to, parameter.low, parameter.high)))
        return _Point(offset, values)

    def slopes(self, at: _Point) -> np.ndarray:
        """(F,) factors from sensitivities per size to sensitivities per unit of the parameter."""
        found = []
        for (e, k), size in zip(self.free, self._sizes(at), strict=True):
            value = at.values[e][k]
            found.append(-1.0 / value if _is_inverse(self._parameters[e][k], value) else 1.0 / size)
        return np.array(found)

    def described(self, at: _Point) -> list[Free]:
        """The free parameters."""
        each = zip(self.free, self._sizes(at), strict=True)
        return [Free(e, self._parameters[e][k], float(at.values[e][k]), size) for (e, k), size in each]

    def _sizes(self, at: _Point) -> list[float]:
        found = []
        for (e, k), least in zip(self.free, self._least, strict=True):
            fixed = _is_phase(self._parameters[e][k]) or _is_order(self._parameters[e][k])
            found.append(least if fixed else max(abs(at.values[e][k]), least))
        return found


def _weaker(name: EffectAt, values: tuple[np.ndarray, ...], share: float) -> tuple[np.ndarray, ...]:
    """The last effect with this share of its strengths."""
    last = values[-1].copy()
    for k, parameter in enumerate(effects()[name.effect].parameters):
        if parameter.is_strength and parameter.name not in NOT_FITTED:
            last[k] = last[k] / share if _is_inverse(parameter, last[k]) else parameter.neutral + share * (last[k] - parameter.neutral)
            last[k] = np.clip(last[k], parameter.low, parameter.high)
    return (*values[:-1], last)


def _is_phase(parameter: Parameter) -> bool:
    return parameter.unit == "phase" and not parameter.is_strength


def _is_order(parameter: Parameter) -> bool:
    return parameter.unit == ORDER_UNIT and not parameter.is_strength


def _is_inverse(parameter: Parameter, value: float) -> bool:
    """Whether a parameter is fitted as one over itself, in which its effect is closer to linear."""
    return parameter.name in INVERSE and value > 0.0


def _normal_equations(
    tuned: np.ndarray, jacobian: np.ndarray, added: np.ndarray, residual: np.ndarray, offset: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Of |residual - [J, J_added] step|^2 + |offset + step_tuned|^2; `tuned` is J'J."""
    across = jacobian.T @ added
    hessian = np.block([[tuned + np.eye(len(tuned)), across], [across.T, added.T @ added]])
    return hessian, np.concatenate([jacobian.T @ residual - offset, added.T @ residual])


def _way(runs: FreeRuns) -> float:
    """Longest way of any motor over all training recordings [rad or m of its own coordinate]."""
    positions = np.concatenate([group.position for group in runs.sets[TRAIN].groups])
    return float((np.ptp(positions, axis=0) * [drive.ratio for drive in runs.machine.plant.drives]).max())


def _bounded_step(hessian: np.ndarray, gradient: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    root = np.linalg.cholesky(hessian + np.diag(RIDGE * np.diag(hessian) + RIDGE)).T
    target = np.linalg.solve(root.T, gradient)
    return scipy.optimize.lsq_linear(root, target, bounds=(np.minimum(low, -1e-12), np.maximum(high, 1e-12)), method="bvls").x


def _least_size(parameter: Parameter, start: float, way: float) -> float:
    """What a parameter's size, a large change of it, is never taken for less than; of phases and orders it is the size itself.

    An order over position turns a phase by one radian over the motor's way when it changes by one over that way.
    """
    if _is_phase(parameter):
        return 1.0
    if _is_order(parameter):
        return 1.0 / max(way, 1e-12)
    return max(SMALLEST_OF_START * abs(start) if start != 0.0 else SMALLEST_SHARE * (parameter.high - parameter.low), 1e-12)


def _with(values: Sequence[np.ndarray], effect: int, number: int, value: float) -> tuple[np.ndarray, ...]:
    changed = [np.array(v) for v in values]
    changed[effect][number] = value
    return tuple(changed)


def _cost(measured: np.ndarray, predicted: np.ndarray, offset: np.ndarray) -> float:
    return float(np.sum((measured - predicted) ** 2) + np.sum(offset**2))
