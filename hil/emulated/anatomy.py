"""Drawn patients on a table, about the isocentre: soft tissue, bone, guide wires and vessels with contrast agent.

The patient lies along x, the tube stands below the table at zero. None is a person's anatomy: sizes are drawn from ranges that heads,
limbs and thin trunks have, so that edges of every kind cross an image.
"""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
from scipy.interpolate import CubicSpline

from hil.emulated.beam import Beam
from virtual_bus.xray.objects import (
    BLOOD_WITH_CONTRAST_1_M,
    BONE_1_M,
    SOFT_TISSUE_1_M,
    STEEL_1_M,
    TABLE_1_M,
    Ellipsoid,
    Item,
    Rod,
    Slab,
)

PHOTONS = 20000.0
"""Mean count in the open beam with a patient: what comes through is then a few hundred, as a machine's exposure control keeps it."""

SCATTER, SCATTER_REACH_M = 0.5, 0.05
"""Scattered over unscattered photons behind a patient and an antiscatter grid, and how far they spread on the panel."""

TRABECULAR = 0.35
"""Bone within a vertebra or a rib attenuates this share of what cortical bone adds to soft tissue."""

ALUMINIUM_1_M = 75.0
"""Attenuation of aluminium at about 60 keV [1/m] (NIST XCOM)."""

PIECES = 24
"""Straight pieces of a curve."""


def with_patient(beam: Beam, seed: int, photons: float = PHOTONS) -> Beam:
    """Return the beam with a drawn patient in it, the scatter a patient makes, and so many photons in the open beam."""
    optics = replace(beam.optics, photons=photons, scatter=SCATTER, scatter_reach_m=SCATTER_REACH_M)
    return replace(beam, items=[*beam.items, *patient(seed)], optics=optics)


def patient(seed: int) -> list[Item]:
    """Draw a patient on a table.

    Parameters
    ----------
    seed : int
        One patient has one number. Even: a head. Odd: a trunk with spine and ribs.

    Returns
    -------
    list of Item
        In the scene's frame, its origin the isocentre.
    """
    rng = np.random.default_rng([seed, 4071])
    half = np.array([rng.uniform(0.09, 0.12) if seed % 2 == 0 else 0.4, rng.uniform(0.065, 0.09), rng.uniform(0.06, 0.085)])
    center = rng.uniform(-0.02, 0.02, 3)
    items: list[Item] = [Ellipsoid(center, half, SOFT_TISSUE_1_M)]
    items += _skull(rng, center, half) if seed % 2 == 0 else _trunk(rng, center, half)
    for _ in range(rng.integers(1, 3)):
        items += _curve(rng, center, half, rng.uniform(0.18e-3, 0.45e-3), STEEL_1_M)  # wires of 0.014 to 0.035 inch
    for _ in range(rng.integers(2, 6)):
        items += _curve(rng, center, half, rng.uniform(0.7e-3, 2.2e-3), BLOOD_WITH_CONTRAST_1_M)
    return items + _table(rng, center, half)


def _skull(rng: np.random.Generator, center: np.ndarray, half: np.ndarray) -> list[Item]:
    """Return a shell of cortical bone."""
    outer, more = half - rng.uniform(4e-3, 7e-3), BONE_1_M - SOFT_TISSUE_1_M
    return [Ellipsoid(center, outer, more), Ellipsoid(center, outer - rng.uniform(3e-3, 7e-3), -more)]


def _trunk(rng: np.random.Generator, center: np.ndarray, half: np.ndarray) -> list[Item]:
    """Return vertebrae with end plates along x, and ribs about them."""
    more, radius, pitch = BONE_1_M - SOFT_TISSUE_1_M, rng.uniform(13e-3, 18e-3), rng.uniform(28e-3, 34e-3)
    back = center + np.array([0.0, 0.0, -0.45 * half[2]])
    items: list[Item] = []
    for k in range(-3, 4):
        first, last = (back + np.array([x, 0.0, 0.0]) for x in (k * pitch, (k + 0.82) * pitch))
        items.append(Rod(first, last, radius, TRABECULAR * more))
        items += [Rod(end, end + np.array([1e-3, 0.0, 0.0]), radius, more) for end in (first, last)]
        angle = np.linspace(-0.8 * np.pi, 0.8 * np.pi, PIECES + 1)
        ring = np.stack([8e-3 * angle**2, 0.86 * half[1] * np.sin(angle), 0.86 * half[2] * -np.cos(angle)], axis=1)
        places = center + np.array([k * pitch, 0.0, 0.0]) + ring
        items += _rods(places, rng.uniform(3.5e-3, 5.5e-3), TRABECULAR * more)
    return items


def _curve(rng: np.random.Generator, center: np.ndarray, half: np.ndarray, radius: float, attenuation: float) -> list[Item]:
    """Return a smooth curve through the patient, mostly along x."""
    knots = center + half * rng.uniform(-0.7, 0.7, (5, 3))
    knots[:, 0] = center[0] + np.linspace(-0.1, rng.uniform(0.0, 0.1), 5)
    return _rods(CubicSpline(np.arange(5), knots)(np.linspace(0.0, 4.0, PIECES + 1)), radius, attenuation)


def _rods(places: np.ndarray, radius: float, attenuation: float) -> list[Item]:
    return [Rod(start, end, radius, attenuation) for start, end in itertools.pairwise(places)]


def _table(rng: np.random.Generator, center: np.ndarray, half: np.ndarray) -> list[Item]:
    """Return a table top under the patient, with a rail along either side; its end may be in view."""
    top, end, side = center[2] - half[2], rng.uniform(0.05, 0.4), rng.uniform(0.2, 0.25)
    low, high = np.array([-2.0, center[1] - side, top - 0.05]), np.array([end, center[1] + side, top])
    middle = top - 0.025
    rails = [Rod(np.array([-2.0, y, middle]), np.array([end, y, middle]), 8e-3, ALUMINIUM_1_M) for y in (low[1], high[1])]
    return [Slab(low, high, TABLE_1_M), *rails]
