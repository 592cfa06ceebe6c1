"""Numbers of a machine file that are wrong by far: freed from their tolerances, they may explain what no effect does."""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import replace

import numpy as np

from hil.diagnosis.model_choice.alternatives import is_spanned
from hil.diagnosis.model_choice.choose import Choice, choose_effects
from hil.diagnosis.model_choice.convergence import converged
from hil.diagnosis.model_choice.fitting import Fitted
from hil.diagnosis.model_choice.search import NOT_TOLD_APART
from hil.diagnosis.residuals.equation_errors import Levels
from hil.diagnosis.residuals.repeat_noise import repeat_levels
from hil.diagnosis.residuals.residuals import Residuals
from hil.diagnosis.residuals.trajectory import Trajectory
from hil.diagnosis.retuning.linear_model import DETERMINED, LinearModel, inertia_ratio, nominal_offset
from hil.diagnosis.retuning.numbers import MOST_FREED, PRIOR, TOLERANCE, TUNED
from hil.machine import Machine
from virtual_bus.plant.parameters import PlantParameter


def with_numbers_far_off(choice: Choice) -> Choice | None:
    """Return what is named beside numbers that are wrong by far; None where none are, or that explains no more than what was named.

    It is only tried where the engineer's fit is pressed against a tolerance. What repeats differ by is read anew beside the machine with
    those numbers, since beside another one it looks like other noise. By that noise effects are named with the numbers free, and within
    their tolerances: an effect that explains as much is the answer. The evidence is that of `alternatives`, a number counts as a parameter.
    """
    if not choice.is_noise_known or not choice.baseline.is_pressed.any():
        return None
    far, linear, best = _far_off(choice)
    if not far or (levels := _levels(choice.residuals, linear)) is None:
        return None
    within, beyond = replace(choice.residuals, levels=levels), replace(freed(choice.residuals, far), levels=levels)
    _, own = converged(within.trajectories, levels, choice.best.offset, choice.best.settings)
    _, best = converged(beyond.trajectories, levels, best.offset, best.settings)
    unit, price = min(own.dispersion, best.dispersion), math.log(choice.linear.readings)
    least = own.cost(unit) + len(own.parameters) * price - NOT_TOLD_APART
    if is_spanned(choice) and best.cost(unit) + len(far) * price > least:
        return None
    found = choose_effects(within), choose_effects(beyond)
    unit = min(unit, *(one.best.dispersion for one in found))
    least = own.cost(unit) + len(own.parameters) * price - NOT_TOLD_APART
    for one, numbers in zip(found, (0, len(far)), strict=True):
        cost = one.best.cost(unit) + (len(one.best.parameters) + numbers) * price
        if is_spanned(one) and cost < least:
            choice, least = one, cost - NOT_TOLD_APART
    return choice if choice in found else None


def _levels(residuals: Residuals, linear: LinearModel) -> Levels | None:
    """Return what repeats of the tuned machine differ by, as strong as they would be on that of the file."""
    levels = repeat_levels(residuals.groups, residuals.trajectories, linear.values)
    one = linear.records[0].equations
    return None if levels is None else levels.accelerating(1.0 / inertia_ratio(one.trajectory, one.model, one.base.position[0]))


def _far_off(choice: Choice) -> tuple[list[str], LinearModel, Fitted]:
    """Return numbers that leave their tolerances where they may, by `PlantParameter.name`, with the machine and the engineer's fit there.

    Numbers that others make up for are left out, those that move least first.
    """
    far = [one.name for one in choice.residuals.trajectories[0].plant.parameters if may_be_far_off(one)]
    while True:
        before, (linear, best) = far, _fitted(choice, far)
        beyond = {one.name for one in beyond_tolerance(choice.residuals.machine, linear, best.offset)}
        far = [one for one in far if one in beyond]
        if len(far) in (0, len(before)):
            break
    shares = {one.name: abs(value / one.value - 1.0) for _, one, value in _each(linear, best.offset) if one.value}
    for one in sorted(far, key=lambda each: shares[each]):
        rest = [each for each in far if each != one]
        machine, sparer = _fitted(choice, rest)
        if sparer.cost(best.dispersion) - best.cost(best.dispersion) < NOT_TOLD_APART:
            far, linear, best = rest, machine, sparer
    return far, linear, best


