"""Functions by which the equations of effects may err: of what they depend on, as efforts on joints and as changes of readings."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import scipy.signal

from hil.diagnosis.fitting.refit import Fitted
from hil.diagnosis.judging.errors_of_laws import EXACT, NUMBERS
from hil.diagnosis.result import EffectAt
from hil.diagnosis.starting.motion import Motion
from hil.diagnosis.starting.start_waves import TURNING_WITH_THE_MOTOR
from hil.diagnosis.starting.through_the_loop import from_rest, number_of_encoder
from hil.diagnosis.tuning.free_run import FreeRuns, Trial
from hil.diagnosis.tuning.retune import Tuning
from virtual_bus.effects.effect import CALIBRATION, CLOCK, COUPLING, DELAY, ELASTIC, ENCODER_ERROR, FRICTION, LAG, LIMIT, TRANSMISSION
from virtual_bus.effects.places import imu_channel_names, joint_at, next_axis, spring_at
from virtual_bus.effects.registry import effects
from virtual_bus.effects.residual import Residual, joined

ALSO_FRICTIONS = ("bouc_wen_hysteresis", "presliding_hysteresis", "temperature_dependent_friction", "viscous_friction")
"""Against the motion, but not of the catalogue's kind friction: they build up after a reversal, warm, or are the machine file's."""

OVER_POSITION = ("cable_spring", "constant_load", "end_stop", "gravity_imbalance")
"""A constant load may change slowly in time, too."""

OF_ACCELERATION = ("structural_mode",)
"""What hangs on a joint and is shaken by it."""

DETUNED, LIGHT = (0.7, 0.85, 1.0, 1.15, 1.3), 0.005
"""Shares of a mode's frequency at which others may swing, and the least damping ratio these have."""

AGO = (1, 2, 3, 5, 8)
"""Samples by which a drive may be late."""

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


@dataclass(frozen=True, eq=False)
class Function:
    """By what an equation may err in one group.

    Attributes
    ----------
    efforts : tuple of (int, (N,) array)
        Joints' numbers and the efforts on them, all of one size; or the numbers that stand for encoders, and what these read too much.
    readings : tuple of (int, (N,) array)
        Channels' numbers and what is added to what they read, whatever the machine does.
    """

    efforts: tuple[tuple[int, np.ndarray], ...] = ()
    readings: tuple[tuple[int, np.ndarray], ...] = ()


Efforts = list[np.ndarray]
"""(N,) each, over all groups one after the other."""


def can_err(effect: EffectAt) -> bool:
    """Whether it is known which functions an effect's equation may err by."""
    name, kind = effect.effect, effects()[effect.effect].kind
    if name in EXACT and name not in NUMBERS:  # of `NUMBERS` those err that stand for a law, see `ERRS_AS_A_LAW`
        return False
    if _is_friction(name) or kind in (ELASTIC, COUPLING, DELAY, LAG, LIMIT, CALIBRATION, CLOCK):
        return True
    return kind is ENCODER_ERROR or name in (*TURNING_WITH_THE_MOTOR, *OVER_POSITION, *OVER_TIME, *OF_ACCELERATION)


def error_functions(runs: FreeRuns, name: str, tuning: Tuning, fitted: Fitted, number: int) -> list[list[Function]]:
    """Every error function of one of the fitted effects, per group of a set; none where it is not known how it errs there.

    Parameters
    ----------
    runs : FreeRuns
    name : str
        Of the set.
    tuning : Tuning
        Beside the effects.
    fitted : Fitted
    number : int
        Of the effect.
    """
    effect = fitted.effects[number]
    kind, plant = effects()[effect.effect].kind, runs.machine.plant
    trial = Trial(tuning.values, fitted.settings)
    if kind in (CALIBRATION, CLOCK):
        return _of_readings(runs, name, trial, number, effect.at)
    found = runs.sets[name]
    motions = [Motion(runs.machine, tuning.values, group, found.channels) for group in found.groups]
    if kind is ENCODER_ERROR:
        return _of_an_encoder(motions, effect, fitted.values[number])
    if kind is COUPLING:
        return _inertias_between_axes(runs, name, trial, effect, motions)
    joint = joint_at(effect.at, plant)
    is_driven = joint in {drive.joint for drive in plant.drives}
    if kind in (DELAY, LAG, LIMIT):
        return _of_a_drive(motions, effect.at, kind is not LIMIT)
    if kind is TRANSMISSION:
        return _of_a_gear(motions, effect, fitted.values[number])
    if kind is ELASTIC:
        return _at_a_spring(motions, effect, fitted.values[number])
    if not is_driven and spring_at(effect.at, plant) is None and effect.effect not in OVER_TIME:
        return []
    parts = [motion.residual(effect.at) for motion in motions]
    at = [each.name for each in plant.tree.joints].index(joint)
    if not is_driven and effect.effect not in OVER_TIME:
        parts = [_of_a_deflection(part, motion.deflection(at)) for part, motion in zip(parts, motions, strict=True)]
    elif effect.effect in OF_ACCELERATION:
        axis = next(drive.axis for drive in plant.drives if drive.joint == joint)
        each = zip(parts, motions, runs.rows(trial, name) or (None,) * len(parts), strict=True)
        parts = [replace(part, acceleration=_acceleration(motion, rows, axis)) for part, motion, rows in each]
    begins = from_rest if effect.effect in OVER_TIME else np.asarray
    return _on_a_joint(_functions(effect, fitted.values[number], parts), parts, at, begins)


