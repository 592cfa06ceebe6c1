"""Effects refitted together with the machine file's numbers, by free runs: Levenberg-Marquardt within bounds.

Nocedal and Wright 2006, ch. 10.3. Sensitivities of the tuned numbers are those of the re-tuned machine (they change little with an effect);
sensitivities of the effects' parameters are taken anew at every step.
"""

from __future__ import annotations

from collections.abc import Generator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.optimize

from hil.diagnosis.candidates import setting_of
from hil.diagnosis.free_run import TRAIN, FreeRuns, Trial
from hil.diagnosis.result import EffectAt
from hil.diagnosis.retune import LARGEST_CHANGE, PRIOR, Tuning, linearised
from virtual_bus.effects.effect import Parameter
from virtual_bus.effects.registry import effects
from virtual_bus.settings import EffectSetting

STEPS = 7
ENOUGH = 1e-3
"""Relative decrease of the cost, or decrease below 0.5 in units of noise, at which a fit has ended."""

POLISHING_ROUNDS = 3
POLISHING_STEPS = 3
FIRST_DAMPING = 1e-3
POLISHING_DAMPING = 1e-7
"""In units of the curvature's diagonal. A machine's numbers that scale alike lie along a valley whose curvature is the prior's, 10^-4 and
less of the diagonal: more damping ends a fit on its way along it, and a friction's strength, which scales with them, off by a tenth."""

POLISHED_GAIN = 1.0
"""Decrease of the cost by which a round of polishing calls for another."""

STEP_SHARE = 0.01
"""Difference for sensitivities, as a share of a parameter's size."""

SMALLEST_SHARE = 1e-7
"""Of a parameter's range: its size is never taken for less."""

NOT_FITTED = ("seed", "side", "sign", "length")
"""Parameters that only take some values: they stay where screening put them."""

LOGARITHMIC = ("vs", "f", "fc", "sigma0", "K", "z_max", "tau", "k", "Np", "Nl")
PHASE_STEP = 0.02

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
    """

    effects: tuple[EffectAt, ...]
    values: tuple[np.ndarray, ...]
    offset: np.ndarray
    predicted: np.ndarray
    cost: float
    free: tuple[tuple[int, int], ...]
    jacobian: np.ndarray

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
    *,
    steps: int = STEPS,
    damping: float = FIRST_DAMPING,
) -> list[Fitted | None]:
    """Fit several sets of effects, their free runs side by side. None where a set cannot be simulated at all."""
    fits = [_fit(tuning, measured, names, values, steps, damping) for names, values in starts]
    return together(runs, fits)


def polish(runs: FreeRuns, tuning: Tuning, measured: np.ndarray, fitted: Fitted) -> Fitted:
    """Fit on, with the tuned numbers' sensitivities taken where the effects are, as long as that helps."""
    for _ in range(POLISHING_ROUNDS):
        at = replace(tuning, offset=fitted.offset, values=tuning.at(fitted.offset), predicted=fitted.predicted)
        at = linearised(runs, at, fitted.settings)
        (again,) = refit(runs, at, measured, [(fitted.effects, fitted.values)], steps=POLISHING_STEPS, damping=POLISHING_DAMPING)
        if again is None or again.cost > fitted.cost - POLISHED_GAIN:
            return fitted if again is None or again.cost > fitted.cost else again
        fitted = again
    return fitted


def together(runs: FreeRuns, fits: Sequence[Generator[list[Trial], Answers, Fitted | None]]) -> list[Fitted | None]:
    """Run generators that ask for trials side by side, so that every process has work."""
    done: list[Fitted | None] = [None] * len(fits)
    asked: dict[int, list[Trial]] = {}
    for number, fit in enumerate(fits):
        asked[number] = next(fit)
    while asked:
        answers = iter(runs.run([trial for trials in asked.values() for trial in trials], TRAIN))
        following: dict[int, list[Trial]] = {}
        for number, trials in asked.items():
            try:
                following[number] = fits[number].send([next(answers) for _ in trials])
            except StopIteration as end:
                done[number] = end.value
        asked = following
    return done