def _fitted(choice: Choice, free: Collection[str]) -> tuple[LinearModel, Fitted]:
    """Return the engineer's fit with numbers free."""
    trajectories = freed(choice.residuals, free).trajectories
    return converged(trajectories, choice.levels, nominal_offset(trajectories), choice.baseline.settings)


def beyond_tolerance(machine: Machine, linear: LinearModel, offset: np.ndarray, unsure: np.ndarray | None = None) -> list[PlantParameter]:
    """Return which numbers are beyond their tolerance in the machine's file, by more than they are `unsure` [deviations of their prior]."""
    stated, found = dict(machine.plant.tolerances), []
    for k, parameter, value in _each(linear, offset):
        by = abs(value - parameter.value) - (0.0 if unsure is None else float(unsure[k] * linear.numbers.scale[k]))
        if by > stated.get(parameter.name, tolerance_of(parameter)):
            found.append(parameter)
    return found


def stand_ins(linear: LinearModel, fitted: Fitted, parameter: PlantParameter) -> list[PlantParameter]:
    """Return the numbers that the recordings do not tell apart from one: another value of theirs would leave nearly as little.

    All other nuisances and parameters follow but the drives' constants: the scale of all efforts never shows. Those whose value would fall
    below zero cannot stand in.
    """
    found, rows = [], _each(linear, fitted.offset)
    k = next(number for number, one, _ in rows if one is parameter)
    constants = [number for number, one, _ in rows if one.quantity == "constant"]
    squares, prior = sum(each.T @ each for each in fitted.with_form), fitted.prior
    for j, other, value in rows:
        if j == k or not may_be_far_off(other):
            continue
        pair = np.array([k, j])
        rest = np.setdiff1d(np.arange(len(squares)), [k, j, *constants])
        across = squares[np.ix_(pair, rest)]
        own = squares[np.ix_(pair, pair)] - across @ np.linalg.solve(squares[np.ix_(rest, rest)] + np.diag(prior[rest]), across.T)
        if own[1, 1] < DETERMINED:
            continue
        off = fitted.offset[k]
        left = off**2 * (own[0, 0] - own[0, 1] ** 2 / own[1, 1])
        if left < NOT_TOLD_APART and value + off * own[0, 1] / own[1, 1] * linear.numbers.scale[j] > 0.0:
            found.append(other)
    return found


def may_be_far_off(parameter: PlantParameter) -> bool:
    """Whether a number may be freed: what the file states, but a drive's constant, which is an effect of the catalogue."""
    return parameter.value != 0.0 and parameter.quantity.startswith(TUNED) and parameter.quantity != "constant"


def _each(linear: LinearModel, offset: np.ndarray) -> list[tuple[int, PlantParameter, float]]:
    """Return the place among nuisances, the number in the file, and its value here."""
    numbers = linear.numbers
    values = numbers.values(offset[: len(numbers.indices)])
    return [(k, numbers.plant.parameters[index], float(values[index])) for k, index in enumerate(numbers.indices)]


def tolerance_of(parameter: PlantParameter) -> float:
    """Return by how much a number of which the file states nothing may be wrong; a rotor that it leaves out may have any inertia."""
    return TOLERANCE * PRIOR * abs(parameter.value) if parameter.value else math.inf


def freed(residuals: Residuals, names: Collection[str]) -> Residuals:
    """Return recordings beside the machine in which numbers, by `PlantParameter.name`, have next to no tolerance."""
    machine = residuals.machine
    values = {parameter.name: abs(parameter.value) for parameter in residuals.trajectories[0].plant.parameters}
    tolerances = {**dict(machine.plant.tolerances), **{name: MOST_FREED * values[name] for name in names}}
    wide = replace(machine, plant=replace(machine.plant, tolerances=tuple(tolerances.items())))
    return replace(
        residuals, trajectories=tuple(Trajectory(replace(trajectory.observed, machine=wide)) for trajectory in residuals.trajectories)
    )
