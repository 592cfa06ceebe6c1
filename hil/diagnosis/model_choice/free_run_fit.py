"""A set of effects fitted to free runs, with the machine's numbers, and the library of laws beside a fit."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hil.diagnosis.candidates.columns import Column
from hil.diagnosis.candidates.entries import Entry, free_parameters, moved
from hil.diagnosis.free_runs.runs import FreeRuns, Trial
from hil.diagnosis.model_choice.convergence import LONGEST
from hil.diagnosis.model_choice.fitting import CONVERGED, HALVINGS, ITERATIONS, STEP, Fitted, difference, fit, reach
from hil.diagnosis.model_choice.form_error import FormError
from hil.diagnosis.model_choice.plausibility import are_driven, on_bound, pressed_against
from hil.diagnosis.retuning.bounded import bounded_least_squares
from hil.diagnosis.retuning.common_scale import common_scale
from hil.diagnosis.retuning.linear_model import STEP as NEARBY
from hil.diagnosis.retuning.linear_model import LinearModel
from virtual_bus.effects.effect import Parameter
from virtual_bus.settings import EffectSetting

SHARES = tuple(0.5**k for k in range(HALVINGS))
"""Of a step, that are tried together."""
FINE = 0.1
"""Of the step of a difference along the motion: a simulation has no rows that a corner of a law could pass between."""
HOPED, BEYOND = 2, 3.0
"""Steps after which a fit is hopeless that needs more than so many times what the next one promises."""
LITTLE = 1e-4
"""Of what is left: less is gained for nothing by one fit of many."""
WORTH = 0.5
"""Share of what columns promise, below which they are computed anew."""


def fit_to(
    view: LinearModel | FreeRuns, settings: Sequence[EffectSetting], offset: np.ndarray | None = None, dispersion: float = 1.0,
    near: Fitted | None = None, enough: float | None = None,
) -> Fitted | None:  # fmt: skip
    """Fit a set of effects along the recorded motion or to free runs; None where the machine cannot take them together.

    A fit to free runs that is one of many ends where it will surely leave more squares than `enough`, or gains little of what is left.
    """
    if isinstance(view, LinearModel):
        return fit(view, settings, offset, dispersion)
    return fit_free_runs(view, settings, offset, dispersion, near, enough)


def fit_free_runs(
    free: FreeRuns, settings: Sequence[EffectSetting], offset: np.ndarray | None, dispersion: float, near: Fitted | None = None,
    enough: float | None = None,
) -> Fitted | None:  # fmt: skip
    """Fit a set of effects from these parameters, as `fit` does along a motion; None where the machine cannot run with them.

    What misfits lose per unit of each number is that of a set `near` it, or of an earlier step, as long as it keeps what it promises.
    """
    settings = tuple(settings)
    offset = free.offset.copy() if offset is None else offset
    (left,) = free.left([(offset, settings)])
    if left is None:
        return None
    parameters: tuple[tuple[int, Parameter], ...] = ()
    columns: tuple[np.ndarray, ...] = ()
    numbers = None if near is None else near.columns
    fastest = 0.5 / max(run.simulator.machine.plant.sample_period_s for run in free.runs)
    for turn in range(2 * ITERATIONS):
        parameters = free_parameters(settings)
        steps = [FINE * difference(settings, *one) for one in parameters]
        is_new = not numbers
        columns = _columns(free, offset, settings, parameters, steps, left, numbers)
        reaches = [reach(one, settings[k].parameters[one.name], by / FINE, fastest) for (k, one), by in zip(parameters, steps, strict=True)]
        room = _room(free, offset, reaches)
        unit = max(dispersion, sum(float(rest @ rest) for rest in left) / free.readings)  # while far off, errors count as noise
        step = _solved(columns, left, unit, offset, room)
        cost = _cost(left, offset, unit)
        rest = [each - own @ step for own, each in zip(columns, left, strict=True)]
        squares, foretold = (float(sum(each @ each for each in parts)) for parts in (left, rest))
        if enough is not None and turn >= HOPED and squares - BEYOND * (squares - foretold) > enough:
            break
        little = CONVERGED if enough is None else max(CONVERGED, LITTLE * cost)
        promised = cost - _cost(rest, offset + step[: len(offset)], unit)
        gained = 0.0
        if promised >= little:
            trials = [_moved(offset, settings, parameters, share * step) for share in SHARES]
            further = free.left(trials)
            costs = [np.inf if each is None else _cost(each, trial[0], unit) for trial, each in zip(trials, further, strict=True)]
            best = int(np.argmin(costs))
            gained = cost - costs[best]
            if gained > 0.0:
                (offset, settings), there = trials[best], further[best]
                assert there is not None
                left = there
        if is_new and gained < little:
            break
        numbers = columns if gained > max(little, WORTH * promised) else None
    else:
        columns = _columns(free, offset, settings, parameters, [FINE * difference(settings, *one) for one in parameters], left, None)
    pressed = pressed_against(free, offset, columns, left, dispersion)
    none = FormError([np.zeros((len(rest), 0)) for rest in left], dispersion)
    squares = float(sum(rest @ rest for rest in left))
    sensible = are_driven(free.linear, settings) and not on_bound(settings, parameters, columns, left, dispersion)
    return Fitted(settings, offset, squares, left, columns, tuple(parameters), True, none, 0.0, free.readings, pressed, sensible)


def _columns(
    free: FreeRuns, offset: np.ndarray, settings: tuple[EffectSetting, ...], parameters: Sequence[tuple[int, Parameter]],
    steps: Sequence[float], left: tuple[np.ndarray, ...], numbers: Sequence[np.ndarray] | None,
) -> tuple[np.ndarray, ...]:  # fmt: skip
    """Return what (N C, P + Q) misfits lose per unit of nuisances and parameters; of nuisances as in `numbers` where that is given.

    Numbers are moved by little: those that stand in for each other almost cancel, and what is left must be no error of their columns.
    """
    by = np.append(np.full(len(offset), NEARBY), steps)
    columns = [np.zeros((len(by), len(rest))).T for rest in left]  # one column after the other in memory
    sought = [*(np.flatnonzero(free.are_shown).tolist() if not numbers else ()), *range(len(offset), len(by))]
    if numbers:
        for own, known in zip(columns, numbers, strict=True):
            own[:, : len(offset)] = known[:, : len(offset)]
    trials = [_moved(offset, settings, parameters, np.where(np.arange(len(by)) == k, by[k], 0.0)) for k in sought]
    for k, there in zip(sought, runs := free.left(trials), strict=True):
        if there is not None:
            for own, before, after in zip(columns, left, there, strict=True):
                own[:, k] = (before - after) / by[k]
    besides, energies = [setting for run in free.runs for setting in run.known], np.sum([np.sum(own**2, axis=0) for own in columns], axis=0)
    if None not in runs and (scale := common_scale(free.numbers, offset, settings, parameters, besides, energies)) is not None:
        for own in columns:
            scale.set_constant(own)
    return tuple(columns)


def _room(free: FreeRuns, offset: np.ndarray, reaches: Sequence[tuple[float, float]]) -> tuple[np.ndarray, np.ndarray]:
    """Return how far down and up a step of nuisances and parameters (P + Q,) may go."""
    low, high = (bound + free.offset - offset for bound in free.bounds)
    below, above = np.array(reaches).reshape(-1, 2).T
    return np.append(np.maximum(low, -LONGEST), below), np.append(np.minimum(high, LONGEST), above)


def _solved(
    columns: Sequence[np.ndarray], left: Sequence[np.ndarray], dispersion: float, offset: np.ndarray, room: tuple[np.ndarray, np.ndarray]
) -> np.ndarray:
    """Return the step (P + Q,) to the least squares; `offset` are the nuisances, which the prior pulls to zero."""
    count = len(offset)
    squares = np.sum([each.T @ each for each in columns], axis=0) / dispersion
    slopes = np.sum([each.T @ rest for each, rest in zip(columns, left, strict=True)], axis=0) / dispersion
    squares[range(count), range(count)] += 1.0
    slopes[:count] -= offset
    return bounded_least_squares(squares, slopes, *room)


def _moved(offset: np.ndarray, settings: tuple[EffectSetting, ...], parameters: Sequence[tuple[int, Parameter]], step: np.ndarray) -> Trial:
    return offset + step[: len(offset)], moved(settings, parameters, step[len(offset) :])


def _cost(left: Sequence[np.ndarray], offset: np.ndarray, dispersion: float) -> float:
    return float(sum(rest @ rest for rest in left)) / dispersion + float(offset @ offset)


def alone_in_free_runs(free: FreeRuns, fitted: Fitted, number: int) -> list[np.ndarray] | None:
    """Return what (N C,) one effect of a fitted set takes of every run's misfit beside the others; None where none runs without it."""
    (without,) = free.left([(fitted.offset, (*fitted.settings[:number], *fitted.settings[number + 1 :]))])
    return None if without is None else [far - near for far, near in zip(without, fitted.innovations, strict=True)]


