"""Where fits of effects start, on mismatches of a C-arm that are drawn here."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import chi2

from hil.diagnosis.fitting.coordinates import Coordinates, Point
from hil.diagnosis.fitting.visited import Visited
from hil.diagnosis.result import EffectAt
from hil.diagnosis.starting.shape_limits import LEAST_BEND, shape_limits
from hil.diagnosis.starting.starts import shapes_of, starts_of
from hil.machine import load_machine
from virtual_bus.effects.registry import effects
from virtual_bus.effects.residual import Residual

CARM = load_machine("carm")
ROWS = 2560
TIME_s = np.arange(ROWS) / CARM.sample_rate_Hz
SHAKEN_Hz = np.arange(3.0, 25.0, 0.3)
PHASES = np.random.default_rng(2).uniform(0.0, 2.0 * np.pi, len(SHAKEN_Hz))
POSITION = 0.75 * np.sin(2.0 * np.pi * 0.2 * TIME_s) + 1e-5 * np.sin(2.0 * np.pi * TIME_s[:, None] * SHAKEN_Hz + PHASES).sum(axis=1)
SPEED = np.gradient(POSITION, TIME_s)
RATIO = 500.0
DEFLECTION = 1e-4


def moved(at: str, effort: np.ndarray, stiffness: float = 0.0) -> SimpleNamespace:
    """Motion of a propeller or roll that lacks this effort and whose spring gives way by DEFLECTION."""
    none = np.zeros(ROWS)
    spring = DEFLECTION * np.sin(2.0 * np.pi * 0.7 * TIME_s)
    readings = np.random.default_rng(1).standard_normal((ROWS, 6))
    is_imu = at == "imu"
    residual = Residual(
        TIME_s, POSITION, SPEED, np.gradient(SPEED, TIME_s), effort, none, readings if is_imu else none, readings if is_imu else none,
        100.0 + none, spring, np.gradient(spring, TIME_s), none, RATIO, stiffness,
    )  # fmt: skip
    return SimpleNamespace(
        residual=lambda at, coupled=False: residual,
        machine=CARM,
        plant=SimpleNamespace(settings=CARM.plant, joint_of_axis=lambda: {"propeller": 2, "roll": 4}),
        inertia=np.ones(len(CARM.plant.tree.joints)),
        axis_of=lambda at: 0,
        deflection=lambda joint: spring,
        assumed={},
        visited={},
    )


def starts(name: str, at: str, effort: np.ndarray, stiffness: float = 0.0) -> dict[str, np.ndarray]:
    """Start values by parameter."""
    found = np.array(starts_of(name, at, moved(at, effort, stiffness)))
    return {parameter.name: found[:, k] for k, parameter in enumerate(effects()[name].parameters)}


def test_a_wave_is_found_below_orders_at_which_noise_is_larger():
    """Noise of positions is an effort that grows with the square of frequency: half of it stands above a wave of 0.1 Nm."""
    noise = np.gradient(np.gradient(np.random.default_rng(4).standard_normal(ROWS), TIME_s), TIME_s) * 2.5e-4
    effort = 0.1 * np.cos(27.4 * POSITION + 0.3) + noise
    assert np.std(noise) > 20 * 0.1 / np.sqrt(2.0)
    apart = np.abs(starts("cogging", "propeller", effort)["Np"] * RATIO - 27.4)
    assert apart.min() < 0.5 * 2.0 * np.pi / np.ptp(POSITION)


@pytest.mark.parametrize(("lower", "starts_there"), [(0.03, True), (0.3, False)])
def test_an_order_is_another_one_s_second_harmonic_only_where_that_one_is_larger(lower, starts_there):
    effort = 0.1 * np.cos(54.0 * POSITION + 0.3) + lower * np.cos(27.0 * POSITION)
    apart = np.abs(starts("cogging", "propeller", effort)["Np"] * RATIO - 54.0)
    assert bool(apart.min() < 0.5 * 2.0 * np.pi / np.ptp(POSITION)) is starts_there


def test_a_light_mode_is_found_between_the_frequencies_of_a_coarse_grid():
    """A mass that hangs on the joint pulls at it, in noise as large as its pull and beside an inertia that is missing."""
    w, zeta, line = 2.0 * np.pi * 12.0, 0.02, 2j * np.pi * np.fft.rfftfreq(ROWS, TIME_s[1])
    moved = np.fft.rfft(np.gradient(SPEED, TIME_s))
    pull = np.fft.irfft(-moved * (w * w + 2.0 * zeta * w * line) / (line**2 + 2.0 * zeta * w * line + w * w), ROWS)
    random = np.random.default_rng(5)
    found = starts("structural_mode", "roll", pull + 0.5 * np.gradient(SPEED, TIME_s) + np.std(pull) * random.standard_normal(ROWS))
    assert np.abs(found["f"] / 12.0 - 1.0).min() < 0.03


@pytest.mark.parametrize(("at", "size"), [("roll", np.ptp(POSITION)), ("c_arc", 2.0 * DEFLECTION)])
def test_a_hysteresis_starts_at_displacements_that_its_joint_has(at, size):
    """The arc hangs on the spring behind roll's drive and moves as far as that gives way; roll itself turns."""
    flat_at = starts("bouc_wen_hysteresis", at, 5.0 * np.sign(SPEED), stiffness=9e5)["z_max"]
    assert sum((flat_at > 0.01 * size) & (flat_at < size)) >= 3


