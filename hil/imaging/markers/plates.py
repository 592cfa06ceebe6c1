"""Marker plates as their drawings say (thesis Sec. 6.3.2): straight grooves, and the points in which they cross."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class MarkerPlate:
    """Etched grooves in a metal plate, in a frame of its own: x and y in the plane, z along the beam, z = 0 at half the grooves' depth.

    Attributes
    ----------
    name : str
    x_m, y_m : arrays
        Places of the grooves that run along y, and of those that run along x.
    x_reach_m, y_reach_m : (2,) arrays
        A groove along x reaches from the first to the second of `x_reach_m`; one along y, of `y_reach_m`.
    groove_m, depth_m, thickness_m : float
        Width and depth of a groove; thickness of the metal.
    half_m, opening_m : (2,) arrays
        Half the sizes of the plate and of the opening in its middle (zeros: none).
    """

    name: str
    x_m: np.ndarray
    y_m: np.ndarray
    x_reach_m: np.ndarray
    y_reach_m: np.ndarray
    groove_m: float
    depth_m: float
    thickness_m: float
    half_m: np.ndarray
    opening_m: np.ndarray

    @property
    def lines(self) -> int:
        """Number of grooves: those along y come first."""
        return len(self.x_m) + len(self.y_m)

    @property
    def points_m(self) -> np.ndarray:
        """Crossings (P, 3); point i * len(y_m) + j is that of grooves x_m[i] and y_m[j]."""
        x, y = np.meshgrid(self.x_m, self.y_m, indexing="ij")
        return np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1)

    def ends_m(self) -> np.ndarray:
        """Return the ends of every groove's middle line, (lines, 2, 3)."""
        along_y = [[[x, end, 0.0] for end in self.y_reach_m] for x in self.x_m]
        along_x = [[[end, y, 0.0] for end in self.x_reach_m] for y in self.y_m]
        return np.array(along_y + along_x)


def experimental_plate() -> MarkerPlate:
    """Return a rectilinear grid over the whole image.

    11 by 9 grooves of 0.8 mm every 6 mm, 1 mm deep, in 2 mm of stainless steel.
    """
    return MarkerPlate(
        "experimental",
        6e-3 * np.arange(-5, 6),
        6e-3 * np.arange(-4, 5),
        np.array([-34e-3, 34e-3]),
        np.array([-27e-3, 27e-3]),
        0.8e-3,
        1.0e-3,
        2.0e-3,
        np.array([45e-3, 38e-3]),
        np.zeros(2),
    )


def clinical_plate() -> MarkerPlate:
    """Return a frame around an open centre: two grooves along each of its four sides, 16 crossings near the image's corners."""
    return MarkerPlate(
        "clinical",
        1e-3 * np.array([-31.0, -26.0, 26.0, 31.0]),
        1e-3 * np.array([-24.0, -19.0, 19.0, 24.0]),
        np.array([-34e-3, 34e-3]),
        np.array([-27e-3, 27e-3]),
        0.8e-3,
        1.0e-3,
        2.0e-3,
        np.array([45e-3, 38e-3]),
        np.array([22e-3, 15e-3]),
    )


PLATES = {"experimental": experimental_plate, "clinical": clinical_plate}
