"""The circle that a scan's exposures turn on."""

from __future__ import annotations

import numpy as np

from hil.errors import UnusableInputError
from hil.imaging.geometry import ConeBeam


def scan_circle(beam: ConeBeam) -> tuple[np.ndarray, np.ndarray]:
    """Return the axis (3,) that the panel's normals turn about, and the angle (N,) of each exposure about it [rad].

    Raises
    ------
    UnusableInputError
        The exposures do not turn about one axis.
    """
    normals = beam.rotation[:, :, 2]
    _, spread, directions = np.linalg.svd(normals, full_matrices=False)
    axis = directions[2]
    if spread[2] > 0.2 * spread[1]:
        raise UnusableInputError("the exposures do not turn about one axis; this needs a circular scan")
    first = normals[0] - (normals[0] @ axis) * axis
    first /= np.linalg.norm(first)
    second = np.cross(axis, first)
    return axis, np.unwrap(np.arctan2(normals @ second, normals @ first))


def advancing(angle: np.ndarray) -> np.ndarray:
    """Return which exposures of a circular scan go on from the last one taken: without those at standstill, or in which it turns back."""
    ahead = -angle if angle[-1] < angle[0] else angle
    least = 0.3 * np.ptp(ahead) / len(ahead)
    chosen = [0]
    for k in range(1, len(ahead)):
        if ahead[k] - ahead[chosen[-1]] > least:
            chosen.append(k)
    return np.array(chosen)