def tried(free: FreeRuns, fitted: Fitted, laws: Sequence[tuple[Entry, Sequence[Sequence[Column]]]]) -> list[np.ndarray]:
    """Return what one unit of each weight of laws, one after the other, changes of every run beside a fitted set (N C, L).

    Parameters
    ----------
    laws : sequence of (Entry, columns)
        With what they change along the recorded motion, by which they are tried small: equations are linear nearby only.
    """
    sizes = [_small(free, columns) for _, columns in laws]
    trials: list[Trial] = [(fitted.offset, fitted.settings)]
    for (law, _), own in zip(laws, sizes, strict=True):
        trials += [(fitted.offset, (*fitted.settings, law.setting(weights))) for weights in np.diag(own)]
    (here,) = free.left(trials[:1])
    assert here is not None
    every = np.concatenate([np.zeros(0), *sizes])
    found = [np.zeros((len(rest), len(every)), dtype=np.float32) for rest in here]
    for first in range(1, len(trials), free.together):
        for number, there in enumerate(free.left(trials[first : first + free.together]), first - 1):
            if there is not None:
                for columns, before, after in zip(found, here, there, strict=True):
                    columns[:, number] = (before - after) / every[number]
    return found


def _small(free: FreeRuns, columns: Sequence[Sequence[Column]]) -> np.ndarray:
    """Return the weights (w,) at which a law changes STEP of an effort, or of a reading, at most."""
    most = np.zeros(len(columns[0]))
    for one, own in zip(free.linear.records, columns, strict=True):
        efforts = np.sqrt(np.mean(one.signals.needed**2, axis=0)) + 1e-12
        values = np.hstack([one.equations.trajectory.observed.readings, one.equations.trajectory.observed.currents])
        readings = [float(np.nanstd(each)) + 1e-12 if np.isfinite(each).any() else np.inf for each in values.T]
        for k, column in enumerate(own):
            shares = [float(np.sqrt(np.mean(np.square(at, dtype=float)))) / efforts[joint] for joint, (at, _) in column.efforts.items()]
            shares += [float(np.sqrt(np.mean(np.square(change, dtype=float)))) / readings[c] for c, change in column.readings.items()]
            most[k] = max([most[k], *shares])
    return np.asarray(STEP / np.maximum(most, 1e-12))
