"""The emulated physics through its own face: placing, brakes, timing, sensors, noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from small_plants import BLOCK_MASS_kg, block, gantry

from hil.machine.load import load_machine
from virtual_bus.errors import PlantError
from virtual_bus.physics import Physics
from virtual_bus.settings import Body, Joint, PlantSettings, Tree

PERIOD_s = 1.0 / 256.0


@pytest.fixture(scope="module")
def carm() -> PlantSettings:
    return load_machine("carm").plant


def test_a_placed_machine_stands_still_on_its_brakes(carm: PlantSettings) -> None:
    physics = Physics(carm, noise=False)
    physics.place(np.array([0.4, -0.9]))
    before = physics.truth()["joint_position"]
    for _ in range(256):
        physics.advance()
    np.testing.assert_allclose(physics.truth()["joint_position"], before, rtol=0, atol=1e-13)
    assert physics.time_s == 1.0


def test_the_holding_effort_holds_once_the_brakes_are_open(carm: PlantSettings) -> None:
    physics = Physics(carm, noise=False)
    pose = np.array([0.4, -0.9])
    physics.place(pose)
    physics.apply(physics.holding_effort(pose))
    physics.set_brakes(np.array([False, False]))
    before = physics.truth()["joint_position"]
    for _ in range(256):
        physics.advance()
    np.testing.assert_allclose(physics.truth()["joint_position"], before, rtol=0, atol=1e-9)


def test_the_holding_effort_of_a_pendulum_is_its_weight_on_its_lever() -> None:
    arm = Joint("arm", "revolute", np.array([0.0, 1.0, 0.0]))
    body = Body("bob", "world", np.zeros(3), np.eye(3), 3.0, np.array([0.0, 0.0, -0.5]), 0.02 * np.eye(3), arm)
    settings = replace(
        gantry(), tree=Tree((body,), np.array([0.0, 0.0, -9.81])), watched_bodies=(), encoders=(),
        drives=(replace(gantry().drives[0], axis="arm", joint="arm", constant=0.2, ratio=50.0),),
    )  # fmt: skip
    effort = Physics(settings, noise=False).holding_effort(np.array([0.7]))
    assert effort[0] == pytest.approx(3.0 * 9.81 * 0.5 * np.sin(0.7) / (0.2 * 50.0), rel=1e-12)


@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_no_finite_effort_of_a_drive_without_gain_holds_a_load() -> None:
    arm = Joint("arm", "revolute", np.array([0.0, 1.0, 0.0]))
    body = Body("bob", "world", np.zeros(3), np.eye(3), 3.0, np.array([0.0, 0.0, -0.5]), 0.02 * np.eye(3), arm)
    settings = replace(
        gantry(), tree=Tree((body,), np.array([0.0, 0.0, -9.81])), watched_bodies=(), encoders=(),
        drives=(replace(gantry().drives[0], axis="arm", joint="arm", constant=0.0),),
    )  # fmt: skip
    physics = Physics(settings, noise=False)
    assert physics.holding_effort(np.array([0.7]))[0] == np.inf
    assert physics.holding_effort(np.array([0.0]))[0] == 0.0


def test_a_joint_with_nothing_to_rest_against_is_refused_in_one_line() -> None:
    settings = gantry()
    lift = settings.tree.bodies[3]
    assert lift.joint is not None
    bodies = (*settings.tree.bodies[:3], replace(lift, joint=replace(lift.joint, stiffness=0.0)), settings.tree.bodies[4])
    with pytest.raises(PlantError, match="no elastic equilibrium") as refusal:
        Physics(replace(settings, tree=replace(settings.tree, bodies=bodies)))
    assert "lift" in str(refusal.value)
    assert "\n" not in str(refusal.value)


def test_what_is_applied_is_felt_until_the_next_sample_and_read_at_once() -> None:
    physics = Physics(block(), noise=False)
    physics.set_brakes(np.array([False]))
    physics.apply(np.array([4.0]))
    assert physics.latch().effort[0] == 4.0
    assert physics.latch().position[0] == 0.0
    physics.advance()
    assert physics.truth()["joint_speed"][0] == pytest.approx(4.0 / BLOCK_MASS_kg * PERIOD_s)


def test_encoders_count_from_the_place_of_power_on_and_from_the_joint_zero() -> None:
    physics = Physics(block(), noise=False)
    physics.place(np.array([0.12345]))
    assert physics.latch().position_counts[0] == 0
    assert physics.latch().link_counts[0] == np.floor(0.12345 / 2e-4 + 0.5)
    physics.set_brakes(np.array([False]))
    physics.apply(np.array([20.0]))
    for _ in range(64):
        physics.advance()
    moved = physics.truth()["joint_position"][0]
    assert moved == pytest.approx(0.12345 + 0.5 * 20.0 / BLOCK_MASS_kg * (64 * PERIOD_s) ** 2)
    assert physics.latch().position_counts[0] == np.floor(moved / 1e-4 + 0.5) - np.floor(0.12345 / 1e-4 + 0.5)
    assert physics.latch().position[0] == 1e-4 * np.floor(moved / 1e-4 + 0.5)


def test_the_imu_answers_a_step_of_acceleration_as_a_first_order_low_pass() -> None:
    physics = Physics(block(bandwidth_Hz=40.0), noise=False)
    physics.set_brakes(np.array([False]))
    physics.apply(np.array([6.0]))
    forces = []
    for _ in range(20):
        forces.append(physics.latch().imu[:3].copy())
        physics.advance()
    time_s = np.arange(20) * PERIOD_s
    expected = 6.0 / BLOCK_MASS_kg * (1.0 - np.exp(-2.0 * np.pi * 40.0 * time_s))
    np.testing.assert_allclose(np.array(forces)[:, 0], expected, rtol=0, atol=1e-12)
    np.testing.assert_allclose(np.array(forces)[:, 2], 9.81, rtol=1e-12)


def test_the_imu_follows_a_vibration_as_a_first_order_low_pass() -> None:
    stiffness = BLOCK_MASS_kg * (2.0 * np.pi * 5.0) ** 2
    physics = Physics(block(stiffness=stiffness, bandwidth_Hz=8.0), noise=False)
    physics.place(np.array([0.02]))
    physics.set_brakes(np.array([False]))
    forces = []
    for _ in range(256):
        forces.append(physics.latch().imu[0])
        physics.advance()
    time_s = np.arange(256) * PERIOD_s
    amplitude = -0.02 * (2.0 * np.pi * 5.0) ** 2 / (1.0 + 5.0j / 8.0)
    steady = np.real(amplitude * np.exp(2j * np.pi * 5.0 * time_s))
    expected = steady - steady[0] * np.exp(-2.0 * np.pi * 8.0 * time_s)
    np.testing.assert_allclose(forces, expected, rtol=0, atol=2e-4 * np.abs(amplitude))


def test_an_imu_without_a_low_pass_reads_the_instant_under_the_new_effort() -> None:
    physics = Physics(block(bandwidth_Hz=0.0), noise=False)
    physics.apply(np.array([6.0]))
    assert physics.latch().imu[0] == 0.0  # the brake holds
    physics.set_brakes(np.array([False]))
    assert physics.latch().imu[0] == pytest.approx(6.0 / BLOCK_MASS_kg)


def test_the_winding_warms_with_the_square_of_the_effort() -> None:
    physics = Physics(block(), noise=False)
    physics.apply(np.array([4.0]))
    for _ in range(512):
        physics.advance()
    assert physics.latch().temperature_degC[0] == pytest.approx(20.0 + 0.5 * 16.0 * (1.0 - np.exp(-2.0 / 3.0)), rel=1e-12)


def test_noise_has_the_rms_of_the_settings_and_none_without() -> None:
    noisy, silent = Physics(block(noise=0.3), seed=5), Physics(block(noise=0.3), seed=5, noise=False)
    readings = np.array([[*(latched := noisy.latch()).effort, *latched.imu] for _ in range(4000)])
    exact = silent.latch()
    deviations = readings - np.array([*exact.effort, *exact.imu])
    np.testing.assert_allclose(deviations.std(axis=0), 0.3, rtol=0.05)
    assert np.abs(np.corrcoef(deviations.T) - np.eye(7)).max() < 0.06
    assert np.array_equal(silent.latch().imu.copy(), silent.latch().imu)


def test_readings_are_rounded_to_the_resolution_after_the_noise() -> None:
    physics = Physics(block(noise=0.3, resolution=0.05), seed=1)
    latched = physics.latch()
    for values in (latched.effort, latched.imu):
        np.testing.assert_allclose(values / 0.05, np.round(values / 0.05), rtol=0, atol=1e-9)


def test_a_seed_repeats_a_run_to_the_bit_and_another_does_not(carm: PlantSettings) -> None:
    def readings(seed: int) -> np.ndarray:
        physics = Physics(carm, seed=seed)
        physics.set_brakes(np.array([False, False]))
        rows = []
        for k in range(50):
            physics.apply(np.array([np.sin(k / 5.0), 0.5]))
            latched = physics.latch()
            rows.append(np.concatenate([latched.position, latched.link_position, latched.effort, latched.imu]))
            physics.advance()
        return np.array(rows)

    assert np.array_equal(readings(3), readings(3))
    assert not np.array_equal(readings(3), readings(4))


def test_a_further_noisy_sensor_changes_no_other_channels_noise() -> None:
    one = Physics(block(noise=0.3), seed=9).latch()
    more = block(noise=0.3)
    second = replace(more.imus[0], name="second")
    other = Physics(replace(more, imus=(*more.imus, second)), seed=9).latch()
    assert np.array_equal(one.effort, other.effort)
    assert np.array_equal(one.imu, other.imu[:6])
    assert not np.array_equal(other.imu[:6], other.imu[6:])


def test_the_truth_holds_the_pose_of_a_watched_body() -> None:
    physics = Physics(block(), noise=False)
    physics.place(np.array([0.25]))
    np.testing.assert_allclose(physics.truth()["pose_block"], [0.25, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1], atol=1e-15)
