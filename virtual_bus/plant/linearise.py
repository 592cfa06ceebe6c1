"""Gradients of a plant about rest: its inertia, and how its IMUs' channels change with motion."""

from __future__ import annotations

import numpy as np

from virtual_bus.plant.compiled import CompiledPlant
from virtual_bus.plant.statics import DIFFERENCE


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