@pytest.mark.parametrize(("at", "size"), [("roll", np.ptp(POSITION)), ("c_arc", 2.0 * DEFLECTION)])
@pytest.mark.parametrize("name", ["bouc_wen_hysteresis", "presliding_hysteresis"])
def test_a_hysteresis_is_shown_where_it_slides_for_half_of_a_stroke(name, at, size):
    """After a reversal a spring with a slider gives way from one steady effort to the other, which is twice where it slides."""
    _, most = shape_limits(name, at, moved(at, 5.0 * np.sign(SPEED), 9e5))
    assert 2.0 * most == pytest.approx(0.5 * size, rel=1e-3)


@pytest.mark.parametrize(("at", "counts"), [("roll", LEAST_BEND), ("roll_rotor", LEAST_BEND), ("c_arc", 0.0)])
@pytest.mark.parametrize("name", ["bouc_wen_hysteresis", "presliding_hysteresis"])
def test_a_hysteresis_bends_by_more_than_the_encoder_of_its_joint_rounds(name, at, counts):
    """Behind a spring there is no encoder of its own."""
    drive = next(drive for drive in CARM.plant.drives if drive.axis == "roll")
    count = 2.0 * np.pi / 4096 / drive.ratio
    least, _ = shape_limits(name, at, moved(at, 5.0 * np.sign(SPEED), 9e5))
    assert least == pytest.approx(counts * count)


def test_a_hysteresis_without_repeats_bends_by_more_than_is_assumed_of_its_encoders_noise():
    motion = moved("roll", 5.0 * np.sign(SPEED))
    known, _ = shape_limits("bouc_wen_hysteresis", "roll", motion)
    for noise, least in ((1e-3, LEAST_BEND * 1e-3), (1e-9, known)):
        motion.assumed = {"position_roll": noise, "position_propeller": 1.0}
        assert shape_limits("bouc_wen_hysteresis", "roll", motion)[0] == pytest.approx(least)


def test_a_stop_begins_on_its_own_side_of_the_middle_of_the_travel_which_a_cable_has_the_ends_of():
    """In all recordings; behind a spring no travel is known."""
    ends, motion = (POSITION.min(), POSITION.max()), moved("roll", SPEED, 9e5)
    motion.axis_of = lambda at: 1
    assert shape_limits("cable_spring", "roll", motion) == pytest.approx(ends)
    assert shape_limits("end_stop", "roll", motion) == pytest.approx((np.mean(ends),) * 2)
    for name in ("end_stop", "cable_spring"):
        assert shape_limits(name, "c_arc", motion) == (-np.inf, np.inf)
    motion.visited = {"roll": (ends[0] - 1.0, ends[1])}
    assert shape_limits("end_stop", "roll", motion) == pytest.approx((np.mean(ends) - 0.5,) * 2)


def test_a_cable_beside_the_machine_file_s_own_spring_may_have_any_linear_part():
    sprung = load_machine("silverbox")
    motion = SimpleNamespace(machine=sprung, residual=None, visited={"mass": (-1.0, 1.0)}, axis_of=lambda at: 0)
    assert shape_limits("cable_spring", "mass", motion) == (-np.inf, np.inf)
    assert shape_limits("end_stop", "mass", SimpleNamespace(**{**vars(motion), "residual": moved("roll", SPEED).residual})) == (0.0, 0.0)


def test_a_base_motion_is_a_vibration_of_a_floor_however_long_it_was_recorded():
    """Criteria of floors begin at 1 Hz; of 10 s half a cycle is 0.05 Hz."""
    assert shape_limits("base_motion", "roll", moved("roll", SPEED)) == (1.0, np.inf)


def test_a_friction_that_warms_starts_with_some_where_a_damper_stands_for_it():
    """Re-tuned dampers take the mean of it: what is missing pushes at first and brakes in the end, or the other way round."""
    found = starts("temperature_dependent_friction", "roll", 40.0 * SPEED * np.exp(-TIME_s))
    warming_K = found["R"] * found["Fv0"] * np.mean(SPEED**2)
    assert sum((found["Fv0"] > 1.0) & (found["a"] * warming_K > 0.1) & (found["a"] * warming_K < 10.0)) >= 2


