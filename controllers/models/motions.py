"""A chain of elementary motions: its frames, and how its end moves with the parameters of the motions."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

X, Y, Z = np.eye(3)
ORIGIN = np.zeros(3)


class Motion(NamedTuple):
    """A turn about a line or a shift along a direction, of N poses at once."""

    turns: bool
    axis: np.ndarray  # (3,) unit vector
    amount: np.ndarray  # (N,) [rad or m]
    parameters: tuple[tuple[int, np.ndarray | float], ...]  # parameter's number, d amount / d parameter, (N,) or one number
    point: np.ndarray = ORIGIN  # (3,) on the line [m]


def frames_of(motions: Sequence[Motion], count: int) -> list[np.ndarray]:
    """Return the frame (N, 4, 4) before each motion and after the last, seen from the first."""
    frames = [np.broadcast_to(np.eye(4), (count, 4, 4))]
    for step in _transforms(motions, count):
        frames.append(frames[-1] @ step)
    return frames


def motion_jacobian(motions: Sequence[Motion], frames: Sequence[np.ndarray], end: np.ndarray, parameters: int) -> np.ndarray:
    """Return the change (N, 6, p) per parameter of the point `end` (N, 3) [m], then of the orientation behind it [rad].

    Both are seen from the first frame.
    """
    result = np.zeros((len(end), 6, parameters))
    moved = [(motion, frame) for motion, frame in zip(motions, frames, strict=False) if motion.parameters]
    if not moved:
        return result
    before = np.array([frame for _, frame in moved])  # (motions, N, 4, 4)
    turns = np.array([motion.turns for motion, _ in moved])[:, None, None]
    axis, point = (np.array(each)[:, None, :, None] for each in zip(*((motion.axis, motion.point) for motion, _ in moved), strict=True))
    direction = (before[..., :3, :3] @ axis)[..., 0]
    arm = end - before[..., :3, 3] - (before[..., :3, :3] @ point)[..., 0]
    shift = np.where(turns, np.cross(direction, arm), direction)
    screws = np.concatenate([shift, np.where(turns, direction, 0.0)], axis=2)
    for (motion, _), screw in zip(moved, screws, strict=True):
        for column, gain in motion.parameters:
            result[:, :, column] += screw * np.reshape(gain, (-1, 1))
    return result


def _transforms(motions: Sequence[Motion], count: int) -> np.ndarray:
    """Return the transforms (motions, N, 4, 4)."""
    result = np.zeros((len(motions), count, 4, 4))
    if not motions:
        return result
    turns = np.array([motion.turns for motion in motions])[:, None, None]
    moved = np.array([motion.amount for motion in motions])[..., None] * np.array([motion.axis for motion in motions])[:, None]
    point = np.array([motion.point for motion in motions])[:, None]
    turned = Rotation.from_rotvec(np.where(turns, moved, 0.0).reshape(-1, 3)).as_matrix().reshape(len(motions), count, 3, 3)
    result[..., :3, :3], result[..., 3, 3] = turned, 1.0
    result[..., :3, 3] = np.where(turns, point - (turned @ point[..., None])[..., 0], moved)
    return result
