"""The model of (5.37): quasi-static kinematics whose elastic joints swing as modes, and what an inertial sensor on the panel measures.

    y = M_qs(q, ξ) + C(q) η,     η'' = -Ω² η - 2 Z Ω η' + B u / μ                                  (5.30), (5.37)

q are the axes' positions, ξ the parameters of `FlexibleChain` (Denavit-Hartenberg with gear ratios, focal spot, compliances). A mode is
the swing of one elastic joint, so C(q) is how source, phantom and rotation change with that joint's deflection, in any pose, and no mode
shape has to be fitted. The world is the phantom's frame.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from controllers.models.flexible_chain import FlexibleChain

STENCIL_s = 1e-3
"""Half the span over which a sensor's motion is differenced: a pose is exact to 1e-16 m, so an acceleration to 1e-9 m/s^2."""


@dataclass(frozen=True)
class PanelImu:
    """An inertial sensor on the panel.

    Attributes
    ----------
    position_m : (3,) array
        In the panel's frame.
    orientation : (3, 3) array
        From the sensor's axes to the panel's.
    """

    position_m: np.ndarray
    orientation: np.ndarray


@dataclass(frozen=True)
class Readings:
    """What the sensor measures at N instants while no mode swings, and how that changes: specific force [m/s^2], then rates [rad/s].

    Attributes
    ----------
    values : (N, 6) array
    by_position, by_speed, by_acceleration : (N, 6, axes + modes) arrays
        Per position, speed and acceleration of the axes, then of the modes.
    by_parameter : (N, 6, p) array
    """

    values: np.ndarray
    by_position: np.ndarray
    by_speed: np.ndarray
    by_acceleration: np.ndarray
    by_parameter: np.ndarray


def readings(
    chain: FlexibleChain, imu: PanelImu, positions: np.ndarray, speeds: np.ndarray, accelerations: np.ndarray, gravity_m_s2: np.ndarray
) -> Readings:
    """Return what the sensor measures along a motion (N, axes) in rad, rad/s, rad/s^2, and its derivatives.

    The three poses an instant before, at and after each sample are differenced; so are their Jacobians, which are exact.
    """
    n, p = len(positions), len(chain.names)
    h = STENCIL_s
    at = np.concatenate([positions + step * speeds + 0.5 * step * step * accelerations for step in (-h, 0.0, h)])
    (_, phantom, rotation), jacobian = chain.poses_and_jacobian(at)
    arm, back = imu.position_m - phantom, np.swapaxes(rotation, 1, 2)
    moves = back @ (_cross_matrix(arm) @ jacobian[:, 6:] - jacobian[:, 3:6])
    place = ((back @ arm[..., None])[..., 0]).reshape(3, n, 3)
    to_panel, turned = rotation.reshape(3, n, 3, 3), back.reshape(3, n, 3, 3)
    panel_turns, sensor_moves = jacobian[:, 6:].reshape(3, n, 3, -1), moves.reshape(3, n, 3, -1)
    force = (to_panel[1] @ ((place[2] - 2.0 * place[1] + place[0]) / h**2 - gravity_m_s2)[..., None])[..., 0]
    between = to_panel[2] @ turned[0]
    passed = Rotation.from_matrix(between).as_rotvec()
    rate = -passed / (2.0 * h)
    as_vector = np.eye(3) - 0.5 * _cross_matrix(passed)  # how a small rotation vector changes with a turn behind it

    def slopes(before: float, now: float, after: float) -> np.ndarray:
        """Return the change of the readings where the three poses change by these shares of a parameter."""
        moved = (after * sensor_moves[2] - 2.0 * now * sensor_moves[1] + before * sensor_moves[0]) / h**2
        of_force = to_panel[1] @ moved - now * (_cross_matrix(force) @ panel_turns[1])
        of_rate = -as_vector @ (after * panel_turns[2] - before * (between @ panel_turns[0])) / (2.0 * h)
        return np.concatenate([_seen_by(imu, of_force), _seen_by(imu, of_rate)], axis=1)

    still = slopes(1.0, 1.0, 1.0)
    return Readings(
        values=np.concatenate([force @ imu.orientation, rate @ imu.orientation], axis=1).reshape(n, 6),
        by_position=still[:, :, p:],
        by_speed=slopes(-h, 0.0, h)[:, :, p:],
        by_acceleration=slopes(0.5 * h * h, 0.0, 0.5 * h * h)[:, :, p:],
        by_parameter=still[:, :, :p],
    )


def swing_step(omega: np.ndarray, damping: np.ndarray, seconds: float) -> tuple[np.ndarray, np.ndarray]:
    """Return Φ (..., m, 2, 2) and Γ (..., m, 2) of modes η'' = -ω² η - 2 ζ ω η' + f over a time, exact while f is held (5.30).

    Parameters
    ----------
    omega, damping : (..., m) arrays
        Natural frequency [rad/s], and ratio below 1.
    seconds : float
    """
    decay, turning = damping * omega, omega * np.sqrt(np.maximum(1.0 - damping**2, 1e-12))
    e, c = np.exp(-decay * seconds), np.cos(turning * seconds)
    s = np.sin(turning * seconds) / turning
    first = e * (c + decay * s)
    phi, gamma = np.empty((*first.shape, 2, 2)), np.empty((*first.shape, 2))
    phi[..., 0, 0], phi[..., 0, 1] = first, e * s
    phi[..., 1, 0], phi[..., 1, 1] = -(omega**2) * e * s, e * (c - decay * s)
    gamma[..., 0], gamma[..., 1] = (1.0 - first) / omega**2, e * s
    return phi, gamma


def _seen_by(imu: PanelImu, vectors: np.ndarray) -> np.ndarray:
    turned: np.ndarray = imu.orientation.T @ vectors
    return turned


def _cross_matrix(vectors: np.ndarray) -> np.ndarray:
    """Return matrices (N, 3, 3) whose product with a vector is the cross product with it."""
    result = np.zeros((len(vectors), 3, 3))
    x, y, z = vectors.T
    result[:, 0, 1], result[:, 0, 2], result[:, 1, 2] = -z, y, -x
    result[:, 1, 0], result[:, 2, 0], result[:, 2, 1] = z, -y, x
    return result
