"""Reconstruction in a plane (thesis Appendix B): Radon transform and filtered backprojection.

Parallel beams are scikit-image's. The fan beam is (B.17)-(B.19), for rays at equal angles psi, with two corrections:
the distance in (B.18) lacks its cross term, R^2 = r^2 + s^2 - 2 r s cos(angle between pixel and source), and the s(psi) of (B.19) is the
ramp filter's impulse response, not the source's distance (Kak and Slaney 1988, eqs. (3.92)-(3.96)).
"""

from __future__ import annotations

from types import ModuleType

import numpy as np
from scipy.signal import fftconvolve

from hil.errors import UnusableInputError
from hil.extras import extra_package


def parallel_projections(image: np.ndarray, angles: np.ndarray, spacing_m: float) -> np.ndarray:
    """Return line integrals (n, bins) (B.4) of an image (m, m) [1/m] at angles (n,) [rad].

    Angles count against the rows (y points up where rows go down). The bins are the pixels of the turned image's columns; pixels outside of
    the inscribed circle are ignored.
    """
    radon = _transforms().radon
    projections: np.ndarray = radon(image, theta=np.degrees(angles), circle=True)
    return projections.T * spacing_m


def filtered_backprojection(projections: np.ndarray, angles: np.ndarray, spacing_m: float, window: str | None = "ramp") -> np.ndarray:
    """Return the image (bins, bins) [1/m] of parallel projections (n, bins) over half a turn.

    (B.11); without a window it is unfiltered, (B.6).
    """
    iradon = _transforms().iradon
    image: np.ndarray = iradon(projections.T / spacing_m, theta=np.degrees(angles), circle=True, filter_name=window)
    return image


def fan_projections(discs: np.ndarray, angles: np.ndarray, psi: np.ndarray, source_m: float) -> np.ndarray:
    """Return exact line integrals (n, bins) of discs.

    Parameters
    ----------
    discs : (k, 4) array
        Place x, y [m], radius [m], attenuation [1/m].
    angles : (n,) array
        Angles of the source about the origin [rad]; its place is source_m (cos, sin).
    psi : (bins,) array
        Angle of every ray from the central one [rad].
    source_m : float
        The source's distance from the origin.
    """
    source = source_m * np.column_stack([np.cos(angles), np.sin(angles)])
    towards = angles[:, None] + np.pi + psi
    ray = np.stack([np.cos(towards), np.sin(towards)], axis=-1)
    result = np.zeros(towards.shape)
    for x, y, radius, attenuation in discs:
        to_center = np.array([x, y]) - source[:, None, :]
        beside = to_center[..., 0] * ray[..., 1] - to_center[..., 1] * ray[..., 0]
        result += attenuation * 2.0 * np.sqrt(np.maximum(radius**2 - beside**2, 0.0))
    return result


def fan_reconstruction(
    projections: np.ndarray, angles: np.ndarray, psi: np.ndarray, source_m: float, size: int, spacing_m: float
) -> np.ndarray:
    """Return the image (size, size) [1/m], rows along y, columns along x, from a fan over a whole turn: (B.17).

    It is 0 outside of the circle that every view sees.

    Parameters
    ----------
    projections : (n, bins) array
    angles : (n,) array
        Evenly spaced over a turn [rad].
    psi : (bins,) array
        Evenly spaced [rad].
    source_m : float
    size : int
    spacing_m : float

    Raises
    ------
    UnusableInputError
        The angles do not go once around, or the bins are not evenly spaced.
    """
    step, turn = np.diff(psi), np.diff(np.unwrap(angles))
    if not np.allclose(step, step[0]) or not np.allclose(turn, turn[0]) or not np.isclose(abs(turn[0]) * len(angles), 2.0 * np.pi):
        raise UnusableInputError("a fan's rays must be even, and its angles go once around in even steps")
    if step[0] < 0.0:
        projections, psi, step = projections[:, ::-1], psi[::-1], -step[::-1]
    weighted = projections * source_m * np.cos(psi)
    filtered = fftconvolve(weighted, _fan_filter(len(psi), step[0])[None], mode="same", axes=1) * step[0]
    along = (np.arange(size) - (size - 1) / 2.0) * spacing_m
    x, y = np.meshgrid(along, along)
    image = np.zeros((size, size))
    for row, angle in zip(filtered, angles, strict=True):
        to_x, to_y = x - source_m * np.cos(angle), y - source_m * np.sin(angle)
        seen = np.arctan2(to_y, to_x) - angle - np.pi
        seen = (seen + np.pi) % (2.0 * np.pi) - np.pi
        image += np.interp(seen, psi, row, left=0.0, right=0.0) / (to_x**2 + to_y**2)
    is_seen = np.hypot(x, y) <= source_m * np.sin(min(-psi[0], psi[-1], np.pi / 2.0))
    scaled: np.ndarray = np.where(is_seen, image * abs(turn[0]), 0.0)
    return scaled


def _fan_filter(bins: int, step: float) -> np.ndarray:
    """Return h(psi) (2 bins - 1,) of (B.19): half of (psi / sin psi)^2 times the band-limited ramp's response."""
    n = np.arange(-(bins - 1), bins)
    response = np.zeros(len(n))
    response[n == 0] = 1.0 / (8.0 * step**2)
    odd = n % 2 != 0
    response[odd] = -0.5 / (np.pi * np.sin(n[odd] * step)) ** 2
    return response


def _transforms() -> ModuleType:
    return extra_package("skimage.transform", "reconstructions in a plane")