def _on_a_joint(
    functions: Efforts, parts: Sequence[Residual], joint: int, begins: Callable[[np.ndarray], np.ndarray] = np.asarray
) -> list[list[Function]]:
    """Per group, every effort on this joint."""
    ends = np.cumsum([0, *(len(part.time_s) for part in parts)])
    return [[Function(((joint, begins(function[a:b])),)) for function in functions] for a, b in pairwise(ends)]


def _is_friction(name: str) -> bool:
    return effects()[name].kind is FRICTION or name in ALSO_FRICTIONS


def _spring_of(effect: EffectAt, motions: Sequence[Motion]) -> int:
    """Its joint's number."""
    plant = motions[0].machine.plant
    spring = spring_at(effect.at, plant)
    assert spring is not None, effect
    return [joint.name for joint in plant.tree.joints].index(spring)


def _at_a_spring(motions: Sequence[Motion], effect: EffectAt, values: np.ndarray) -> list[list[Function]]:
    """Of an elastic law."""
    own = _spring_of(effect, motions)
    parts = [motion.residual(effect.at) for motion in motions]
    if own not in motions[0].plant.joint_of_axis().values():
        parts = [replace(part, other_position=motion.deflection(own)) for part, motion in zip(parts, motions, strict=True)]
    return _on_a_joint(_functions(effect, values, parts), parts, own)


def _of_a_gear(motions: Sequence[Motion], effect: EffectAt, values: np.ndarray) -> list[list[Function]]:
    """Other functions of position by which a gear may be off: its spring rests elsewhere, and the spring's effort along that acts back on
    the motor, as those of the law itself do.

    On the motor alone they would be a load, a hundredth of what winds up the spring, and a load beside a gear's error would pass for such
    an error.
    """
    own, plant = _spring_of(effect, motions), motions[0].machine.plant
    driven = [joint.name for joint in plant.tree.joints].index(plant.drives[motions[0].axis_of(effect.at)].joint)
    parts = [motion.residual(effect.at) for motion in motions]
    position = np.concatenate([part.position for part in parts])
    functions = _with_slopes(position, values[0] * parts[0].ratio)
    ends = np.cumsum([0, *(len(part.position) for part in parts)])
    found = []
    for motion, (a, b) in zip(motions, pairwise(ends), strict=True):
        wound = motion.deflection(own)
        found.append([Function(((own, off[a:b]), (driven, wound * slope[a:b]))) for off, slope in functions])
    return found


def _with_slopes(position: np.ndarray, order: float) -> list[tuple[np.ndarray, np.ndarray]]:
    """Waves over position and what changes slowly along it, of both the first ones' changes too, each with its slope."""
    knots = np.linspace(float(position.min()), float(position.max()) + 1e-9, SLOW_KNOTS)
    part = np.clip(np.searchsorted(knots, position, side="right") - 1, 0, SLOW_KNOTS - 2)
    slow = [(np.interp(position, knots, row), (np.diff(row) / np.diff(knots))[part]) for row in np.eye(SLOW_KNOTS)]
    turned = [(k * order, k * order * position) for k in HARMONICS]
    waves = [wave for w, x in turned for wave in ((np.cos(x), -w * np.sin(x)), (np.sin(x), w * np.cos(x)))]
    return [*waves, *((f * g, f * g_slope + f_slope * g) for f, f_slope in waves[:2] for g, g_slope in slow), *slow]


