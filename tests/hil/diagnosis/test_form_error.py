"""What errors of an equation explain, against generalized least squares, and what they do to recordings, against the free run."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from carriage import MACHINE, repeats
from places import CONCEALED_MACHINES

from hil.diagnosis.fitting.refit import Fitted
from hil.diagnosis.judging.error_functions import can_err, error_functions, since_reversal
from hil.diagnosis.judging.form_error import NO_ERROR, FormError, form_error
from hil.diagnosis.locating.disturbance import loop_response
from hil.diagnosis.recorded.align import aligned
from hil.diagnosis.residuals.mismatch import mismatch
from hil.diagnosis.result import EffectAt
from hil.diagnosis.starting.candidates import setting_of
from hil.diagnosis.starting.motion import Motion
from hil.diagnosis.starting.through_the_loop import ThroughTheLoop, number_of_encoder
from hil.diagnosis.tuning.free_run import TRAIN, FreeRuns, Trial
from hil.diagnosis.tuning.retune import retune
from hil.machine import Machine, load_machine
from hil.recording import Channel, Recording, recording_metadata
from hil.simulation import simulate

ENTRIES = 60
SPRING_MASS = CONCEALED_MACHINES / "spring_mass.toml"


def test_energy_taken_and_gain_are_those_of_generalized_least_squares():
    random = np.random.default_rng(4)
    rows, residual, response = random.standard_normal((5, ENTRIES)), random.standard_normal(ENTRIES), random.standard_normal(ENTRIES)
    inverse = np.linalg.inv(np.eye(ENTRIES) + rows.T @ rows)
    errors = FormError(rows)
    assert errors.taken_by(residual) == pytest.approx(residual @ residual - residual @ inverse @ residual)
    residual += 3.0 * response
    amplitude = (response @ inverse @ residual) / (response @ inverse @ response)
    left = residual - amplitude * response
    assert errors.gain(residual, response) == pytest.approx(residual @ inverse @ residual - left @ inverse @ left)
    assert errors.gain(-residual, response) == 0.0


def test_an_effect_counts_in_full_outside_of_errors_and_hardly_within():
    within, outside = 10.0 * np.eye(ENTRIES)[:2]
    errors = FormError(within[None, :])
    assert errors.gain(outside, outside) == pytest.approx(100.0)
    assert errors.gain(within, within) == pytest.approx(100.0 / 101.0)
    assert NO_ERROR.gain(within, within) == pytest.approx(100.0)


@pytest.fixture(scope="module")
def carriage():
    found = mismatch(MACHINE, aligned(MACHINE, repeats(3, duration_s=2.0)))
    with FreeRuns({TRAIN: found}, found.noise) as runs:
        yield runs, retune(runs)


def driven(machine: Machine, command: Channel, noise: float):
    """A machine under a command, or behind a reference, in three repeats with noise of this size on every channel."""
    random = np.random.default_rng(3)
    (axis,), rows = machine.axes, len(command.values)
    channels = {"time": Channel("s", np.arange(rows) / machine.sample_rate_Hz)}
    if machine.controllers:
        channels |= {f"reference_{axis}": command, f"excitation_{axis}": Channel(machine.units[0].effort, np.zeros(rows))}
    else:
        channels |= {f"command_{axis}": command}
    answer = simulate(machine, Recording(channels, recording_metadata(machine))).channels

    def repeat() -> Recording:
        measured = {name: own for name, own in answer.items() if name not in channels}
        noisy = {name: Channel(own.unit, own.values + noise * random.standard_normal(rows)) for name, own in measured.items()}
        return Recording(channels | noisy, recording_metadata(machine))

    found = mismatch(machine, {f"repeat {k}": repeat() for k in range(3)})
    with FreeRuns({TRAIN: found}, found.noise) as runs:
        yield runs, retune(runs)


@pytest.fixture(scope="module")
def rotor():
    """A motor that nothing holds."""
    machine = load_machine("laas_anti_cogging")
    yield from driven(machine, Channel("A", 0.05 + 0.3 * np.sin(20.0 * np.arange(1000) / machine.sample_rate_Hz)), 1e-3)


@pytest.fixture(scope="module")
def rider():
    """Two masses on springs, the first of which is pushed at 2 and 4.5 Hz."""
    machine = load_machine(SPRING_MASS)
    time_s = np.arange(1999) / machine.sample_rate_Hz
    yield from driven(machine, Channel("N", 5.0 * np.sin(2.0 * np.pi * 2.0 * time_s) + 5.0 * np.sin(2.0 * np.pi * 4.5 * time_s)), 1e-4)


@pytest.fixture(scope="module")
def slider():
    """A carriage behind a gear and a spring, to and fro over 0.6 m."""
    machine = load_machine(SPRING_MASS.with_name("slider.toml"))
    time_s = np.arange(1999) / machine.sample_rate_Hz
    yield from driven(machine, Channel("m", 0.28 * np.sin(2.0 * np.pi * 0.25 * time_s) * np.minimum(time_s, 1.0)), 1e-5)


def fitted(runs, tuning, *found: tuple[str, list[float]], axis: int = 0, at: str = "") -> Fitted:
    """These effects at one axis, or at another place, as a fit would have left them."""
    at = at or runs.machine.axes[axis]
    effects, values = [EffectAt(name, at) for name, _ in found], [np.array(own) for _, own in found]
    settings = tuple(setting_of(effect, own) for effect, own in zip(effects, values, strict=True))
    predicted = runs.run_one(Trial(tuning.values, settings))
    return Fitted(tuple(effects), tuple(values), tuning.offset, predicted, 0.0, (), np.zeros((len(predicted), 0)), np.zeros(0))


def within(
    carriage, found: tuple[str, list[float]], other: tuple[str, list[float]], axis: int = 0, at: str = ""
) -> tuple[FormError, np.ndarray, float]:
    """Errors of an effect, another one's change of the free run, and the share of its energy that the errors span."""
    runs, tuning = carriage
    errors = form_error(runs, TRAIN, tuning, fitted(runs, tuning, found, at=at))
    answer = fitted(runs, tuning, other, axis=axis, at=at).predicted - tuning.predicted
    left = answer - np.linalg.lstsq(errors.responses.T, answer, rcond=1e-8)[0] @ errors.responses
    return errors, answer, 1.0 - float(left @ left) / float(answer @ answer)


