"""Images shifted and turned as if the machine had been in its nominal pose (thesis Sec. 2.2.1)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import affine_transform

from hil.imaging.detector import Detector
from hil.imaging.geometry import ConeBeam

REACH_M = 0.05
"""Points this far around the phantom's origin count for the shift and the turn."""


@dataclass(frozen=True)
class ImageMotion:
    """In-plane motion of N images that takes shadows from their actual to their wanted places.

    Attributes
    ----------
    turn_rad : (N,) array
        From u to v.
    shift_m : (N, 2) array
        After the turn about the panel's middle.
    left_m : (N,) array
        Rms distance that stays: magnification and perspective.
    """

    turn_rad: np.ndarray
    shift_m: np.ndarray
    left_m: np.ndarray


def compensation(true: ConeBeam, wanted: ConeBeam) -> ImageMotion:
    """Return the turn and shift with the least squares over the corners of a cube about the phantom's origin."""
    cube = REACH_M * np.array([[i, j, k] for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)]) / np.sqrt(3.0)
    here, there = true.project(cube), wanted.project(cube)
    here_mean, there_mean = here.mean(axis=1), there.mean(axis=1)
    a, b = here - here_mean[:, None], there - there_mean[:, None]
    turn = np.arctan2(np.sum(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0], axis=1), np.sum(a * b, axis=(1, 2)))
    rotation = _rotation(turn)
    shift = there_mean - (rotation @ here_mean[..., None])[..., 0]
    moved = np.einsum("nij,npj->npi", rotation, here) + shift[:, None]
    return ImageMotion(turn, shift, np.sqrt(np.mean(np.sum((moved - there) ** 2, axis=2), axis=1)))


def compensated(image: np.ndarray, turn_rad: float, shift_m: np.ndarray, detector: Detector) -> np.ndarray:
    """Return the image (rows, columns) after one turn and shift, linear between pixels; outside it the nearest border's value."""
    to_pixels = detector.intrinsic[:2, :2]
    rotation = _rotation(np.array([turn_rad]))[0]
    back = to_pixels @ rotation.T @ np.linalg.inv(to_pixels)  # from a place in the result to the place in the image, columns and rows
    middle = detector.intrinsic[:2, 2]
    offset = middle - back @ (middle + to_pixels @ np.asarray(shift_m))
    swap = np.array([[0.0, 1.0], [1.0, 0.0]])
    moved: np.ndarray = affine_transform(np.asarray(image, dtype=float), swap @ back @ swap, swap @ offset, order=1, mode="nearest")
    return moved


def _rotation(turn: np.ndarray) -> np.ndarray:
    """Return rotation matrices (N, 2, 2)."""
    cosine, sine = np.cos(turn), np.sin(turn)
    return np.stack([np.stack([cosine, -sine], axis=-1), np.stack([sine, cosine], axis=-1)], axis=-2)
