"""The plant as a linear system about a pose: what its frequency responses should be."""

from __future__ import annotations

import control
import numpy as np

from virtual_bus.plant.compiled import CompiledPlant
from virtual_bus.plant.model import Model
from virtual_bus.plant.parameters import AXES
from virtual_bus.plant.statics import DIFFERENCE, equilibrium, static_stiffness


def inertia_matrix(plant: CompiledPlant, model: Model, joint_positions: np.ndarray) -> np.ndarray:
    """Joint-space inertia M(q) (n, n), armature included."""
    n = plant.joints
    mass, bias = np.zeros((n, n)), np.zeros(n)
    plant.mass_and_bias(np.ascontiguousarray(joint_positions, dtype=float), np.zeros(n), model.constants, mass, bias)
    return np.tril(mass) + np.tril(mass, -1).T


def imu_gradients(plant: CompiledPlant, model: Model, joint_positions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Gradients (6 imus, n) of the IMUs' unfiltered channels with joint positions, speeds and accelerations, at rest."""
    n = plant.joints
    rest = (joint_positions, np.zeros(n), np.zeros(n))
    gradients = []
    for which in range(3):
        gradient = np.zeros((6 * len(plant.settings.imus), n))
        for j in range(n):
            ahead, behind = np.zeros(len(gradient)), np.zeros(len(gradient))
            for reading, sign in ((ahead, 1.0), (behind, -1.0)):
                motion = [part.copy() for part in rest]
                motion[which][j] += sign * DIFFERENCE
                plant.imu(*motion, model.constants, reading)
            gradient[:, j] = (ahead - behind) / (2.0 * DIFFERENCE)
        gradients.append(gradient)
    return gradients[0], gradients[1], gradients[2]


def linearised(plant: CompiledPlant, model: Model, axis_positions: np.ndarray) -> control.StateSpace:
    """Small motions about rest at these axis positions (axes,), actuated joints free, without friction effects and brakes.

    Inputs are `command_<axis>` in the drives' units. Outputs bear the recording channels' names: every encoder, then imu_x, imu_y, imu_z, gyro_x,
    gyro_y, gyro_z of every IMU after its low passes. States are joint positions, joint speeds and the low passes.
    """
    settings, n = plant.settings, plant.joints
    q = equilibrium(plant, model, axis_positions)
    inverse = np.linalg.inv(inertia_matrix(plant, model, q))
    gain = np.zeros((n, len(settings.drives)))
    gain[list(plant.joint_of_axis().values()), np.arange(len(settings.drives))] = model.effort_gain
    to_acceleration = np.hstack([-inverse @ static_stiffness(plant, model, q), -inverse * model.damping])
    a = np.vstack([np.hstack([np.zeros((n, n)), np.eye(n)]), to_acceleration])
    b = np.vstack([np.zeros((n, gain.shape[1])), inverse @ gain])

    encoders = np.zeros((len(settings.encoders), 2 * n))
    for row, encoder in zip(encoders, settings.encoders, strict=True):
        for joint in encoder.joints:
            row[settings.tree.joint_index(joint)] += 1.0
    by_position, by_speed, by_acceleration = imu_gradients(plant, model, q)
    imu = np.hstack([by_position, by_speed]) + by_acceleration @ to_acceleration
    imu_direct = by_acceleration @ b[n:]

    filtered = np.flatnonzero(model.is_filtered)
    rates = np.array([_low_pass_rate(model, k) for k in filtered])
    a = np.block([[a, np.zeros((2 * n, len(filtered)))], [rates[:, None] * imu[filtered], -np.diag(rates)]])
    b = np.vstack([b, rates[:, None] * imu_direct[filtered]])
    imu_from_filter = np.zeros((len(imu), len(filtered)))
    imu_from_filter[filtered, np.arange(len(filtered))] = 1.0
    imu_from_motion = np.where(model.is_filtered[:, None], 0.0, imu)
    c = np.block([[encoders, np.zeros((len(encoders), len(filtered)))], [imu_from_motion, imu_from_filter]])
    d = np.vstack([np.zeros((len(encoders), gain.shape[1])), np.where(model.is_filtered[:, None], 0.0, imu_direct)])

    channels = imu_channels(plant)
    joints = [joint.name for joint in settings.tree.joints]
    return control.ss(
        a, b, c, d,
        inputs=[f"command_{drive.axis}" for drive in settings.drives],
        outputs=[encoder.channel for encoder in settings.encoders] + channels,
        states=joints + [f"{joint}_speed" for joint in joints] + [f"{channels[k]}_filter" for k in filtered],
        name="plant",
    )  # fmt: skip


def imu_channels(plant: CompiledPlant) -> list[str]:
    """Channel names of all IMUs in the order of their readings: imu_x, imu_y, imu_z, gyro_x, ... for the one called `imu`."""
    names = []
    for imu in plant.settings.imus:
        gyro = "gyro" if imu.name == "imu" else f"{imu.name}_gyro"
        names += [f"{imu.name}_{axis}" for axis in AXES] + [f"{gyro}_{axis}" for axis in AXES]
    return names


def _low_pass_rate(model: Model, channel: int) -> float:
    """Corner [rad/s] of a channel's low pass."""
    return -float(np.log(model.filter_weights[channel, 0])) / model.step_s