FRICTION, SPRING = ("coulomb_friction", [2.0]), ("cable_spring", [20.0, 0.0, 0.0])


def test_another_friction_of_the_same_joint_is_an_error_of_the_one_that_was_found(carriage):
    assert within(carriage, ("viscous_friction", [20.0]), FRICTION)[2] > 0.95
    assert within(carriage, FRICTION, ("quadratic_friction", [50.0]))[2] > 0.95


def test_errors_run_away_on_a_joint_that_nothing_holds_as_the_free_run_does(rotor):
    assert within(rotor, ("viscous_friction", [1e-5]), ("viscous_friction", [1e-5]))[2] > 0.999
    assert within(rotor, ("coulomb_friction", [1e-3]), ("quadratic_friction", [1e-6]))[2] > 0.999


def test_the_way_since_a_reversal_begins_anew_after_a_dwell_but_not_on_the_same_way():
    speed = np.array([1.0, 1.0, 0.0, 0.0, -1.0, -1.0, 0.0, -1.0])
    motion = SimpleNamespace(speed=speed, position=np.array([0.0, 1.0, 2.0, 2.0, 2.0, 1.0, 0.0, 0.0]))
    assert since_reversal(motion) == pytest.approx([0.0, 1.0, 2.0, 2.0, 0.0, 1.0, 2.0, 2.0])


def test_a_spring_is_no_error_of_a_friction_nor_a_friction_one_of_a_spring(carriage):
    assert within(carriage, FRICTION, SPRING)[2] < 0.5
    assert within(carriage, SPRING, FRICTION)[2] < 0.5


