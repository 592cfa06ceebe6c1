"""The plant as a linear system about a pose, for its frequency responses."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from virtual_bus.effects.places import imu_channel_names
from virtual_bus.plant.compiled import CompiledPlant
from virtual_bus.plant.statics import DIFFERENCE, equilibrium, static_stiffness

if TYPE_CHECKING:
    import control


@dataclass(frozen=True, eq=False)
class LinearPlant:
    """x' = A x + B u, y = C x + D u, and the names of u, y and x."""

    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    D: np.ndarray
    input_labels: tuple[str, ...]
    output_labels: tuple[str, ...]
    state_labels: tuple[str, ...]

    def state_space(self) -> control.StateSpace:
        """Return the same system for python-control.

        python-control is imported here because it takes as long to load as everything else together.
        """
        import control

        return control.ss(
            self.A, self.B, self.C, self.D,
            inputs=list(self.input_labels), outputs=list(self.output_labels), states=list(self.state_labels), name="plant",
        )  # fmt: skip


def inertia_matrix(plant: CompiledPlant, model: np.ndarray, joint_positions: np.ndarray) -> np.ndarray:
    """Return the joint-space inertia M(q) (n, n), armature included."""
    return plant.inertia_and_bias(model, joint_positions, np.zeros(plant.joints))[0]


def imu_gradients(plant: CompiledPlant, model: np.ndarray, joint_positions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return how the IMUs' unfiltered channels change with the joints' motion, at rest.

    The three gradients (6 imus, n) are those with joint positions, speeds and accelerations.
    """
    n = plant.joints
    rest = np.vstack([joint_positions, np.zeros(n), np.zeros(n)])
    gradients = []
    for which in range(3):
        gradient = np.zeros((6 * len(plant.settings.imus), n))
        for j in range(n):
            shift = np.zeros((3, n))
            shift[which, j] = DIFFERENCE
            gradient[:, j] = (plant.imu_motion(model, *(rest + shift)) - plant.imu_motion(model, *(rest - shift))) / (2.0 * DIFFERENCE)
        gradients.append(gradient)
    return gradients[0], gradients[1], gradients[2]


def linearised(plant: CompiledPlant, model: np.ndarray, axis_positions: np.ndarray, *, by_joint: bool = False) -> LinearPlant:
    """Return the plant for small motions about rest at these axis positions (axes,).

    Actuated joints are free; friction effects and brakes are left out. Inputs are `command_<axis>` in the drives' units, or with `by_joint`
    `effort_<joint>` [Nm or N] on every joint. Outputs have the names of the recording channels: every encoder and speed sensor, then imu_x,
    imu_y, imu_z, gyro_x, gyro_y, gyro_z of every IMU after its low passes. States are joint positions, joint speeds and the low passes.
    """
    settings, n = plant.settings, plant.joints
    q = equilibrium(plant, model, axis_positions)
    inverse = np.linalg.inv(inertia_matrix(plant, model, q))
    names = [f"effort_{joint.name}" for joint in settings.tree.joints] if by_joint else [f"command_{d.axis}" for d in settings.drives]
    gain = np.eye(n) if by_joint else np.zeros((n, len(names)))
    if not by_joint:
        gain[list(plant.joint_of_axis().values()), np.arange(len(settings.drives))] = plant.drive_gains(model, q)
    to_acceleration = np.hstack([-inverse @ static_stiffness(plant, model, q), -inverse * model["damping"][0]])
    a = np.vstack([np.hstack([np.zeros((n, n)), np.eye(n)]), to_acceleration])
    b = np.vstack([np.zeros((n, gain.shape[1])), inverse @ gain])

    encoders = np.zeros((len(settings.encoders) + len(settings.speeds), 2 * n))
    for row, encoder in zip(encoders, settings.joint_sensors, strict=True):
        for joint in encoder.joints:
            row[settings.tree.joint_index(joint) + (n if encoder in settings.speeds else 0)] += 1.0
    by_position, by_speed, by_acceleration = imu_gradients(plant, model, q)
    imu = np.hstack([by_position, by_speed]) + by_acceleration @ to_acceleration
    imu_direct = by_acceleration @ b[n:]

    is_filtered = model["is_filtered"][0, : len(imu)] > 0
    filtered = np.flatnonzero(is_filtered)
    lags, squares = model["filter_lag"][0, filtered].T
    second = np.flatnonzero(squares > 0.0)  # of the filtered ones: their rates of change are states too
    pull = 1.0 / np.where(squares > 0.0, squares, lags)  # of the input on the last derivative
    many, more = len(filtered), len(second)
    to_rate = np.eye(many)[second]
    is_first = np.where(squares > 0.0, 0.0, 1.0)
    low_passes = np.block([
        [-np.diag(is_first * pull), to_rate.T],
        [-pull[second, None] * to_rate, -np.diag((lags * pull)[second])],
    ])  # fmt: skip
    driven = np.vstack([np.diag(is_first * pull), pull[second, None] * to_rate])
    a = np.block([[a, np.zeros((2 * n, many + more))], [driven @ imu[filtered], low_passes]])
    b = np.vstack([b, driven @ imu_direct[filtered]])
    imu_from_filter = np.zeros((len(imu), many + more))
    imu_from_filter[filtered, np.arange(many)] = 1.0
    imu_from_motion = np.where(is_filtered[:, None], 0.0, imu)
    c = np.block([[encoders, np.zeros((len(encoders), many + more))], [imu_from_motion, imu_from_filter]])
    d = np.vstack([np.zeros((len(encoders), gain.shape[1])), np.where(is_filtered[:, None], 0.0, imu_direct)])

    channels = imu_channel_names(plant.settings)
    joints = [joint.name for joint in settings.tree.joints]
    states = joints + [f"{joint}_speed" for joint in joints]
    states += [f"{channels[k]}_filter" for k in filtered] + [f"{channels[k]}_filter_rate" for k in filtered[second]]
    outputs = [sensor.channel for sensor in settings.joint_sensors] + channels
    return LinearPlant(a, b, c, d, tuple(names), tuple(outputs), tuple(states))
