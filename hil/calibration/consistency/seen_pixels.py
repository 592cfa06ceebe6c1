"""The pixels of an image in which something is seen, and how sure their line integrals are.

Where nothing is seen the line integral is zero, not noise: a line across the panel gathers the noise of every pixel on it, and where the
open beam's counts are a little wrong, a plate as large as the panel is seen, cut off by its border.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import binary_dilation, gaussian_filter

from hil.imaging.detector import Detector
from hil.imaging.pixels import without_dead_pixels

RING = 8
"""Pixels along the border that tell the open beam's counts and their noise."""
BLUR = 1.5
"""Standard deviation [pixels] of the blur under which something is seen."""
SEEN = 6.0
"""Deviations of the blurred image: a scan's ten million pixels reach it by chance once in a hundred scans."""
GROWN = 4
"""Pixels around what is seen, for edges too faint to be."""


@dataclass(frozen=True)
class SeenPixels:
    """What an image shows.

    Attributes
    ----------
    at_m : (M, 2) array
        Places on the panel.
    integral, variance : (M,) arrays
        Line integrals, and the variance that photons leave in them.
    cut : bool
        The object reaches the panel's border, or nothing of the border is open.
    """

    at_m: np.ndarray
    integral: np.ndarray
    variance: np.ndarray
    cut: bool


def seen_pixels(counts: np.ndarray, detector: Detector) -> SeenPixels:
    """Find them in an image of counts (rows, columns) whose border is mostly open."""
    clean = np.maximum(without_dead_pixels(np.asarray(counts, dtype=float)), 1.0)
    ring = np.concatenate([each.ravel() for each in (clean[:RING], clean[-RING:], clean[:, :RING], clean[:, -RING:])])
    middle = np.median(ring)
    spread = max(1.4826 * float(np.median(np.abs(ring - middle))), 0.5)
    middle = ring[np.abs(ring - middle) < 4.0 * spread].mean()
    integral = np.log(middle) - np.log(clean)
    noise = spread / middle
    strength = gaussian_filter(np.clip(integral, -SEEN * noise, SEEN * noise), BLUR)  # clipped: a struck pixel alone is not seen
    least = SEEN * noise / (2.0 * np.sqrt(np.pi) * BLUR)
    shown = strength > least
    edge = np.concatenate([strength[0], strength[-1], strength[:, 0], strength[:, -1]])
    rows, columns = np.nonzero(binary_dilation(shown, iterations=GROWN))
    return SeenPixels(
        detector.to_metres(np.stack([columns, rows], axis=-1).astype(float)),
        integral[rows, columns],
        spread**2 / (middle * clean[rows, columns]),
        bool((np.abs(edge) > 1.5 * least).any()),  # a border's blur averages half as many pixels
    )