def test_another_friction_counts_where_it_is_more_than_an_error_of_the_first(carriage):
    """Both stand out of the noise by far, alone: 3 % of the first is an error of it, as much as it is not."""
    for share, counts in ((0.03, False), (1.0, True)):
        errors, answer, _ = within(carriage, ("coulomb_friction", [50.0]), ("viscous_friction", [share * 50.0 / 0.2]))  # at 0.2 m/s
        assert answer @ answer > 50.0
        assert (errors.gain(answer, answer) > 100.0) is counts
        assert (errors.gain(answer, answer) < 1.0) is not counts


SHAKES = ("base_motion", [2.0, 5.0, 0.4])


@pytest.mark.parametrize("other", [("base_motion", [2.0, 10.0, -1.0]), ("base_motion", [2.0, 15.0, 2.0])], ids=["second", "third"])
def test_a_floor_s_shaking_errs_as_its_harmonics(carriage, other):
    assert within(carriage, SHAKES, other)[2] > 0.95


@pytest.mark.parametrize("other", [FRICTION, ("base_motion", [2.0, 8.3, 0.0])], ids=["friction", "another frequency"])
def test_what_moves_with_the_machine_or_at_another_frequency_is_no_error_of_a_floor_s_shaking(carriage, other):
    errors, answer, share = within(carriage, SHAKES, other)
    assert len(errors.responses) and share < 0.5
    assert errors.gain(answer, answer) > 0.5 * float(answer @ answer)


def test_what_is_no_function_of_a_joint_s_motion_is_left_to_the_general_rule(carriage):
    runs, tuning = carriage
    assert can_err(EffectAt("cogging", "carriage"))
    assert not can_err(EffectAt("payload", "carriage"))
    assert form_error(runs, TRAIN, tuning, fitted(runs, tuning, ("torque_constant", [1.05]))) is NO_ERROR


LOAD = ("constant_load", [5.0])


def test_a_load_that_changes_along_the_way_is_an_error_of_a_constant_one(carriage):
    assert within(carriage, LOAD, SPRING)[2] > 0.9
    assert within(carriage, LOAD, ("gravity_imbalance", [5.0, 0.3]))[2] > 0.9


def test_a_friction_is_no_error_of_a_load(carriage):
    errors, answer, share = within(carriage, LOAD, FRICTION)
    assert len(errors.responses) and share < 0.5
    assert errors.gain(answer, answer) > 0.5 * float(answer @ answer)


def test_a_load_may_err_slowly_in_time(carriage):
    """As a hose does that is warm after a while."""
    runs, tuning = carriage
    (functions,) = error_functions(runs, TRAIN, tuning, fitted(runs, tuning, LOAD), 0)
    (group,) = runs.sets[TRAIN].groups
    efforts = np.stack([effort for function in functions for _, effort in function.efforts])
    wanted = np.exp(-group.time_s / 8.0)
    left = wanted - np.linalg.lstsq(efforts.T, wanted, rcond=1e-8)[0] @ efforts
    assert np.abs(left).max() < 0.01


def test_a_sign_is_known_to_err_by_nothing(carriage):
    runs, tuning = carriage
    (sensor,) = (channel for channel in runs.sets[TRAIN].channels if channel.startswith("position_"))
    turned = replace(fitted(runs, tuning), effects=(EffectAt("rectified_sensor", sensor),), values=(np.array([0.0, -1.0]),))
    errors = form_error(runs, TRAIN, tuning, turned)
    assert errors.effects == turned.effects
    assert errors.gain(tuning.predicted, tuning.predicted) == pytest.approx(tuning.predicted @ tuning.predicted)


def test_a_spring_behind_a_joint_errs_by_its_own_deflection_not_by_the_drive_s_effort(rider):
    hardening = "nonlinear_stiffness", [2e5, 1.0, 0.002]
    assert within(rider, hardening, hardening)[2] > 0.8


