"""Every effect of the catalogue stands in the linear model as small motions of the emulated machine show it, or is named as left out.

The response is taken from the emulator alone: what a small pulse of one command changes of every reading, summed up as a transfer function
at points beside the imaginary axis, where it converges though the joints are free.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from effect_examples import EXAMPLES, POSE

from hil.machine import load_machine
from virtual_bus.effects.registry import effects
from virtual_bus.linear.left_out import left_out
from virtual_bus.linear.sampled import SampledPlant
from virtual_bus.physics import Physics
from virtual_bus.settings import EffectSetting, PlantSettings

CARM = load_machine("carm")
CHANNELS = (
    "position_propeller", "position_roll", "link_position_propeller", "link_position_roll",
    "imu_x", "imu_y", "imu_z", "gyro_x", "gyro_y", "gyro_z",
)  # fmt: skip
ROWS = 120
FADING_1_s = 60.0
"""Real part of the points: what happens after all rows counts e^-28."""
FREQUENCIES_Hz = np.geomspace(0.5, 60.0, 25)
PULSE = 1e-3
HELD = {
    **EXAMPLES,
    "cable_spring": EffectSetting("cable_spring", "propeller", {"kc": 1200.0, "kc3": 3000.0, "theta0": -0.2}),
    "constant_load": EffectSetting("constant_load", "roll", {"tau0": 300.0}),
    "clock_offset": EffectSetting("clock_offset", "roll", {"t0": 0.0151, "delta": 0.0}),
    "cogging": EffectSetting("cogging", "roll", {"Np": 0.3, "A1": 60.0, "phi1": 0.2, "A2": 3.0, "phi2": 0.0}),
    "creep": EffectSetting("creep", "roll", {"k1": 9000.0, "tau": 0.1}),
    "delay": EffectSetting("delay", "roll", {"Td": 0.0163}),
    "encoder_eccentricity": EffectSetting("encoder_eccentricity", "position_roll", {"a": 0.03, "phi": 0.3, "b": 1e-4, "Nl": 40.0}),
    "end_stop": EffectSetting("end_stop", "roll", {"K": 2e4, "D": 50.0, "at_position": -0.34, "side": -1.0}),
    "gravity_imbalance": EffectSetting("gravity_imbalance", "propeller", {"mgr": 3000.0, "phi": 0.2}),
    "rectified_sensor": EffectSetting("rectified_sensor", "position_roll", {"share": 0.0, "sign": -1.0}),
    "shared_motor_friction": EffectSetting("shared_motor_friction", "propeller", {"Fc": 0.0, "Fv": 300.0, "c": 0.7}),
    "temperature_dependent_friction": EffectSetting(
        "temperature_dependent_friction", "roll", {"Fv0": 600.0, "a": 0.0, "R": 0.0, "tau": 3.0}
    ),
    "transmission_error": EffectSetting("transmission_error", "roll", {"k": 0.5, "e1": 5e-4, "phi1": 0.1, "e2": 1e-5, "phi2": 0.0}),
    "viscous_friction": EffectSetting("viscous_friction", "roll", {"Fv": 600.0}),
}
"""Parts that are held: what of an example is left out is at nothing here, and what would not show at rest in this pose does."""


def without_lattices(effects: tuple[EffectSetting, ...]) -> PlantSettings:
    plant = CARM.plant
    encoders = tuple(replace(each, resolution=0.0) for each in plant.encoders)
    imus = tuple(replace(each, accelerometer_resolution_m_s2=0.0, gyro_resolution_rad_s=0.0) for each in plant.imus)
    return replace(plant, encoders=encoders, imus=imus, effects=effects)


def readings(physics: Physics, pulsed: int | None) -> np.ndarray:
    """Of all channels (ROWS, 10), held at POSE, with a pulse in command 0 of one axis."""
    physics.place(POSE)
    held = physics.holding_effort(POSE)
    physics.hold(held)
    rows = []
    for k in range(ROWS):
        command = held.copy()
        if k == 1 and pulsed is not None:  # command 0 acts from row 1 on
            command[pulsed] += PULSE
        physics.apply(command)
        latched = physics.latch()
        rows.append(np.concatenate([latched.position, latched.link_position, latched.imu]))
        physics.advance()
    return np.array(rows)


def emulated_response(settings: PlantSettings) -> np.ndarray:
    """From commands to channels (25, 10, 2), as the emulator's readings change by a pulse."""
    physics = Physics(settings, noise=False)
    still = readings(physics, None)
    weights = points()[:, None] ** -np.arange(ROWS)
    return np.stack([weights @ (readings(physics, axis) - still) / PULSE for axis in range(2)], axis=-1)


