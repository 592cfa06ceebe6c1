"""By what the equations of effects that were found may err: other functions of what they depend on, where they act.

A friction law errs as another function of speed, a spring as one of its deflection, a clock as one of its channel's rate of change. A few
such functions (`error_functions.py`), sent through the linear closed loop (`through_the_loop.py`) or added to readings, span what errors do
to recordings. In units of their standard deviations beforehand the residual has the covariance 1 + B'B for responses B, and further effects
are judged by that: what lies outside of B counts in full, what lies within only beyond what the law that was found may err by (a Gaussian
process as model discrepancy, Kennedy and O'Hagan 2001, J. R. Stat. Soc. B 63, in few functions).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
import scipy.linalg

from hil.diagnosis.fitting.refit import Fitted
from hil.diagnosis.judging.error_functions import Function, can_err, error_functions
from hil.diagnosis.judging.errors_of_laws import ERRS_AS_A_LAW, WEIGHTS, is_a_whole_sign
from hil.diagnosis.result import EffectAt
from hil.diagnosis.starting.through_the_loop import ThroughTheLoop
from hil.diagnosis.tuning.free_run import FreeRuns, Trial
from hil.diagnosis.tuning.retune import Tuning
from virtual_bus.effects.effect import SIGN
from virtual_bus.effects.registry import effects

RIDGE = 1e-6
"""Share of its energy by which a function's response must differ from the others' to be told from them."""

SPANNED = 0.2
"""Of an effect's own response, that its functions span at least: else they are not what it depends on."""


@dataclass(frozen=True, eq=False)
class FormError:
    """What errors of equations add to the covariance of a residual whose noise is white.

    Attributes
    ----------
    responses : (K, M) array
        Of error functions with standard deviation one each. K may be 0.
    effects : tuple of EffectAt
        Whose errors these are.
    """

    responses: np.ndarray
    effects: tuple[EffectAt, ...] = ()

    @cached_property
    def _factor(self) -> tuple[np.ndarray, bool]:
        return scipy.linalg.cho_factor(np.eye(len(self.responses)) + self.responses @ self.responses.T)

    def beside(self, other: FormError) -> FormError:
        """Both, independent of each other."""
        if not len(self.responses) or not len(other.responses):
            return FormError(self.responses if len(self.responses) else other.responses, self.effects + other.effects)
        return FormError(np.concatenate([self.responses, other.responses]), self.effects + other.effects)

    def taken_by(self, residual: np.ndarray) -> float:
        """Energy of a residual (M,) that errors explain, in units of noise: r' r - r' (1 + B'B)^-1 r."""
        if not len(self.responses):
            return 0.0
        along = self.responses @ residual
        return float(along @ scipy.linalg.cho_solve(self._factor, along))

    def gain(self, residual: np.ndarray, response: np.ndarray) -> float:
        """Fall of r' (1 + B'B)^-1 r by the best positive multiple of a response (M,): a matched filter in noise that is not white."""
        energy, wanted = float(response @ response), float(response @ residual)
        if len(self.responses):
            own = self.responses @ response
            solved = scipy.linalg.cho_solve(self._factor, own)
            energy, wanted = energy - float(own @ solved), wanted - float(solved @ (self.responses @ residual))
        return max(wanted, 0.0) ** 2 / energy if energy > 0.0 else 0.0


NO_ERROR = FormError(np.zeros((0, 1)))