@pytest.mark.parametrize(
    ("found", "other"),
    [
        (("bouc_wen_hysteresis", [2000.0, 1.0, 0.001, 0.5, 1.0]), ("bouc_wen_hysteresis", [2000.0, 1.0, 0.0005, 0.5, 1.0])),
        (("base_motion", [2.0, 5.0, 0.4]), ("base_motion", [1.0, 10.0, -1.0])),
    ],
    ids=["a hysteresis of its spring", "what shakes it"],
)
def test_what_acts_on_a_body_without_a_drive_errs_there(rider, found, other):
    assert within(rider, found, other, at="rider")[2] > 0.8


def test_a_gear_s_errors_act_as_its_own_law_does_on_its_spring_and_back_on_the_motor(slider):
    """A spring that rests elsewhere by f(q) pushes the motor back by what winds it up times f'(q)."""
    runs, tuning = slider
    values = [20.0, 2e-5, 0.0, 0.0, 0.0]
    (functions,) = error_functions(runs, TRAIN, tuning, fitted(runs, tuning, ("transmission_error", values)), 0)
    position = runs.sets[TRAIN].groups[0].position[:, 0]
    at = np.flatnonzero(np.abs(np.gradient(position)) > 1e-4)
    found = runs.sets[TRAIN]
    spring = [joint.name for joint in runs.machine.plant.tree.joints].index("belt")
    wound = Motion(runs.machine, tuning.values, found.groups[0], found.channels).deflection(spring)
    for function in functions:
        (own, off), (driven, back) = function.efforts
        assert (own, driven != own) == (spring, True)
        slope = np.gradient(off) / np.gradient(position)
        far = at[np.abs(np.gradient(slope)[at]) < 0.3 * np.abs(slope).max()]  # not at a knot
        assert np.linalg.norm((back - wound * slope)[far]) < 0.05 * np.linalg.norm((wound * slope)[far])


def test_a_load_is_no_error_of_a_gear_s_but_another_wave_is(slider):
    """What winds up the spring behind a gear is in balance: nothing of it pushes the carriage."""
    runs, tuning = slider
    gear = fitted(runs, tuning, ("transmission_error", [20.0, 2e-5, 0.4, 1e-5, 1.0]))
    errors = form_error(runs, TRAIN, tuning, gear)
    assert errors.effects == gear.effects
    load, wave = (
        fitted(runs, tuning, other).predicted - tuning.predicted
        for other in (("constant_load", [0.02]), ("transmission_error", [20.0, 2e-6, 1.9, 1e-6, 2.0]))
    )
    assert errors.gain(load, load) > 0.9 * float(load @ load)
    assert errors.taken_by(wave) > 0.5 * float(wave @ wave)


@pytest.mark.parametrize("shaken_Hz", [1.0, 4.0, 8.0])
def test_a_spring_behind_a_joint_deflects_as_a_shaken_oscillator_does(shaken_Hz):
    """A rider of 2 kg on 2200 N/m and 3 N s/m, whose cart moves to and fro: below, near and above its 5.3 Hz."""
    machine = load_machine(SPRING_MASS)
    w, time_s = 2.0 * np.pi * shaken_Hz, np.arange(1999) / machine.sample_rate_Hz
    turning = 0.01 * np.exp(1j * w * time_s)
    cart = SimpleNamespace(position=turning.imag[:, None], speed=(1j * w * turning).imag[:, None])
    motion = Motion(machine, None, cart, ())
    wanted = (turning * 2.0 * w**2 / (2200.0 - 2.0 * w**2 + 3.0j * w)).imag
    rider = [joint.name for joint in machine.plant.tree.joints].index("rider_spring")
    later = slice(1400, None)  # it begins at full speed: what that sets ringing falls to a 190th by then
    assert motion.deflection(rider)[later] == pytest.approx(wanted[later], abs=0.01 * np.ptp(wanted))


