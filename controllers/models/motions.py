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
    for motion in motions:
        frames.append(frames[-1] @ _transform(motion))
    return frames


def motion_jacobian(motions: Sequence[Motion], frames: Sequence[np.ndarray], end: np.ndarray, parameters: int) -> np.ndarray:
    """Return the change (N, 6, p) per parameter of the point `end` (N, 3) [m], then of the orientation behind it [rad].

    Both are seen from the first frame.
    """
    result = np.zeros((len(end), 6, parameters))
    for motion, before in zip(motions, frames, strict=False):
        if not motion.parameters:
            continue
        direction = before[:, :3, :3] @ motion.axis
        if motion.turns:
            arm = end - before[:, :3, 3] - before[:, :3, :3] @ motion.point
            screw = np.concatenate([np.cross(direction, arm), direction], axis=1)
        else:
            screw = np.concatenate([direction, np.zeros_like(direction)], axis=1)
        for column, gain in motion.parameters:
            result[:, :, column] += screw * np.broadcast_to(gain, len(end))[:, None]
    return result


def _transform(motion: Motion) -> np.ndarray:
    """Return the transform (N, 4, 4) of one motion."""
    result = np.tile(np.eye(4), (len(motion.amount), 1, 1))
    if motion.turns:
        turned = Rotation.from_rotvec(motion.amount[:, None] * motion.axis).as_matrix()
        result[:, :3, :3] = turned
        result[:, :3, 3] = motion.point - turned @ motion.point
    else:
        result[:, :3, 3] = motion.amount[:, None] * motion.axis
    return result
