"""Small motions of a tree of rigid bodies from its energies alone: an independent witness for natural frequencies and holding efforts.

The mass matrix comes from body Jacobians, the stiffness from springs and the differences of gravity efforts. It shares nothing with
the project's plant but the settings it reads.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from virtual_bus.settings import PlantSettings, Tree

STEP = 1e-5
MOST_STEPS = 30
AT_REST = 1e-13
"""rad or m by which the last Newton step moves a joint: what is left is rounding."""


def _poses(tree: Tree, q: np.ndarray) -> dict[str, tuple[np.ndarray, np.ndarray, list[tuple[int, str, np.ndarray, np.ndarray]]]]:
    """Per body: rotation, origin, and the (joint number, kind, axis, origin) of every joint above it, all in the world."""
    poses = {"world": (np.eye(3), np.zeros(3), [])}
    number = 0
    for body in tree.bodies:
        rotation, origin, chain = poses[body.parent]
        origin = origin + rotation @ body.position_m
        rotation = rotation @ body.orientation
        if body.joint is not None:
            axis = rotation @ body.joint.axis
            chain = [*chain, (number, body.joint.kind, axis, origin)]
            if body.joint.kind == "revolute":
                rotation = rotation @ Rotation.from_rotvec(body.joint.axis * q[number]).as_matrix()
            else:
                origin = origin + axis * q[number]
            number += 1
        poses[body.name] = rotation, origin, chain
    return poses


def _jacobians(
    pose: tuple[np.ndarray, np.ndarray, list[tuple[int, str, np.ndarray, np.ndarray]]], point: np.ndarray, joints: int
) -> tuple[np.ndarray, np.ndarray]:
    rotation, origin, chain = pose
    place = origin + rotation @ point
    linear, angular = np.zeros((3, joints)), np.zeros((3, joints))
    for number, kind, axis, hinge in chain:
        if kind == "revolute":
            linear[:, number] = np.cross(axis, place - hinge)
            angular[:, number] = axis
        else:
            linear[:, number] = axis
    return linear, angular


def mass_matrix(tree: Tree, q: np.ndarray) -> np.ndarray:
    joints = tree.joints
    mass = np.diag([joint.armature for joint in joints]).astype(float)
    poses = _poses(tree, q)
    for body in tree.bodies:
        linear, angular = _jacobians(poses[body.name], body.center_of_mass_m, len(joints))
        rotation = poses[body.name][0]
        mass += body.mass_kg * linear.T @ linear + angular.T @ rotation @ body.inertia_kg_m2 @ rotation.T @ angular
    return mass


def gravity_effort(tree: Tree, q: np.ndarray) -> np.ndarray:
    """Generalised force of gravity on the joints."""
    poses = _poses(tree, q)
    effort = np.zeros(len(q))
    for body in tree.bodies:
        linear, _ = _jacobians(poses[body.name], body.center_of_mass_m, len(q))
        effort += body.mass_kg * linear.T @ tree.gravity_m_s2
    return effort


def stiffness_matrix(tree: Tree, q: np.ndarray) -> np.ndarray:
    columns = []
    for number in range(len(q)):
        shift = np.eye(len(q))[number] * STEP
        columns.append((gravity_effort(tree, q - shift) - gravity_effort(tree, q + shift)) / (2.0 * STEP))
    return np.array(columns).T + np.diag([joint.stiffness for joint in tree.joints])


def standstill(settings: PlantSettings, axis_positions: np.ndarray | tuple[float, float]) -> tuple[np.ndarray, np.ndarray]:
    """Joint positions in elastic equilibrium and the drives' holding efforts."""
    tree = settings.tree
    driven = [tree.joint_index(drive.joint) for drive in settings.drives]
    free = [number for number in range(len(tree.joints)) if number not in driven]
    spring = np.array([joint.stiffness for joint in tree.joints])
    rest = np.array([joint.rest_position for joint in tree.joints])
    q = np.zeros(len(tree.joints))
    q[driven] = axis_positions
    for _ in range(MOST_STEPS):
        residual = gravity_effort(tree, q) - spring * (q - rest)
        change = np.linalg.solve(stiffness_matrix(tree, q)[np.ix_(free, free)], residual[free])
        q[free] += change
        if np.abs(change).max(initial=0.0) < AT_REST:
            break
    else:
        raise AssertionError(f"no equilibrium: joints still change by {np.abs(change).max():g}")
    residual = gravity_effort(tree, q) - spring * (q - rest)
    return q, -residual[driven] / [drive.constant * drive.ratio for drive in settings.drives]


def modes(settings: PlantSettings, axis_positions: np.ndarray | tuple[float, float]) -> list[tuple[float, float]]:
    """Frequency [Hz] and damping ratio of every oscillation, rising."""
    tree = settings.tree
    q, _ = standstill(settings, axis_positions)
    inverse = np.linalg.inv(mass_matrix(tree, q))
    damping = np.diag([joint.damping for joint in tree.joints])
    n = len(q)
    poles = np.linalg.eigvals(np.block([[np.zeros((n, n)), np.eye(n)], [-inverse @ stiffness_matrix(tree, q), -inverse @ damping]]))
    poles = poles[poles.imag > 0.0]
    return sorted((abs(pole) / (2.0 * np.pi), -pole.real / abs(pole)) for pole in poles)
