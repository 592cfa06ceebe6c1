"""Objects that X-rays pass: balls, rods, ellipsoids and slabs."""

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


SOFT_TISSUE_1_M = 20.0
"""Attenuation of soft tissue at about 60 keV [1/m] (NIST XCOM, ICRU-44 tissue: 21.7; water: 20.6)."""

BONE_1_M = 60.0
"""Attenuation of cortical bone at about 60 keV [1/m] (NIST XCOM, ICRU-44: 60.4)."""

TABLE_1_M = 4.0
"""Attenuation of a table top of carbon fibre about a foam core, over its thickness [1/m]: 50 mm as 2.7 mm of aluminium (NIST: 75 1/m)."""


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


@dataclass(frozen=True)
class Ellipsoid:
    """An ellipsoid with its axes along the scene's.

    Attributes
    ----------
    center_m, half_m : (3,) arrays
        Its middle and half its axes.
    attenuation_1_m : float
        Over what surrounds it; negative for a hole.
    """

    center_m: np.ndarray
    half_m: np.ndarray
    attenuation_1_m: float


@dataclass(frozen=True)
class Slab:
    """A box with its edges along the scene's axes, from its low (3,) to its high corner (3,)."""

    low_m: np.ndarray
    high_m: np.ndarray
    attenuation_1_m: float


Item = Ball | Rod | Ellipsoid | Slab


def packed(items: Sequence[Item]) -> np.ndarray:
    """Return rows [start 3, end 3, radius, attenuation] (n, 8) of the balls and rods; both ends of a ball are its centre."""
    rows = []
    for item in items:
        if isinstance(item, Ball):
            rows.append([*item.center_m, *item.center_m, item.radius_m, item.attenuation_1_m])
        elif isinstance(item, Rod):
            rows.append([*item.start_m, *item.end_m, item.radius_m, item.attenuation_1_m])
    return np.array(rows, dtype=float).reshape(-1, 8)


def packed_bodies(items: Sequence[Item]) -> np.ndarray:
    """Return rows [low 3, high 3, attenuation, 1 if round] (n, 8) of the slabs and ellipsoids."""
    rows = []
    for item in items:
        if isinstance(item, Slab):
            rows.append([*item.low_m, *item.high_m, item.attenuation_1_m, 0.0])
        elif isinstance(item, Ellipsoid):
            rows.append([*(item.center_m - item.half_m), *(item.center_m + item.half_m), item.attenuation_1_m, 1.0])
    return np.array(rows, dtype=float).reshape(-1, 8)