def test_an_effect_of_one_strength_starts_with_some_where_its_guess_sees_none():
    """A friction that grows with speed has no excess at low speed: a Stribeck friction is tried all the same."""
    assert all(starts("stribeck_friction", "roll", -3.0 * np.tanh(5.0 * SPEED))["Fs_minus_Fc"] > 0.0)


def test_a_refinement_that_its_guess_does_not_see_is_none():
    found = starts("asymmetric_friction", "roll", -3.0 * np.maximum(np.sign(SPEED), 0.0))
    assert found["Fc_plus"].max() > 1.0
    assert found["Fc_minus"].min() == 0.0


@pytest.mark.parametrize("begun", [0.0, 0.25])
def test_a_shape_that_starts_at_zero_or_comes_to_it_may_leave_it(begun):
    imu, start = EffectAt("imu_bandwidth", "imu"), np.array([30.0, begun])
    none = SimpleNamespace(at=lambda offset: offset)
    fit, at = Coordinates(none, (imu,), (start,), Visited(10.0)), Point(np.zeros(0), (np.array([30.0, 0.0]),))
    _, highest = fit.reach(at, 1.0)
    assert fit.moved(at, highest).values[0][1] > 0.2


def test_a_sensor_may_be_slower_or_faster_than_its_machine_file_says():
    corners = starts("imu_bandwidth", "imu", np.zeros(ROWS))["fc"]
    own = CARM.plant.imus[0].accelerometer_bandwidth_Hz
    assert any(corners < 0.5 * own) and any(corners > 2.0 * own) and any(np.abs(corners / own - 1.0) < 0.1)


def test_a_cable_starts_slack_at_both_ends_and_with_what_no_spring_of_the_machine_does():
    """Where re-tuned springs took the line of it, what is missing shows neither where it is slack nor that it pulls."""
    found = starts("cable_spring", "roll", 3.0 * POSITION)
    assert found["theta0"].min() == pytest.approx(POSITION.min()) and found["theta0"].max() == pytest.approx(POSITION.max())
    cubic = (found["kc"] == 0.0) & (found["kc3"] > 0.0)
    assert cubic.sum() == 1
    reached = found["kc3"][cubic] * np.abs(POSITION - found["theta0"][cubic]).max() ** 3
    assert 0.1 < reached.item() / np.std(3.0 * POSITION) < 10.0


def test_a_cable_s_starts_are_one_shape():
    """Of drawn noise, what pulls straight and to the third power of the way from anywhere takes what three parameters of one shape take."""
    cubics = np.linalg.qr(np.vander(POSITION, 4))[0]
    noise = np.random.default_rng(7).standard_normal((20_000, 4))  # along them: such a cable lies within
    most = np.zeros(len(noise))
    for slack_at in np.linspace(POSITION.min(), POSITION.max(), 101):
        way = POSITION - slack_at
        along = np.linalg.qr(cubics.T @ np.stack([way, way**3], axis=1))[0]
        most = np.maximum(most, ((noise @ along) ** 2).sum(axis=1))
    shapes = np.mean(most > chi2.isf(0.01, 3)) / 0.01  # 1.5; 2.3 with every direction of a cubic
    assert 0.5 < shapes_of("cable_spring", "roll", moved("roll", 3.0 * POSITION), 5) / shapes < 2.0


@pytest.mark.parametrize(
    ("name", "order", "wave"),
    [("position_dependent_friction", "k", 113.0), ("transmission_error", "k", 600.0)],
)
def test_a_wave_over_a_short_slide_starts_at_its_radians_per_metre(name, order, wave):
    """6 cm of travel are at most a few turns of a joint; in metres the same wave has a hundred times as many radians."""
    position, speed = 0.04 * POSITION, 0.04 * SPEED
    shape = np.cos(wave * position + 0.4)
    effort = -(1.0 + shape) * np.sign(speed)
    slide = moved("propeller", effort).residual("propeller")
    moves = {"position": position, "speed": speed, "acceleration": np.gradient(speed, TIME_s), "ratio": 1.0}
    slide = replace(slide, **moves, measured=1e-5 * shape, simulated=0.0 * shape)
    motion = moved("propeller", effort, 1e4)
    motion.residual = lambda at, coupled=False: slide
    place = [parameter.name for parameter in effects()[name].parameters].index(order)
    apart = np.abs(np.array(starts_of(name, "propeller", motion))[:, place] - wave)
    assert apart.min() < 0.5 * 2.0 * np.pi / np.ptp(position)


def test_a_channel_s_sign_starts_whole():
    """Where readings and simulation agree there is no guess, and a sign has no typical size: a matched filter may want a fraction of it."""
    found = starts("rectified_sensor", "position_roll", np.zeros(ROWS))
    each = [*zip(found["share"], found["sign"], strict=True)]
    assert sorted(each) == [(0.0, -1.0), (1.0, -1.0), (1.0, 1.0)]
    assert each[0] == (0.0, -1.0)  # of motion one way, which tells it from a lost sign by nothing, the one that holds the other way too
