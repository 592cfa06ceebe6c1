"""By what the equations of effects that were found may err: other functions of what they depend on, where they act.

A friction law errs as another function of speed, and of the way since the last reversal, at its joint; a spring as another function of its
deflection; a wave over position or in time as its other harmonics, and as one that changes slowly along the way or in time; an inertia
between two axes as other functions of their positions. A few such functions, added to the joints' equations and sent through the linear
closed loop (`through_the_loop.py`), span what errors do to recordings. In units of their standard deviations beforehand the residual has
the covariance 1 + B'B for responses B, and further effects are judged by that: what lies outside of B counts in full, what lies within
only beyond what the law that was found may err by (a Gaussian process as model discrepancy, Kennedy and O'Hagan 2001, J. R. Stat. Soc. B
63, in few functions).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
import scipy.linalg

from hil.diagnosis.free_run import FreeRuns, Trial
from hil.diagnosis.motion import Motion
from hil.diagnosis.naming import NUMBERS, WEIGHTS, is_a_whole_sign
from hil.diagnosis.refit import Fitted
from hil.diagnosis.result import EffectAt
from hil.diagnosis.retune import Tuning
from hil.diagnosis.start_waves import TURNING_WITH_THE_MOTOR
from hil.diagnosis.through_the_loop import ThroughTheLoop, from_rest
from virtual_bus.effects.effect import COUPLING, ELASTIC, FRICTION, SIGN, TRANSMISSION
from virtual_bus.effects.places import joint_at, next_axis, spring_at
from virtual_bus.effects.registry import effects
from virtual_bus.effects.residual import Residual, joined
from virtual_bus.settings import PlantSettings

ALSO_FRICTIONS = ("bouc_wen_hysteresis", "presliding_hysteresis", "temperature_dependent_friction", "viscous_friction")
"""Against the motion, but not of the catalogue's kind friction: they build up after a reversal, warm, or are the machine file's."""

OVER_POSITION = ("cable_spring", "end_stop", "gravity_imbalance")

OVER_TIME = ("base_motion",)
"""At a frequency of their own, whatever the machine does."""

SPEEDS = (0.0, 0.05, 0.2, 0.5, 1.0)
"""Where functions of speed have their knots, in units of the largest: frictions change most where it is low."""

AFTER_REVERSAL = (0.003, 0.03, 0.3)
"""Ways within which a friction settles after a reversal, in units of the whole."""

STANDS = 0.005
"""Of the largest speed, below which friction's direction fades."""

KNOTS, SLOW_KNOTS = 9, 4
"""Of functions of position or deflection, and of what changes slowly along the way or in time."""

HARMONICS = (1, 2, 3, 4, 5)

TURNS_OF_INERTIA = (1, 2, 3)
"""Of an inertia per turn of an axis, beside a constant one: that of rigid bodies has no more than two."""

NUMBER_ERRS = 1e-4
"""Share of its effort's mean square by which a number of the machine file may err as another law of what it depends on, 1 % of its size:
beside a viscous friction, another friction of that size says nothing."""

RIDGE = 1e-6
"""Share of its energy by which a function's response must differ from the others' to be told from them."""

SPANNED = 0.2
"""Of an effect's own response, that its functions span at least: else they are not what it depends on."""


Function = tuple[tuple[int, np.ndarray], ...]
"""By what an equation may err: joints' numbers and the efforts (N,) on them, all of one size."""


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
    own effort's. That is what of the functions makes up the effect's own response.

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
    whole = runs.run_one(Trial(tuning.values, fitted.settings), name)
    for number, (effect, values) in enumerate(zip(fitted.effects, fitted.values, strict=True)):
        if effects()[effect.effect].kind is SIGN and is_a_whole_sign(values):
            known.append(effect)
            continue
        if not can_err(effect) or not _acts_where_it_is_seen(effect, runs.machine.plant):
            continue
        without = runs.run_one(Trial(tuning.values, (*fitted.settings[:number], *fitted.settings[number + 1 :])), name)
        if whole is None or without is None:
            continue
        efforts = _joint_efforts(runs, name, tuning, fitted, number)
        responses = _responses(ThroughTheLoop.of(runs, name, tuning), efforts)
        seen = np.flatnonzero(np.sum(responses**2, axis=1) > 0.0)
        efforts, responses = [[group[k] for k in seen] for group in efforts], responses[seen]
        own = _squared_effort(efforts, responses, whole - without)
        if own > 0.0:
            share = NUMBER_ERRS if effect.effect in NUMBERS else WEIGHTS.form_error
            each = sum(float(np.sum(effort**2)) for group in efforts for function in group for _, effort in function)
            rows.append(responses * np.sqrt(share * own / each))
            known.append(effect)
    if not known:
        return NO_ERROR
    return FormError(np.concatenate(rows) if rows else NO_ERROR.responses, tuple(known))