def form_error(runs: FreeRuns, name: str, tuning: Tuning, fitted: Fitted) -> FormError:
    """Of fitted effects in the groups of one set.

    Beforehand every function is as large as every other, and all together have the mean square that is WEIGHTS.form_error of the effect's
    own effort's, of a number that stands for a law ERRS_AS_A_LAW of that. That is what of the functions makes up the effect's own response.

    Parameters
    ----------
    runs : FreeRuns
    name : str
        Of the set.
    tuning : Tuning
        Beside the effects.
    fitted : Fitted
        Effects that it is not known of how they err are left out. A whole sign is right or wrong: it errs by nothing.
    """
    rows, known = [], []
    loop, whole = ThroughTheLoop(runs, name, tuning), None
    for number, (effect, values) in enumerate(zip(fitted.effects, fitted.values, strict=True)):
        if effects()[effect.effect].kind is SIGN and is_a_whole_sign(values):
            known.append(effect)
            continue
        if not can_err(effect):
            continue
        whole = runs.run_one(Trial(tuning.values, fitted.settings), name) if whole is None else whole
        without = runs.run_one(Trial(tuning.values, (*fitted.settings[:number], *fitted.settings[number + 1 :])), name)
        if whole is None or without is None:
            continue
        functions = error_functions(runs, name, tuning, fitted, number)
        if not functions or not functions[0]:
            continue
        responses = _responses(loop, functions)
        sizes = [[_sizes(function, runs.noise.std) for function in group] for group in functions]
        seen = np.flatnonzero(np.sum(responses**2, axis=1) > 0.0)
        sizes, responses = [[group[k] for k in seen] for group in sizes], responses[seen]
        own = _mean_square(sizes, responses, whole - without)
        if own > 0.0:
            share = WEIGHTS.form_error * ERRS_AS_A_LAW.get(effect.effect, 1.0)
            each = sum(float(np.sum(values**2)) for group in sizes for function in group for _, values in function)
            rows.append(responses * np.sqrt(share * own / each))
            known.append(effect)
    if not known:
        return NO_ERROR
    return FormError(np.concatenate(rows) if rows else NO_ERROR.responses, tuple(known))


def _responses(loop: ThroughTheLoop, functions: Sequence[Sequence[Function]]) -> np.ndarray:
    """(K, M) whitened."""
    efforts = [[effort for function in group for effort in function.efforts] for group in functions]
    counts = [len(function.efforts) for function in functions[0]]
    through = loop.responses(efforts) if sum(counts) else np.zeros((0, 1))
    ends = np.cumsum([0, *counts])
    found: list[np.ndarray] = [through[a:b].sum(axis=0) if b > a else np.zeros(1) for a, b in pairwise(ends)]
    for k, each in enumerate(zip(*functions, strict=True)):
        if each[0].readings:
            found[k] = found[k] + loop.runs.joined([_read(loop, function) for function in each], loop.name)
    return np.stack(found)


def _read(loop: ThroughTheLoop, function: Function) -> np.ndarray:
    """(N, C) that is added to the readings."""
    rows = np.zeros((len(function.readings[0][1]), len(loop.runs.sets[loop.name].channels)))
    for channel, values in function.readings:
        rows[:, channel] += values
    return rows


Sizes = tuple[tuple[int, np.ndarray], ...]
"""Joints' numbers and efforts (N,), or channels' and readings in units of their noise: what of a function counts as its size."""


def _sizes(function: Function, noise: np.ndarray) -> Sizes:
    """A drive's effort and its current are one and the same: efforts where there are any."""
    return function.efforts or tuple((channel, values / noise[channel]) for channel, values in function.readings)


def _mean_square(sizes: Sequence[Sequence[Sizes]], responses: np.ndarray, own: np.ndarray) -> float:
    """Of what has an effect's own response (M,), as far as these functions' responses (K, M) span it, summed over the rows."""
    energy = float(own @ own)
    if energy == 0.0 or not len(responses):
        return 0.0
    gram = responses @ responses.T
    gram[np.diag_indices_from(gram)] *= 1.0 + RIDGE
    weights = np.linalg.solve(gram, responses @ own)
    spanned = float(weights @ (responses @ own)) / energy
    if spanned < SPANNED:
        return 0.0
    places = {place for function in sizes[0] for place, _ in function}
    total = sum(float(np.sum(_mixed(group, weights, place) ** 2)) for group in sizes for place in places)
    return total / spanned


def _mixed(sizes: Sequence[Sizes], weights: np.ndarray, place: int) -> np.ndarray:
    """(N,) at a joint or in a channel."""
    each = zip(weights, sizes, strict=True)
    return np.sum([weight * values for weight, function in each for at, values in function if at == place], axis=0)
