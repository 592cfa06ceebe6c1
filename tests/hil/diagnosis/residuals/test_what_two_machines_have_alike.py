"""What a machine does along a motion is the same where parts of it are taken from another machine: every effect, every number."""

from __future__ import annotations

import numpy as np
import pytest
from effect_examples import EXAMPLES

from hil.diagnosis.candidates.entries import Entry, effect_sought, entries, setting_of
from hil.diagnosis.observed.rows import observed
from hil.diagnosis.residuals.trajectory import Motion, Signals, Trajectory
from hil.machine import Machine, load_machine
from hil.recording import Channel, Recording, recording_metadata
from virtual_bus.effects.effect import CLOCK, FRICTION

TIME_s = np.arange(120) / 256.0
SEED = 5


@pytest.fixture(scope="module")
def carm() -> Machine:
    return load_machine("carm")


@pytest.fixture(scope="module")
def trajectory(carm: Machine) -> Trajectory:
    channels = {"time": Channel("s", TIME_s)}
    for k, axis in enumerate(carm.axes):
        position = 0.2 * np.sin(9.0 * TIME_s + k)
        channels |= {f"position_{axis}": Channel("rad", position), f"link_position_{axis}": Channel("rad", position)}
        channels[f"command_{axis}"] = Channel("A", 2.0 * np.cos(11.0 * TIME_s + k))
    channels |= {name: Channel("m/s^2", np.zeros(len(TIME_s))) for name in ("imu_x", "imu_y", "imu_z")}
    channels |= {name: Channel("rad/s", np.zeros(len(TIME_s))) for name in ("gyro_x", "gyro_y", "gyro_z")}
    return Trajectory(observed(carm, "run", Recording(channels, recording_metadata(carm))))


@pytest.fixture(scope="module")
def motion(trajectory: Trajectory) -> Motion:
    print(f"seed {SEED}")
    phases = np.random.default_rng(SEED).uniform(0.0, 6.0, len(trajectory.joints))
    sines, cosines = (wave(9.0 * TIME_s[:, None] + phases) for wave in (np.sin, np.cos))
    return Motion(0.2 * sines, 1.8 * cosines, -16.2 * sines, np.full_like(sines, 1e-3))


def assert_same(found: Signals, right: Signals) -> None:
    for name in ("needed", "given", "currents", "readings"):
        np.testing.assert_array_equal(getattr(found, name), getattr(right, name), err_msg=name)


def laws(trajectory: Trajectory, motion: Motion) -> list[Entry]:
    """Of all effects that a diagnosis looks for."""
    values = trajectory.plant.nominal
    inertias = trajectory.plant.inertias(trajectory.model(values), motion.position[0])
    missing = np.sin(motion.position * 40.0)[None]
    return list(entries([trajectory], [motion], [trajectory.signals(motion, trajectory.model(values))], values, [missing], inertias))


@pytest.mark.parametrize("name", EXAMPLES)
def test_with_the_example_of_any_effect(name: str, trajectory: Trajectory, motion: Motion) -> None:
    nominal, effect = trajectory.signals(motion, trajectory.model()), (EXAMPLES[name],)
    model = trajectory.model(None, effect)
    assert_same(trajectory.signals(motion, model, effect, nearby=nominal), trajectory.signals(motion, model, effect))


def test_only_what_the_search_was_measured_with_is_sought(trajectory: Trajectory, motion: Motion) -> None:
    axes = {drive.axis for drive in trajectory.settings.drives}
    for law in laws(trajectory, motion):
        assert law.effect.sought_at != ()
        if law.effect.kind in (FRICTION, CLOCK):
            assert (law.at in axes) == (law.effect.kind is FRICTION)
        for column in law.law.columns:
            assert column.get("Fs_minus_Fc", 0.0) >= 0.0
            assert column.get("k2", 0.0) == 0.0
    stribeck, spring = (effect_sought(name) for name in ("stribeck_friction", "nonlinear_stiffness"))
    assert stribeck.parameters[0].low == 0.0
    assert [each.name for each in spring.parameters if not each.fixed] == ["k3", "bend", "corner"]


def test_with_any_effect(trajectory: Trajectory, motion: Motion) -> None:
    values = trajectory.plant.nominal
    nominal = trajectory.signals(motion, trajectory.model(values))
    names = set()
    for law in laws(trajectory, motion):
        for parameters in law.law.columns:
            effect = (setting_of(law.effect, law.at, dict(parameters)),)
            model = trajectory.model(values, effect)
            assert_same(trajectory.signals(motion, model, effect, nearby=nominal), trajectory.signals(motion, model, effect))
            names.add(law.effect.name)
    assert {"coulomb_friction", "imu_misalignment", "imu_bandwidth", "payload", "delay", "current_saturation", "structural_mode"} <= names


def test_with_other_numbers(trajectory: Trajectory, motion: Motion) -> None:
    nominal = trajectory.signals(motion, trajectory.model())
    for k in range(len(trajectory.plant.nominal)):
        values = trajectory.plant.nominal
        values[k] = 1.1 * values[k] + 1e-6
        model = trajectory.model(values)
        assert_same(trajectory.signals(motion, model, nearby=nominal), trajectory.signals(motion, model))