def _responses(loop: ThroughTheLoop, efforts: Sequence[Sequence[Function]]) -> np.ndarray:
    """(K, M) whitened."""
    firsts = np.cumsum([0, *(len(function) for function in efforts[0])])[:-1]
    return np.add.reduceat(loop.responses([[own for function in group for own in function] for group in efforts]), firsts)


def _squared_effort(efforts: Sequence[Sequence[Function]], responses: np.ndarray, own: np.ndarray) -> float:
    """Of the effort whose response (M,) is an effect's own, as far as these functions' responses (K, M) span it, summed over the rows."""
    energy = float(own @ own)
    if energy == 0.0 or not len(responses):
        return 0.0
    gram = responses @ responses.T
    gram[np.diag_indices_from(gram)] *= 1.0 + RIDGE
    weights = np.linalg.solve(gram, responses @ own)
    spanned = float(weights @ (responses @ own)) / energy
    if spanned < SPANNED:
        return 0.0
    joints = {joint for function in efforts[0] for joint, _ in function}
    total = sum(float(np.sum(_mixed(group, weights, joint) ** 2)) for group in efforts for joint in joints)
    return total / spanned


def _mixed(functions: Sequence[Function], weights: np.ndarray, joint: int) -> np.ndarray:
    """(N,) effort on a joint."""
    each = zip(weights, functions, strict=True)
    return np.sum([weight * effort for weight, function in each for at, effort in function if at == joint], axis=0)


def can_err(effect: EffectAt) -> bool:
    """Whether it is known which functions an effect's equation may err by."""
    name = effect.effect
    if _is_friction(name) or effects()[name].kind in (ELASTIC, COUPLING):
        return True
    return name in (*TURNING_WITH_THE_MOTOR, *OVER_POSITION, *OVER_TIME)


def _acts_where_it_is_seen(effect: EffectAt, plant: PlantSettings) -> bool:
    """Whether its equation depends on the motion of an axis or of its spring, not on that of a body without a drive."""
    is_spring = effects()[effect.effect].kind in (ELASTIC, TRANSMISSION)
    return is_spring or joint_at(effect.at, plant) in {drive.joint for drive in plant.drives}


def _is_friction(name: str) -> bool:
    return effects()[name].kind is FRICTION or name in ALSO_FRICTIONS


def _joint_efforts(runs: FreeRuns, name: str, tuning: Tuning, fitted: Fitted, number: int) -> list[list[Function]]:
    """Per group, every error function of the effect of this number."""
    effect, values = fitted.effects[number], fitted.values[number]
    found, machine = runs.sets[name], runs.machine
    motions = [Motion(machine, tuning.values, group, found.channels) for group in found.groups]
    parts = [motion.residual(effect.at) for motion in motions]
    joints = [joint.name for joint in machine.plant.tree.joints]
    driven = joints.index(machine.plant.drives[motions[0].axis_of(effect.at)].joint)
    kind = effects()[effect.effect].kind
    if kind is COUPLING:
        return _inertias_between_axes(runs, name, Trial(tuning.values, fitted.settings), effect, motions)
    spring = spring_at(effect.at, machine.plant) if kind in (ELASTIC, TRANSMISSION) else None
    places = [driven] if spring is None else [joints.index(spring)]
    if kind is TRANSMISSION:
        places = [driven, *places]
    if kind is ELASTIC and spring is not None and (own := joints.index(spring)) not in motions[0].plant.joint_of_axis().values():
        parts = [replace(part, other_position=motion.deflection(own)) for part, motion in zip(parts, motions, strict=True)]
    functions = _functions(effect, values, joined(parts), np.concatenate([since_reversal(part) for part in parts]))
    ends = np.cumsum([0, *(len(part.time_s) for part in parts)])
    begins = from_rest if effect.effect in OVER_TIME else np.asarray
    return [[((joint, begins(function[a:b])),) for function in functions for joint in places] for a, b in pairwise(ends)]


def _inertias_between_axes(runs: FreeRuns, name: str, trial: Trial, effect: EffectAt, motions: Sequence[Motion]) -> list[list[Function]]:
    """Per group, inertias that turn with the position of either axis.

    Accelerations are the simulation's: a recording's are smoothed, and axes are coupled most where they shake each other.
    """
    settings, simulated = runs.machine.plant, runs.rows(trial, name)
    joints = [joint.name for joint in settings.tree.joints]
    axes = effect.at, next_axis(effect.at, settings)
    pair = [joints.index(joint_at(axis, settings)) for axis in axes]
    found: list[list[Function]] = []
    for motion, rows in zip(motions, simulated or (None,) * len(motions), strict=True):
        part = motion.residual(effect.at, coupled=True)
        own, other = (_acceleration(motion, rows, axis) for axis in axes)
        part = replace(part, acceleration=own, other_acceleration=other)
        found.append([((pair[0], first), (pair[1], second)) for first, second in _between_axes(effect.effect, part)])
    return found


