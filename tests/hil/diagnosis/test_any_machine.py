"""Open-loop machines, speed sensors and recordings that begin in motion, against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg

from hil.errors import MachineFileError
from hil.machine import Machine, load_machine, machine_from_text
from hil.machine.mjcf import to_mjcf
from hil.recording import Channel, Recording, recording_metadata
from hil.simulation import simulate
from virtual_bus.settings import EffectSetting

DRIVES = load_machine("coupled_electric_drives")
MOTOR = load_machine("laas_anti_cogging")


def driven(machine: Machine, command: np.ndarray, **initial: list[float]) -> Recording:
    axis, unit = machine.axes[0], machine.units[0].effort
    time = np.arange(len(command)) / machine.sample_rate_Hz
    channels = {"time": Channel("s", time), f"command_{axis}": Channel(unit, command)}
    return Recording(channels, recording_metadata(machine, initial=initial))


@pytest.mark.nightly
def test_a_speed_sensor_sees_the_sum_of_its_joints() -> None:
    """Two inertias and a spring under a held step: x_{k+1} = expm(A T) x_k + ..., the command of row k acting from row k + 1."""
    motor, pulley, damping, stiffness, belt_damping = 0.152696, 0.101969, 1.300002, 36.14939, 0.158459
    a = np.array(
        [
            [-(damping + belt_damping) / motor, belt_damping / motor, -stiffness / motor],
            [belt_damping / pulley, -belt_damping / pulley, stiffness / pulley],
            [1.0, -1.0, 0.0],
        ]
    )
    whole = scipy.linalg.expm(np.vstack([np.hstack([a, [[1.0 / motor], [0.0], [0.0]]]), np.zeros((1, 4))]) / DRIVES.sample_rate_Hz)
    command = np.concatenate([np.full(40, 1.5), np.full(40, -1.0)])
    state, expected, acting = np.zeros(3), [], 0.0
    for given in command:
        expected.append(state[1])
        state = whole[:3, :3] @ state + whole[:3, 3] * acting
        acting = given
    speed = simulate(DRIVES, driven(DRIVES, command))["speed_motors"]
    assert np.abs(speed - expected).max() < 2e-3 * np.abs(expected).max()


@pytest.mark.nightly
def test_a_speed_sensor_may_lose_its_sign() -> None:
    command = np.full(60, -1.0)
    lost = EffectSetting("rectified_sensor", "speed_motors", {"share": 1.0, "sign": 1.0})
    plain = simulate(DRIVES, driven(DRIVES, command))["speed_motors"]
    assert plain.min() < -0.5
    assert np.allclose(simulate(DRIVES, driven(DRIVES, command), (lost,))["speed_motors"], np.abs(plain))


def test_a_recording_may_begin_in_motion() -> None:
    """A rotor on a viscous bearing, left alone: its speed decays by exp(-b t / J)."""
    coasting = simulate(MOTOR, driven(MOTOR, np.zeros(120), speeds=[50.0]))
    time = coasting.time
    expected = 50.0 * np.exp(-0.0185 / 2.49e-4 * time)
    assert coasting["speed_rotor"][0] == 50.0
    assert np.abs(coasting["speed_rotor"] - expected).max() < 0.05
    assert coasting["position_rotor"][-1] == pytest.approx(50.0 * 2.49e-4 / 0.0185, rel=0.01)


def test_the_mjcf_has_the_speed_sensor_by_its_channels_name() -> None:
    text = to_mjcf(DRIVES.plant, DRIVES.name)
    assert '<tendonvel name="speed_motors" tendon="speed_motors"' in text


def test_a_speed_sensor_needs_the_axiss_own_joint() -> None:
    text = DRIVES.text.replace('joints = ["motors", "belt"]', 'joints = ["belt"]')
    with pytest.raises(MachineFileError, match=r"sensors\.speed_motors\.joints.*must contain the axis's joint motors"):
        machine_from_text(text)


def test_a_controller_needs_an_encoder() -> None:
    text = DRIVES.text + "\n[controller.motors]\nposition_sections = [[1.0, 0.0, 0.0, 1.0, 0.0, 0.0]]\n"
    with pytest.raises(MachineFileError, match=r"sensors\.position_motors.*every axis with a controller has a motor-side encoder"):
        machine_from_text(text)