@pytest.mark.parametrize(
    ("found", "other"),
    [
        (("drive_bandwidth", [800.0, 0.7]), ("delay", [0.0002])),
        (("drive_bandwidth", [800.0, 0.7]), ("drive_bandwidth", [1500.0, 1.2])),
        (("delay", [0.0002]), ("drive_bandwidth", [800.0, 0.7])),
        (("structural_mode", [8.0, 9.0, 0.02]), ("structural_mode", [8.0, 9.6, 0.05])),
    ],
    ids=["a delay of a drive's lag", "another lag", "a lag of a delay", "a mode that swings faster"],
)
def test_another_law_of_the_same_kind_is_an_error_of_the_one_that_was_found(carriage, found, other):
    assert within(carriage, found, other)[2] > 0.9


def test_how_a_late_target_acts_within_a_sample_is_an_error_that_its_current_does_not_show(carriage):
    """Mixed with the target before or shifted, it has the same mean; a mass moves otherwise, by a share of what acts on it twice summed."""
    runs, tuning = carriage
    late = fitted(runs, tuning, ("delay", [0.0002]))
    (functions,) = error_functions(runs, TRAIN, tuning, late, 0)
    ((joint, effort),), ((_, shown),) = functions[-1].efforts, functions[0].efforts  # what it gave a sample ago less what it gives
    assert not functions[-1].readings
    assert joint == functions[0].efforts[0][0]
    assert effort[1:-1] == pytest.approx(shown[1:-1] - shown[2:])


def test_another_limit_of_a_drive_is_an_error_of_the_one_that_was_found(rider):
    assert within(rider, ("current_saturation", [8.0, 0.0]), ("current_saturation", [7.0, 0.0]))[2] > 0.8


def test_a_mode_s_errors_bear_a_recorder_s_jitter(carriage):
    runs, tuning = carriage
    mode = fitted(runs, tuning, ("structural_mode", [8.0, 9.0, 0.02]))
    (group,) = runs.sets[TRAIN].groups
    jitter = 1e-4 / MACHINE.sample_rate_Hz * np.random.default_rng(8).standard_normal(len(group.time_s))
    found = replace(runs.sets[TRAIN], groups=(replace(group, time_s=group.time_s + jitter),))
    with FreeRuns({TRAIN: found}, found.noise) as jittering:
        errors = form_error(jittering, TRAIN, tuning, mode)
    assert errors.responses == pytest.approx(form_error(runs, TRAIN, tuning, mode).responses, rel=1e-3, abs=1e-3)


@pytest.mark.parametrize("found", [("drive_bandwidth", [800.0, 0.7]), ("structural_mode", [8.0, 9.0, 0.02])], ids=lambda found: found[0])
def test_a_friction_or_a_spring_is_no_error_of_a_drive_s_lag_nor_of_a_mode(carriage, found):
    for other in (FRICTION, SPRING):
        errors, answer, _ = within(carriage, found, other)
        assert len(errors.responses)
        assert errors.gain(answer, answer) > 0.5 * float(answer @ answer)


PAN_TILT = load_machine(SPRING_MASS.with_name("pan_tilt.toml"))


@pytest.fixture(scope="module")
def head():
    """Pan and tilt under their controllers, each on a way of its own."""
    time_s = np.arange(1200) / PAN_TILT.sample_rate_Hz
    ways = {"pan": 0.5 * np.sin(2.0 * np.pi * 0.7 * time_s), "tilt": 0.6 * np.sin(2.0 * np.pi * 0.45 * time_s + 1.0)}
    begin = np.minimum(time_s, 1.0) ** 2
    inputs = {f"reference_{axis}": Channel("rad", begin * way) for axis, way in ways.items()}
    inputs |= {f"excitation_{axis}": Channel("A", np.zeros(len(time_s))) for axis in ways}
    channels = {"time": Channel("s", time_s), **inputs}
    answer = simulate(PAN_TILT, Recording(channels, recording_metadata(PAN_TILT))).channels
    random = np.random.default_rng(5)

    def repeat() -> Recording:
        measured = {name: own for name, own in answer.items() if name not in channels and not name.startswith("command_")}
        noise = {name: 1e-2 if name.startswith(("imu", "current")) else 1e-3 if name.startswith("gyro") else 1e-5 for name in measured}
        noisy = {n: Channel(own.unit, own.values + noise[n] * random.standard_normal(len(time_s))) for n, own in measured.items()}
        return Recording(channels | noisy, recording_metadata(PAN_TILT))

    found = mismatch(PAN_TILT, aligned(PAN_TILT, {f"repeat {k}": repeat() for k in range(3)}))
    with FreeRuns({TRAIN: found}, found.noise) as runs:
        yield runs, retune(runs)


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("name", "inertia"), [("pose_dependent_dynamics", 0.2), ("axis_coupling", 0.02)], ids=["of the first axis", "between both"]
)
def test_an_inertia_between_two_axes_errs_as_another_function_of_their_positions(head, name, inertia):
    for phase in (0.3, 1.8):
        assert within(head, (name, [inertia, 0.3]), (name, [inertia, phase]))[2] > 0.95


