"""Scenes of an emulated panel by name: phantoms and test objects as balls and rods."""

from __future__ import annotations

import numpy as np

from hil.errors import UnusableInputError
from hil.imaging.phantoms import dodecahedron
from virtual_bus.xray.objects import BLOOD_WITH_CONTRAST_1_M, STEEL_1_M, TUNGSTEN_1_M, Ball, Item, Rod

WIRE_LENGTH_M = 0.06


def bullets() -> list[Item]:
    """Return the dodecahedron phantom."""
    phantom = dodecahedron()
    return [Ball(center, phantom.radius_m, STEEL_1_M) for center in phantom.centers_m]


def wires(diameter_m: float, attenuation_1_m: float) -> list[Item]:
    """Return three wires along x, y and z, a little apart, so that a piece of each stands alone (thesis Fig. 2.10)."""
    half, apart = 0.5 * WIRE_LENGTH_M, 0.012
    lines = [
        ((-half, -apart, 0.0), (half, -apart, 0.0)),
        ((apart, -half, apart), (apart, half, apart)),
        ((-apart, apart, -half), (-apart, apart, half)),
    ]
    return [Rod(np.array(start), np.array(end), 0.5 * diameter_m, attenuation_1_m) for start, end in lines]


def vessel() -> list[Item]:
    """Return a vessel that branches twice, filled with contrast agent, and an aneurysm at its first branching (thesis Fig. 2.12)."""
    points = {
        "in": (0.0, -0.040, -0.010),
        "first": (0.002, -0.012, 0.0),
        "left": (-0.014, 0.006, 0.006),
        "right": (0.013, 0.004, -0.004),
        "left_a": (-0.030, 0.014, 0.002),
        "left_b": (-0.012, 0.028, 0.016),
        "right_a": (0.028, 0.010, -0.012),
        "right_b": (0.012, 0.026, 0.004),
    }
    branches = [
        ("in", "first", 2.0e-3),
        ("first", "left", 1.5e-3),
        ("first", "right", 1.4e-3),
        ("left", "left_a", 0.9e-3),
        ("left", "left_b", 0.8e-3),
        ("right", "right_a", 0.8e-3),
        ("right", "right_b", 0.5e-3),
    ]
    items: list[Item] = [Rod(np.array(points[a]), np.array(points[b]), r, BLOOD_WITH_CONTRAST_1_M) for a, b, r in branches]
    return [*items, Ball(np.array([0.001, -0.008, 0.004]), 4.0e-3, BLOOD_WITH_CONTRAST_1_M)]


def aneurysm() -> list[Item]:
    """Return a vessel along y, filled with contrast agent, with an aneurysm of 3.5 mm radius on its side, towards z."""
    vessel_ends = np.array([0.0, -0.03, 0.0]), np.array([0.0, 0.03, 0.0])
    return [Rod(*vessel_ends, 2.0e-3, BLOOD_WITH_CONTRAST_1_M), Ball(np.array([0.0, 0.0, 5.0e-3]), 3.5e-3, BLOOD_WITH_CONTRAST_1_M)]


SCENES = {
    "dodecahedron": bullets,
    "wires-1mm": lambda: wires(1.0e-3, STEEL_1_M),
    "wires-0.2mm": lambda: wires(0.2e-3, TUNGSTEN_1_M),
    "vessel": vessel,
    "aneurysm": aneurysm,
}


def scene(name: str) -> list[Item]:
    """Return the items of a named scene, about the isocentre.

    Raises
    ------
    UnusableInputError
        The scene does not exist.
    """
    try:
        return SCENES[name]()
    except KeyError:
        raise UnusableInputError(f"scene {name}: there are {', '.join(SCENES)}") from None