def points() -> np.ndarray:
    return np.exp((FADING_1_s + 2j * np.pi * FREQUENCIES_Hz) / 256.0)


def linear_response(plant: SampledPlant) -> np.ndarray:
    return np.array([plant.c @ np.linalg.solve(z * np.eye(len(plant.a)) - plant.a, plant.b) for z in points()])


def plain_settings() -> PlantSettings:
    return without_lattices(())


@pytest.fixture(scope="module")
def plain_emulated() -> np.ndarray:
    return emulated_response(plain_settings())


@pytest.fixture(scope="module")
def plain_linear() -> np.ndarray:
    return linear_response(Physics(plain_settings(), noise=False).sampled(POSE, CHANNELS))


def relative(change: np.ndarray, of: np.ndarray) -> float:
    """Return the largest change over what each channel has at that frequency by either axis."""
    size = np.abs(of).max(axis=2, keepdims=True)
    return float((np.abs(change) / np.maximum(size, 1e-6 * size.max(axis=0))).max())


HAVE_A_LINEAR_PART = [name for name, effect in effects().items() if not effect.left_out or effect.left_out_of]
BESIDE = {"constant_load": (EffectSetting("torque_ripple", "roll", {"Np": 0.1, "A1": 0.3, "phi1": 1.2, "A2": 0.0, "phi2": 0.0}),)}
"""Effects with which another one shows: of a load no more changes than the current that holds it, and so how much that ripples."""


def test_without_effects_the_linear_model_is_the_emulator_s(plain_linear: np.ndarray, plain_emulated: np.ndarray) -> None:
    assert relative(plain_linear - plain_emulated, plain_emulated) < 0.02  # the emulator's plant steps of a millisecond


@pytest.mark.parametrize("name", HAVE_A_LINEAR_PART)
def test_an_effect_changes_the_linear_model_as_it_changes_small_motions(
    name: str, plain_linear: np.ndarray, plain_emulated: np.ndarray
) -> None:
    beside = BESIDE.get(name, ())
    if beside:
        settings = without_lattices(beside)
        plain_emulated, plain_linear = emulated_response(settings), linear_response(Physics(settings, noise=False).sampled(POSE, CHANNELS))
    settings = without_lattices((*beside, HELD[name]))
    linear = Physics(settings, noise=False).sampled(POSE, CHANNELS)
    assert not linear.left_out
    seen = emulated_response(settings)
    change, shown = linear_response(linear) - plain_linear, seen - plain_emulated
    size = relative(shown, seen)
    assert size > 3e-3
    assert relative(change - shown, seen) < 0.03 * size


@pytest.mark.parametrize("delay_s", [0.0, 0.0013, 0.0163])
def test_an_accelerometer_without_a_low_pass_feels_a_late_drive_as_it_acts_at_the_sync(delay_s: float) -> None:
    settings = without_lattices((EffectSetting("delay", "roll", {"Td": delay_s}),) if delay_s else ())
    settings = replace(settings, imus=tuple(replace(imu, accelerometer_bandwidth_Hz=0.0) for imu in settings.imus))
    seen = emulated_response(settings)[:, 4:7]
    shown = linear_response(Physics(settings, noise=False).sampled(POSE, CHANNELS))[:, 4:7]
    assert relative(shown - seen, seen) < 0.02


@pytest.mark.parametrize("name", [name for name in EXAMPLES if effects()[name].left_out])
def test_what_the_linear_model_leaves_out_is_named_and_not_in_it(name: str, plain_linear: np.ndarray) -> None:
    setting = EXAMPLES[name]
    found = Physics(without_lattices((setting,)), noise=False).sampled(POSE, CHANNELS)
    assert [(each.name, each.at) for each in found.left_out] == [(name, setting.at)]
    assert found.left_out[0].why
    if not effects()[name].left_out_of:
        np.testing.assert_array_equal(linear_response(found), plain_linear)


@pytest.mark.parametrize("name", [name for name in EXAMPLES if effects()[name].left_out])
def test_of_an_effect_that_does_nothing_nothing_is_left_out(name: str) -> None:
    effect, setting = effects()[name], EXAMPLES[name]
    nothing = {each.name: each.neutral for each in effect.parameters if each.is_strength}
    assert left_out([replace(setting, parameters={**setting.parameters, **nothing})]) == ()