def _acceleration(motion: Motion, simulated: np.ndarray | None, axis: str) -> np.ndarray:
    """(N,) of an axis in the simulation; the recording's where no encoder is simulated."""
    names = [name for name in (f"position_{axis}", f"link_position_{axis}") if name in motion.channels]
    if simulated is None or not names:
        return motion.acceleration[:, motion.machine.axis_index(axis)]
    rate_Hz = motion.machine.sample_rate_Hz
    return np.gradient(np.gradient(simulated[:, motion.channels.index(names[0])])) * rate_Hz**2


def _between_axes(name: str, motion: Residual) -> list[tuple[np.ndarray, np.ndarray]]:
    """Efforts on both axes of inertias J that turn with one of their positions q1 and q2: of the first axis, with the kinetic energy
    J q1'^2 / 2, or between both, with J q1' q2'.
    """
    waves = [(turns, phase) for turns in TURNS_OF_INERTIA for phase in (0.0, 0.5 * np.pi)]
    constant_or_by_second = [(motion.other_position, motion.other_speed, *wave) for wave in ((0, 0.0), *waves)]
    by_first = [(motion.position, motion.speed, *wave) for wave in waves]
    found = []
    for position, speed, turns, phase in (*constant_or_by_second, *by_first):
        inertia, slope = np.cos(turns * position - phase), -turns * np.sin(turns * position - phase)
        first_slope, second_slope = (slope, 0.0) if position is motion.position else (0.0, slope)
        if name == "pose_dependent_dynamics":
            first = -inertia * motion.acceleration - slope * speed * motion.speed + 0.5 * first_slope * motion.speed**2
            second = 0.5 * second_slope * motion.speed**2
        else:
            first = -inertia * motion.other_acceleration - second_slope * motion.other_speed**2
            second = -inertia * motion.acceleration - first_slope * motion.speed**2
        found.append((first, second))
    return found


def _functions(effect: EffectAt, values: np.ndarray, motion: Residual, since_reversal: np.ndarray) -> list[np.ndarray]:
    """(N,) each."""
    name = effect.effect
    if _is_friction(name):
        return _of_a_friction(name, motion, since_reversal)
    if name in TURNING_WITH_THE_MOTOR:
        phase = values[0] * motion.ratio * motion.position
        slow = _hats(motion.position, SLOW_KNOTS)
        waves = [wave(order * phase) for order in HARMONICS for wave in (np.cos, np.sin)]
        functions = [*waves, *(wave * hat for wave in waves[:2] for hat in slow), *slow]
        return [motion.drive_effort * function for function in functions] if name == "torque_ripple" else functions
    if name in OVER_TIME:
        phase = 2.0 * np.pi * values[1] * motion.time_s
        waves = [wave(order * phase) for order in HARMONICS for wave in (np.cos, np.sin)]
        return [*waves, *(wave * hat for wave in waves[:2] for hat in _hats(motion.time_s, SLOW_KNOTS))]
    return _hats(motion.other_position if effects()[name].kind is ELASTIC else motion.position, KNOTS)


def _of_a_friction(name: str, motion: Residual, since_reversal: np.ndarray) -> list[np.ndarray]:
    top = max(float(np.abs(motion.speed).max()), 1e-12)
    travel = max(float(np.ptp(motion.position)), 1e-12)
    against = motion.speed / np.hypot(motion.speed, STANDS * top)
    over_speed = _hats(np.abs(motion.speed) / top, len(SPEEDS), np.array(SPEEDS))
    functions = [np.where(way * motion.speed > 0.0, against * hat, 0.0) for way in (1.0, -1.0) for hat in over_speed]
    functions += [against * np.exp(-since_reversal / (share * travel)) for share in AFTER_REVERSAL]
    if name == "position_dependent_friction":
        functions += [against * hat for hat in _hats(motion.position, KNOTS)]
    if name == "load_dependent_friction":
        functions += [against * hat for hat in _hats(np.abs(motion.drive_effort), SLOW_KNOTS)]
    if name == "temperature_dependent_friction":
        functions += [shape * hat for shape in (against, motion.speed / top) for hat in _hats(motion.time_s, SLOW_KNOTS)]
    return functions


def _hats(x: np.ndarray, count: int, knots: np.ndarray | None = None) -> list[np.ndarray]:
    """Piecewise linear functions of x, each one at its own knot and zero at the others."""
    places = np.linspace(float(x.min()), float(x.max()) + 1e-12, count) if knots is None else knots
    return [np.interp(x, places, row) for row in np.eye(count)]


def since_reversal(motion: Residual) -> np.ndarray:
    """(N,) way since the last change of direction, however long it stands at one."""
    moving = np.flatnonzero(motion.speed)
    if not len(moving):
        return np.zeros(len(motion.speed))
    before = np.maximum(np.searchsorted(moving, np.arange(len(motion.speed)), side="right") - 1, 0)
    way = np.sign(motion.speed)[moving[before]]
    turns = np.flatnonzero(np.concatenate([[True], way[1:] * way[:-1] < 0.0]))
    start = np.repeat(motion.position[turns], np.diff([*turns, len(way)]))
    return np.abs(motion.position - start)