@pytest.mark.nightly
def test_which_axis_s_position_an_inertia_between_both_depends_on_is_an_error_of_it(head):
    assert within(head, ("axis_coupling", [0.02, 0.3]), ("axis_coupling", [0.02, 0.3]), axis=1)[2] > 0.95


def of_a_sensor(head, found: tuple[str, str, list[float]], other: tuple[str, str, list[float]]) -> tuple[FormError, np.ndarray]:
    """Errors of an effect of a sensor, and another effect's change of the free run."""
    runs, tuning = head
    effects, values = [EffectAt(name, at) for name, at, _ in (found, other)], [np.array(own) for _, _, own in (found, other)]
    settings = [setting_of(effect, own) for effect, own in zip(effects, values, strict=True)]
    one, changed = (runs.run_one(Trial(tuning.values, (setting,))) for setting in settings)
    fit = Fitted((effects[0],), (values[0],), tuning.offset, one, 0.0, (), np.zeros((len(one), 0)), np.zeros(0))
    return form_error(runs, TRAIN, tuning, fit), changed - tuning.predicted


SCALE = ("imu_scale_bias", "imu", [0.01, 0.02, -0.01, 0.0, 0.0, 0.0, 0.0, 0.0])
LATE = ("clock_offset", "imu_y", [0.004, 0.0])


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("found", "other"),
    [
        (SCALE, ("imu_scale_bias", "imu", [-0.02, 0.01, 0.0, 0.05, 0.0, 0.02, 0.0, 0.0])),
        (LATE, ("clock_offset", "imu_y", [0.0, 0.001])),
    ],
    ids=["another scale", "a clock that goes slow"],
)
def test_another_function_of_the_same_reading_is_an_error_of_a_sensor_s(head, found, other):
    errors, answer = of_a_sensor(head, found, other)
    left = answer - np.linalg.lstsq(errors.responses.T, answer, rcond=1e-8)[0] @ errors.responses
    assert float(left @ left) < 0.1 * float(answer @ answer)


@pytest.mark.parametrize(
    ("found", "other"),
    [([1e-3, 0.3, 0.0, 1.0], [1e-3, 1.9, 0.0, 1.0]), ([0.0, 0.0, 1e-4, 40.0], [0.0, 0.0, 1e-4, 80.0])],
    ids=["a scale off its axis another way", "half a line"],
)
@pytest.mark.parametrize(
    ("machine", "at"),
    [pytest.param("head", "position_pan", marks=pytest.mark.nightly), ("rider", "link_position_cart")],
    ids=["in the loop", "out of it"],
)
def test_another_error_over_position_is_an_error_of_an_encoder_s(machine, at, found, other, request):
    """As the free run has it: a loop that reads an error follows it."""
    errors, answer = of_a_sensor(request.getfixturevalue(machine), *(("encoder_eccentricity", at, values) for values in (found, other)))
    left = answer - np.linalg.lstsq(errors.responses.T, answer, rcond=1e-8)[0] @ errors.responses
    assert answer @ answer > 50.0
    assert float(left @ left) < 0.15 * float(answer @ answer)