def _of_a_deflection(part: Residual, deflection: np.ndarray) -> Residual:
    """The motion of a sprung joint that no drive turns."""
    speed = np.gradient(deflection, part.time_s)
    turned = replace(part, position=deflection, speed=speed, acceleration=np.gradient(speed, part.time_s))
    return replace(turned, other_position=deflection, ratio=1.0)


def _of_a_drive(motions: Sequence[Motion], axis: str, lags: bool) -> list[list[Function]]:
    """Per group, other functions of what a drive gave, or of what it gave a few samples ago: efforts on its joint, which its measured
    current shows. A drive that is late may also act otherwise within a sample, whose mean alone its current shows: on a mass that is the
    second difference of what it gave.
    """
    machine, found = motions[0].machine, []
    number = machine.axis_index(axis)
    joint = [each.name for each in machine.plant.tree.joints].index(machine.plant.drives[number].joint)
    current = f"{'current' if machine.units[number].effort == 'A' else 'effort'}_{axis}"
    top = max(float(np.abs(motion.drive_effort[:, number]).max()) for motion in motions)
    for motion in motions:
        given, gain = motion.drive_effort[:, number], float(motion.gains[number])
        if lags:
            efforts = [np.concatenate([np.full(rows, given[0]), given[:-rows]]) - given for rows in AGO]
        else:
            efforts = _hats(given, KNOTS, np.linspace(-top, top, KNOTS))
        channel = motion.channels.index(current) if current in motion.channels else None
        functions = [Function(((joint, own),), () if channel is None else ((channel, own / gain),)) for own in efforts]
        if lags:
            functions.append(Function(((joint, np.diff(given, n=2, prepend=given[0], append=given[-1])),)))
        found.append(functions)
    return found


def _of_an_encoder(motions: Sequence[Motion], effect: EffectAt, values: np.ndarray) -> list[list[Function]]:
    """Per group, other functions of position that an encoder may read too much, the loop with it where it reads that one: of an incremental
    one none at the start of a run, where it begins to count. Waves of its lines where these err.
    """
    machine, channels = motions[0].machine, motions[0].channels
    axis, is_link = effect.at.removeprefix("link_").removeprefix("position_"), effect.at.startswith("link_")
    if effect.at not in channels:
        return []
    column = channels.index(effect.at)
    counts_from_the_start = not next(one.absolute for one in machine.plant.encoders if one.channel == effect.at)
    each = [motion.group.mean[:, column] if is_link else motion.residual(axis).position for motion in motions]
    position = np.concatenate(each)
    functions = _hats(position, KNOTS)
    named = dict(zip((parameter.name for parameter in effects()[effect.effect].parameters), values, strict=True))
    if named["b"] > 0.0:
        waves = [turn(order * named["Nl"] * position) for order in HARMONICS for turn in (np.cos, np.sin)]
        functions += [*waves, *(wave * hat for wave in waves[:2] for hat in _hats(position, SLOW_KNOTS))]
    ends = np.cumsum([0, *(len(own) for own in each)])
    found = []
    for motion, (a, b) in zip(motions, pairwise(ends), strict=True):
        is_none_at_first = counts_from_the_start and not motion.group.windows[0].start
        errors = [function[a:b] - (function[a] if is_none_at_first else 0.0) for function in functions]
        if is_link:
            found.append([Function(readings=((column, own),)) for own in errors])
        else:
            found.append([Function(((number_of_encoder(machine, axis), own),)) for own in errors])
    return found


