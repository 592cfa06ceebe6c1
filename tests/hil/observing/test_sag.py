"""The mount's sag, which no sensor tells at rest, is found from how the mount answers the drives: against a planar arc solved by hand."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.linalg import eigh

from controllers.models.chain import Chain
from controllers.models.modal import InertialSensor, ModalModel, basis_size, basis_values
from hil.observing.sag import with_sag

GRAVITY, TORQUE_PER_A = 9.81, 40.0
MOUNT_STIFFNESS, GEAR_STIFFNESS, LEVER = 4e6, 1e5, 1.2
MOUNT_INERTIA, ROTOR_INERTIA, ARC_INERTIA, ARC_MASS = 300.0, 60.0, 90.0, 400.0
CENTRE_OF_MASS, DETECTOR = np.array([0.004, -0.03]), np.array([0.1, 0.5])  # y, z from the driven axis
ALONG, VERTICAL_AXIS, VERTICAL_STIFFNESS, VERTICAL_INERTIA = 0.15, -0.7, 3e6, 250.0  # x of the arc's plane and of the vertical axis
HARMONICS = (5,)
POSES = np.linspace(-2.5, 2.5, 15)


def turned(vector: np.ndarray, angle: float) -> np.ndarray:
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]) @ vector


def rows_at(pose: float) -> np.ndarray:
    """The modal model's parameters from the equations of motion.

    Coordinates: turns of the mount, of the rotor and in the gear, and the mount's about the vertical.
    """
    com, detector = turned(CENTRE_OF_MASS, pose), turned(DETECTOR, pose)
    arc, vertical = np.array([1.0, 1.0, 1.0, 0.0]), np.array([0.0, 0.0, 0.0, 1.0])  # what turns it about x, and about z

    def moves(point: np.ndarray) -> np.ndarray:
        """(3, 4) of a point of the arc by the coordinates."""
        beside = LEVER * np.eye(4)[0] - point[1] * arc + (ALONG - VERTICAL_AXIS) * vertical
        return np.array([-point[0] * vertical, beside, point[0] * arc])

    mass = ARC_MASS * moves(com).T @ moves(com) + ARC_INERTIA * np.outer(arc, arc)
    mass += np.diag([MOUNT_INERTIA, ROTOR_INERTIA, 0.0, VERTICAL_INERTIA])
    squares, shapes = eigh(np.diag([MOUNT_STIFFNESS, 0.0, GEAR_STIFFNESS, VERTICAL_STIFFNESS]), mass)
    rows = []
    for square, shape in zip(squares[1:], shapes.T[1:], strict=True):
        shape = shape * np.sign(shape[1])
        shift = moves(detector) @ shape
        shift[1:] = turned(shift[1:], -pose)
        rows += [1.0 / square, 0.02 / np.sqrt(square), shape[1], shape[1] + shape[2]]
        rows += [*shift, arc @ shape, *turned(np.array([0.0, shape[3]]), -pose), TORQUE_PER_A * shape[1] / square]
    inertia = mass[1, 1]
    return np.array([*rows, TORQUE_PER_A / inertia, 0.0, -ARC_MASS * GRAVITY * com[0] / inertia, *np.zeros(3 + 6)])


def basis_at(poses: np.ndarray) -> np.ndarray:
    basis = np.zeros((len(poses), basis_size(HARMONICS)))
    for row, pose in zip(basis, poses, strict=True):
        basis_values(np.array(HARMONICS, dtype=np.int64), np.array([pose]), row)
    return basis


@pytest.fixture(scope="module")
def model() -> ModalModel:
    chain = Chain(np.array([[1.0, 0.0, 0.0]]), np.zeros((1, 3)), np.array([True]), np.array([0.0, 0.0, -GRAVITY]))
    end = np.array([ALONG, *DETECTOR])
    coefficients = np.linalg.lstsq(basis_at(POSES), np.array([rows_at(pose) for pose in POSES]), rcond=None)[0].T
    return ModalModel(
        axes=("arc",),
        chain=chain,
        sensors=(InertialSensor(end, end, np.eye(3), 0.0, ("ax", "ay", "az", "gx", "gy", "gz")),),
        source_end_m=-end,
        harmonics=HARMONICS,
        coefficients=np.ascontiguousarray(coefficients),
        sample_rate_Hz=256.0,
        effort_limit=np.array([5.0]),
        position_unit=("rad",),
    )


def sag_by_statics(pose: float) -> np.ndarray:
    """Shift of the detector in its frame by the mount's turn under the arc's weight."""
    com, detector = turned(CENTRE_OF_MASS, pose), turned(DETECTOR, pose)
    angle = -ARC_MASS * GRAVITY * com[0] / MOUNT_STIFFNESS
    return np.array([0.0, *turned(angle * np.array([LEVER - detector[1], detector[0]]), -pose)])


def test_a_mount_gives_way_to_gravity_as_it_does_to_the_drive(model: ModalModel) -> None:
    sagging, mount = with_sag(model, POSES[:, None], POSES[:, None], np.array([TORQUE_PER_A]))
    assert mount is not None
    assert mount.is_clear
    assert 1.0 / mount.compliance == pytest.approx(MOUNT_STIFFNESS, rel=0.02)
    assert mount.lever == pytest.approx(LEVER, rel=0.02)
    between = np.linspace(-2.3, 2.3, 9)
    found = np.array([sagging.at(np.array([pose]))[-6:-3] for pose in between])
    expected = np.array([sag_by_statics(pose) for pose in between])
    assert np.abs(expected).max() > 20e-6, "micrometres of sag are at stake"
    np.testing.assert_allclose(found, expected, atol=0.03 * np.abs(expected).max())


def test_what_is_not_told_stays_without_sag(model: ModalModel) -> None:
    gain = np.array([TORQUE_PER_A])
    upright = dataclasses.replace(model, chain=dataclasses.replace(model.chain, gravity_m_s2=np.array([-GRAVITY, 0.0, 0.0])))
    assert with_sag(upright, POSES[:, None], POSES[:, None], gain) == (upright, None)
    few = POSES[7:8, None]
    still, mount = with_sag(model, few, few, gain)
    assert still is model
    assert mount is not None
    assert not mount.is_clear
    assert "left out" in mount.note