def _fit(
    tuning: Tuning, measured: np.ndarray, names: tuple[EffectAt, ...], values: tuple[np.ndarray, ...], steps: int, damping: float
) -> Generator[list[Trial], Answers, Fitted | None]:
    """Levenberg-Marquardt as a generator of trials."""
    parameters = [effects()[name.effect].parameters for name in names]
    free = tuple((e, k) for e, own in enumerate(parameters) for k, p in enumerate(own) if p.name not in NOT_FITTED)
    values = tuple(np.array(v, dtype=float) for v in values)
    offset = tuning.offset.copy()

    def trial(at: np.ndarray, of: Sequence[np.ndarray]) -> Trial:
        return Trial(tuning.at(at), tuple(setting_of(name, v) for name, v in zip(names, of, strict=True)))

    (predicted,) = yield [trial(offset, values)]
    if predicted is None:
        return None
    cost = _cost(measured, predicted, offset)
    tuned = tuning.jacobian.T @ tuning.jacobian
    jacobian = np.zeros((len(predicted), len(free)))
    for _ in range(steps):
        sizes = np.array([_size(parameters[e][k], values[e][k]) for e, k in free])
        moves = [_moved(parameters[e][k], values[e][k], size * STEP_SHARE) for (e, k), size in zip(free, sizes, strict=True)]
        answers = yield [trial(offset, _with(values, e, k, value)) for (e, k), value in zip(free, moves, strict=True)]
        for column, ((e, k), value, answer) in enumerate(zip(free, moves, answers, strict=True)):
            jacobian[:, column] = 0.0 if answer is None else (answer - predicted) / (value - values[e][k])
        residual = measured - predicted
        accepted = False
        low, high = _bounds(parameters, values, free, sizes)
        hessian, gradient = _normal_equations(tuned, tuning.jacobian, jacobian * sizes, residual, offset)
        for _ in range(2):
            ladder = [damping, 10.0 * damping, 100.0 * damping]
            tries = []
            for level in ladder:
                step = _bounded_step(hessian, gradient, level, offset, low, high)
                at = offset + step[: len(offset)]
                of = values
                for (e, k), change in zip(free, step[len(offset) :] * sizes, strict=True):
                    of = _with(of, e, k, float(np.clip(of[e][k] + change, parameters[e][k].low, parameters[e][k].high)))
                tries.append((at, of))
            answers = yield [trial(at, of) for at, of in tries]
            costs = [np.inf if answer is None else _cost(measured, answer, at) for answer, (at, _) in zip(answers, tries, strict=True)]
            best = int(np.argmin(costs))
            if costs[best] < cost:
                accepted = True
                break
            damping *= 1000.0
        if not accepted:
            break
        gain, cost = cost - costs[best], costs[best]
        offset, values = tries[best]
        predicted = answers[best]
        assert predicted is not None
        damping = max(ladder[best] * 0.1, 1e-8)
        if gain < max(ENOUGH * cost * len(offset) / len(measured), 0.5):
            break
    return Fitted(names, values, offset, predicted, cost, free, jacobian)


def _normal_equations(
    tuned: np.ndarray, jacobian: np.ndarray, added: np.ndarray, residual: np.ndarray, offset: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Of |residual - [J, J_added] step|^2 + |offset + step_tuned|^2; `tuned` is J'J."""
    across = jacobian.T @ added
    hessian = np.block([[tuned + np.eye(len(tuned)), across], [across.T, added.T @ added]])
    return hessian, np.concatenate([jacobian.T @ residual - offset, added.T @ residual])


def _bounded_step(
    hessian: np.ndarray, gradient: np.ndarray, damping: float, offset: np.ndarray, low: np.ndarray, high: np.ndarray
) -> np.ndarray:
    damped = hessian + np.diag(damping * np.diag(hessian) + 1e-9)
    root = np.linalg.cholesky(damped).T
    target = np.linalg.solve(root.T, gradient)
    bound = LARGEST_CHANGE / PRIOR
    lower = np.concatenate([np.minimum(-bound - offset, -1e-9), np.minimum(low, -1e-12)])
    upper = np.concatenate([np.maximum(bound - offset, 1e-9), np.maximum(high, 1e-12)])
    return scipy.optimize.lsq_linear(root, target, bounds=(lower, upper), method="bvls").x


def _bounds(
    parameters: Sequence[tuple[Parameter, ...]], values: Sequence[np.ndarray], free: Sequence[tuple[int, int]], sizes: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """How far each free parameter may go in one step, in units of its size: to its bounds, and not further than it is trusted."""
    low, high = [], []
    for (e, k), size in zip(free, sizes, strict=True):
        parameter, value = parameters[e][k], values[e][k]
        reach = 1.0 if parameter.unit == "phase" else 3.0
        down = 0.6 if parameter.name in LOGARITHMIC else reach
        low.append(max((parameter.low - value) / size, -down))
        high.append(min((parameter.high - value) / size, reach))
    return np.array(low), np.array(high)


def _size(parameter: Parameter, value: float) -> float:
    """What is a large change of a parameter."""
    if parameter.unit == "phase" and not parameter.is_strength:
        return 1.0
    span = parameter.high - parameter.low
    return max(abs(value), SMALLEST_SHARE * span, 1e-12)


def _moved(parameter: Parameter, value: float, step: float) -> float:
    """A neighbouring value within the bounds."""
    if parameter.unit == "phase" and not parameter.is_strength:
        step = PHASE_STEP
    return value + step if value + step <= parameter.high else value - step


def _with(values: Sequence[np.ndarray], effect: int, number: int, value: float) -> tuple[np.ndarray, ...]:
    changed = [np.array(v) for v in values]
    changed[effect][number] = value
    return tuple(changed)


def _cost(measured: np.ndarray, predicted: np.ndarray, offset: np.ndarray) -> float:
    return float(np.sum((measured - predicted) ** 2) + np.sum(offset**2))