def _of_readings(runs: FreeRuns, name: str, trial: Trial, number: int, at: str) -> list[list[Function]]:
    """Per group, what a sensor may read in place of what it does: of a clock, its channel's rate of change, slowly varying, and the rate of
    that; of an IMU's scale, other functions of the same readings. In units of its noise each is as large as every other. None of a sensor
    that the loop reads.
    """
    without = runs.rows(replace(trial, effects=(*trial.effects[:number], *trial.effects[number + 1 :])), name)
    rows = runs.rows(trial, name)
    channels = runs.sets[name].channels
    if rows is None or without is None:
        return []
    changed = [c for c in range(len(channels)) if any(np.any(a[:, c] != b[:, c]) for a, b in zip(rows, without, strict=True))]
    if not {channels[c] for c in changed} <= {at, *imu_channel_names(runs.machine.plant)}:
        return []
    is_late = effects()[trial.effects[number].name].kind is CLOCK
    step_s, ends = 1.0 / runs.machine.sample_rate_Hz, np.cumsum([0, *(len(read) for read in without)])
    time_s, every = np.concatenate([step_s * np.arange(len(read)) for read in without]), np.concatenate(without)
    slowly = _hats(time_s, SLOW_KNOTS)
    found: list[list[Function]] = [[] for _ in without]
    for c in changed:
        if is_late:
            rate = np.concatenate([np.gradient(read[:, c], step_s) for read in without])
            change = np.concatenate([np.gradient(rate[a:b], step_s) for a, b in pairwise(ends)])
            others = [*(rate * hat for hat in slowly), change]
        else:
            same = [channels.index(other) for other in _of_one_sensor(channels[c]) if other in channels and other != channels[c]]
            others = [*_hats(every[:, c], SLOW_KNOTS), *every[:, same].T, *slowly]
        for own in others:
            alike = own * runs.noise.std[c] / max(float(np.sqrt(np.mean(own**2))), 1e-300)
            for functions, a, b in zip(found, ends[:-1], ends[1:], strict=True):
                functions.append(Function(readings=((c, alike[a:b]),)))
    return found


def _of_one_sensor(channel: str) -> list[str]:
    """Channels of the accelerometer, or of the gyro, that this one is of."""
    return [f"{channel[:-1]}{letter}" for letter in "xyz"]


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
        found.append([Function(((pair[0], first), (pair[1], second))) for first, second in _between_axes(effect.effect, part)])
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


def _functions(effect: EffectAt, values: np.ndarray, parts: Sequence[Residual]) -> Efforts:
    """Efforts that its law may err by."""
    name, motion = effect.effect, joined(parts)
    if _is_friction(name):
        return _of_a_friction(name, motion, np.concatenate([since_reversal(part) for part in parts]))
    if name in OF_ACCELERATION:
        return _of_a_mode(values, parts)
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
    over_position = _hats(motion.other_position if effects()[name].kind is ELASTIC else motion.position, KNOTS)
    return [*over_position, *_hats(motion.time_s, SLOW_KNOTS)] if name == "constant_load" else over_position


def _of_a_mode(values: np.ndarray, parts: Sequence[Residual]) -> Efforts:
    """Spring's and damper's parts of what masses pull by that swing at other frequencies, and more where they swing farther."""
    _, f, zeta = values
    found: Efforts = []
    for share in DETUNED:
        w = 2.0 * np.pi * f * share
        mode = scipy.signal.StateSpace([[0.0, 1.0], [-w * w, -2.0 * max(zeta, LIGHT) * w]], [[0.0], [-1.0]], np.eye(2), np.zeros((2, 1)))
        swings = [scipy.signal.lsim(mode, part.acceleration, _equal_steps(part.time_s))[1] for part in parts]
        z, speed = np.concatenate(swings).T
        found += [w * w * z, w * speed]
        if share == 1.0:
            size = max(float(np.abs(z).max()), 1e-300)
            found += [w * w * z * (z / size) ** 2, w * speed * np.abs(speed) / (w * size)]
    return found


def _equal_steps(time_s: np.ndarray) -> np.ndarray:
    """(N,) from 0 to the same end: recorders' clocks jitter."""
    return np.linspace(0.0, time_s[-1] - time_s[0], len(time_s))


def _of_a_friction(name: str, motion: Residual, since_reversal: np.ndarray) -> list[np.ndarray]:
    top = max(float(np.abs(motion.speed).max()), 1e-12)
    travel = max(float(np.ptp(motion.position)), 1e-12)
    against = motion.speed / np.hypot(motion.speed, STANDS * top)
    over_speed = _hats(np.abs(motion.speed) / top, len(SPEEDS), np.array(SPEEDS))
    functions = [np.where(way * motion.speed > 0.0, against * hat, 0.0) for way in (1.0, -1.0) for hat in over_speed]
    functions += [against * np.exp(-since_reversal / (share * travel)) for share in AFTER_REVERSAL]
    if name == "position_dependent_friction":
        functions += [against * hat for hat in _hats(motion.position, KNOTS)]
    if name in ("load_dependent_friction", "motor_load_friction"):
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