@pytest.mark.parametrize(
    ("machine", "axis", "share"),
    [pytest.param("head", "pan", 0.1, marks=pytest.mark.nightly), ("rider", "cart", 1e-6)],
    ids=["closed loop", "open loop"],
)
def test_the_loop_answers_to_what_an_encoder_reads_too_much_as_the_free_run_does(machine, axis, share, request):
    """A scale a little off its axis, but for the IMU, which turns in gravity. The inertia about pan, and its loop, change with tilt."""
    runs, tuning = request.getfixturevalue(machine)
    setting = setting_of(EffectAt("encoder_eccentricity", f"position_{axis}"), np.array([1e-4, 0.3, 0.0, 1.0]))
    shown = runs.run_one(Trial(tuning.values, (setting,))) - tuning.predicted
    found, number = runs.sets[TRAIN], runs.machine.axis_index(axis)
    errors = [1e-4 * np.cos(group.position[:, number] + 0.3) for group in found.groups]
    absolute = next(encoder.absolute for encoder in runs.machine.plant.encoders if encoder.channel == f"position_{axis}")
    each = [[(number_of_encoder(runs.machine, axis), error if absolute else error - error[0])] for error in errors]
    (answer,) = ThroughTheLoop(runs, TRAIN, tuning).responses(each)
    kept = [not name.startswith(("imu_", "gyro_")) for name in found.channels]
    answer, shown = (np.concatenate([rows[:, kept].ravel() for rows in runs.by_group(one)]) for one in (answer, shown))
    assert shown @ shown > 50.0
    assert np.sum((answer - shown) ** 2) < share * (shown @ shown)


def test_an_axis_without_an_encoder_of_its_own_answers_to_no_error_of_it():
    machine = load_machine("coupled_electric_drives")
    lines = loop_response(machine, np.zeros(1), ("speed_motors",), np.array([0.5, 5.0]))
    joints = len(machine.plant.tree.joints)
    assert lines.shape == (2, 1, joints + 1)
    assert np.all(lines[:, :, joints] == 0.0)
    assert np.any(lines[:, :, :joints] != 0.0)


def test_another_lateness_counts_where_it_is_more_than_an_error_of_the_first(head):
    """Both stand out of the noise by far, alone: a lateness that grows by 0.03 and by 1 ms a second, beside one of 4 ms."""
    for growth_per_s, counts in ((3e-5, False), (1e-3, True)):
        errors, answer = of_a_sensor(head, LATE, ("clock_offset", "imu_y", [0.0, growth_per_s]))
        assert answer @ answer > 50.0
        assert (errors.gain(answer, answer) > 100.0) is counts
        assert (errors.gain(answer, answer) < 1.0) is not counts


@pytest.mark.parametrize(
    "found", [SCALE, LATE, ("encoder_eccentricity", "position_pan", [1e-3, 0.3, 0.0, 1.0])], ids=["scale", "clock", "encoder"]
)
def test_what_moves_the_machine_is_no_error_of_a_sensor(head, found):
    errors, answer = of_a_sensor(head, found, ("coulomb_friction", "pan", [0.02]))
    assert len(errors.responses)
    assert errors.gain(answer, answer) > 0.8 * float(answer @ answer)


def test_of_a_clock_of_what_the_loop_reads_the_general_rule_is_kept(head):
    assert of_a_sensor(head, ("clock_offset", "position_pan", [0.002, 0.0]), LATE)[0] is NO_ERROR


@pytest.mark.parametrize("found", [("pose_dependent_dynamics", [0.2, 0.3]), ("axis_coupling", [0.02, 0.3])], ids=lambda found: found[0])
def test_a_load_or_a_friction_is_no_error_of_an_inertia_between_two_axes(head, found):
    for other in (("constant_load", [0.1]), ("coulomb_friction", [0.1])):
        errors, answer, share = within(head, found, other)
        assert len(errors.responses) and share < 0.1
        assert errors.gain(answer, answer) > 0.9 * float(answer @ answer)
