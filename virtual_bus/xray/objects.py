"""Objects that X-rays pass: balls and rods."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

STEEL_1_M = 900.0
"""Attenuation of iron at about 60 keV [1/m] (NIST XCOM: 948)."""

TUNGSTEN_1_M = 7000.0
"""Attenuation of tungsten at about 60 keV [1/m] (NIST XCOM: 7150)."""

BLOOD_WITH_CONTRAST_1_M = 120.0
"""Attenuation of an iodine solution of about 160 mg/ml at about 60 keV [1/m] over the tissue around it."""


@dataclass(frozen=True)
class Ball:
    """A sphere in the frame of the scene.

    Attributes
    ----------
    center_m : (3,) array
    radius_m : float
    attenuation_1_m : float
        Over what surrounds it; negative for a hole.
    """

    center_m: np.ndarray
    radius_m: float
    attenuation_1_m: float


@dataclass(frozen=True)
class Rod:
    """A cylinder with flat ends, straight and of one radius."""

    start_m: np.ndarray
    end_m: np.ndarray
    radius_m: float
    attenuation_1_m: float


Item = Ball | Rod


def packed(items: Sequence[Item]) -> np.ndarray:
    """Return rows [start 3, end 3, radius, attenuation] (n, 8); both ends of a ball are its centre."""
    rows = np.zeros((len(items), 8))
    for row, item in zip(rows, items, strict=True):
        if isinstance(item, Ball):
            row[:3] = row[3:6] = item.center_m
        else:
            row[:3], row[3:6] = item.start_m, item.end_m
        row[6], row[7] = item.radius_m, item.attenuation_1_m
    return rows
