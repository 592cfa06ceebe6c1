"""What holds for every effect of the catalogue: it shows, it vanishes with its strength, and emulator and simulation agree on it."""

from __future__ import annotations

import numpy as np
import pytest
from effect_examples import EXAMPLES, POSE, ROWS, jog

from controllers.feedback import Feedback
from hil.machine import load_machine
from hil.simulation import Inputs, Outputs, Simulator
from virtual_bus.effects import catalogue
from virtual_bus.effects.registry import effects
from virtual_bus.physics import Physics
from virtual_bus.plant.compiled import compile_plant
from virtual_bus.sensors.effects import act_on_sensors, sensor_effects
from virtual_bus.settings import EffectSetting

CARM = load_machine("carm")
GROUPS = ("command", "effort", "position", "link_position", "imu")


@pytest.fixture(scope="module")
def simulator() -> Simulator:
    return Simulator(CARM)


@pytest.fixture(scope="module")
def inputs() -> Inputs:
    return jog(CARM.sample_rate_Hz)


@pytest.fixture(scope="module")
def plain(simulator: Simulator, inputs: Inputs) -> Outputs:
    return simulator.run(inputs, effects=())


def emulated(setting: EffectSetting, inputs: Inputs) -> dict[str, np.ndarray]:
    """The same loop run sample by sample on the emulator's physics, without noise."""
    plant = CARM.with_effects((setting,)).plant
    physics, feedback = Physics(plant, noise=False), Feedback(CARM.controllers)
    physics.place(inputs.start_pose)
    held = physics.holding_effort(inputs.start_pose).copy()
    physics.hold(held)
    feedback.preload(held, inputs.start_pose, inputs.feedforward[0])
    rows: dict[str, list[np.ndarray]] = {group: [] for group in GROUPS}
    resolution = np.array([drive.resolution for drive in plant.drives])
    for k in range(ROWS):
        physics.apply(resolution * np.floor(held / resolution + 0.5))
        latched = physics.latch()
        for group in GROUPS[1:]:
            rows[group].append(getattr(latched, group).copy())
        feedback.step(inputs.reference[k], latched.position, inputs.excitation[k], inputs.feedforward[k], held)
        rows["command"].append(held.copy())
        physics.advance()
    return {group: np.array(values) for group, values in rows.items()}


def test_there_is_an_example_of_every_effect() -> None:
    assert set(EXAMPLES) == set(effects())


@pytest.mark.slow
@pytest.mark.parametrize("name", EXAMPLES)
def test_emulator_and_simulation_agree(name: str, simulator: Simulator, inputs: Inputs) -> None:
    simulated = simulator.run(inputs, effects=(EXAMPLES[name],))
    for group, values in emulated(EXAMPLES[name], inputs).items():
        np.testing.assert_allclose(values, getattr(simulated, group), rtol=0, atol=1e-9, err_msg=group)


@pytest.mark.parametrize("name", EXAMPLES)
def test_it_shows_where_it_is_and_vanishes_bit_for_bit_with_its_strength(
    name: str, simulator: Simulator, inputs: Inputs, plain: Outputs
) -> None:
    setting = EXAMPLES[name]
    neutral = {p.name: p.neutral for p in effects()[name].parameters if p.is_strength}
    assert neutral
    without = simulator.run(inputs, effects=(EffectSetting(name, setting.at, setting.parameters | neutral),))
    having = simulator.run(inputs, effects=(setting,))
    for group in GROUPS:
        np.testing.assert_array_equal(getattr(without, group), getattr(plain, group), err_msg=group)
    assert any((getattr(having, group) != getattr(plain, group)).any() for group in GROUPS)
    assert all(np.isfinite(getattr(having, group)).all() for group in GROUPS)


@pytest.mark.slow
@pytest.mark.parametrize("name", EXAMPLES)
def test_it_needs_no_compilation(name: str) -> None:
    assert compile_plant(CARM.with_effects((EXAMPLES[name],)).plant).module is compile_plant(CARM.plant).module


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in EXAMPLES if not effects()[name].is_slow])  # those drift while a machine stands
def test_the_machine_stands_still_with_it_at_its_holding_effort(name: str) -> None:
    if name in ("base_motion", "encoder_quantization"):
        pytest.skip("it moves by itself, or is coarser than standstill")
    plant = CARM.with_effects((EXAMPLES[name],)).plant
    physics = Physics(plant, noise=False)
    physics.place(POSE)
    effort = physics.holding_effort(POSE)
    physics.hold(effort)
    before = physics.truth()["joint_position"]
    for _ in range(64):
        physics.apply(effort)
        physics.latch()
        physics.advance()
    if name != "current_saturation" or np.abs(effort).max() < EXAMPLES[name].parameters["imax"]:
        np.testing.assert_allclose(physics.truth()["joint_position"], before, rtol=0, atol=1e-9)


def test_the_catalogue_is_complete_for_a_reader() -> None:
    entries = {entry["name"]: entry for entry in catalogue()}
    assert len(entries) == len(EXAMPLES)
    for entry in entries.values():
        assert entry["equation"]
        assert entry["convention"]
        assert 0 < len(entry["plain"].split()) <= 25
        assert entry["plain"].endswith(".")
        assert entry["source"]
        assert entry["at"]
        assert set(entry["neighbours"]) <= set(entries)
        for parameter in entry["parameters"]:
            assert parameter["low"] < parameter["high"]
            assert parameter["key"].startswith(parameter["name"])


@pytest.mark.parametrize("name", sorted(EXAMPLES))
def test_sensors_are_told_of_the_effects_they_have_something_of_and_of_no_others(name: str) -> None:
    own, under = (sensor_effects(CARM.plant, chosen) for chosen in ((), (EXAMPLES[name],)))
    differs = any(not np.array_equal(one, other) for one, other in zip(own, under, strict=True))
    assert act_on_sensors([EXAMPLES[name]]) is differs
