"""Shape of an aneurysm in a reconstruction: volume, wall, neck, height, widths, aspect ratio, sphericity, each with its deviation.

The wall is where attenuation falls to half of the lumen's. The dome is the part of the lumen beyond the neck's plane. Three things
are uncertain and drawn: the volume's noise; the level, because blur moves the half height of a wall of radius r inwards by s^2 / r, s the
blur's standard deviation as the wall's slope shows it; and the plane, since a point that is read off a volume is known to a voxel. Streaks
of a reconstruction, and a vessel that blurs into the dome, are not in the deviations.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import binary_erosion, label
from scipy.spatial.distance import pdist

from hil.errors import UnusableInputError
from hil.extras import extra_package
from hil.reconstruction.fdk import Volume

UNITS = {
    "volume": "m^3",
    "wall_area": "m^2",
    "neck_width": "m",
    "dome_height": "m",
    "dome_width": "m",
    "aspect_ratio": "",
    "bottleneck_factor": "",
    "sphericity": "",
}
"""Neck and dome width: the largest distances in the neck's plane and in a plane beside it. Aspect ratio: dome height over neck width.
Bottleneck factor: dome over neck width. Sphericity: surface of a ball of the same volume over that of the dome with its neck closed."""

DRAWS, SEED = 24, 0

PER_VOXEL = 1.5
"""Samples per voxel: what a wall between voxels moves by from the grid's phase is then below a hundredth of a voxel."""

REACH = 3.0
"""Half the width of the region looked at, in distances of the dome's point from the neck: domes are longer than wide by two at most."""


@dataclass(frozen=True)
class Shape:
    """Numbers of `UNITS` and their standard deviations."""

    values: dict[str, float]
    deviations: dict[str, float]


@dataclass(frozen=True)
class _Region:
    """Values (n, n, m) over a grid whose third axis is the neck's normal, from `below` samples under the plane on."""

    values: np.ndarray
    spacing_m: float
    below: int
    dome: tuple[int, int, int]


def aneurysm_shape(volume: Volume, neck_m: np.ndarray, dome_m: np.ndarray) -> Shape:
    """Measure the dome beyond the plane through `neck_m` whose normal points to `dome_m`.

    Parameters
    ----------
    volume : Volume
    neck_m, dome_m : (3,) arrays
        A point of the neck's plane and one inside of the dome, in the phantom's frame.

    Raises
    ------
    UnusableInputError
        Both points are one, the dome's point is outside of volume or lumen, or the dome is not closed beyond the plane.
    """
    neck_m, dome_m = np.asarray(neck_m, dtype=float), np.asarray(dome_m, dtype=float)
    distance = float(np.linalg.norm(dome_m - neck_m))
    if distance < volume.spacing_m:
        raise UnusableInputError(f"neck and dome are {1e3 * distance:.2g} mm apart, less than a voxel: give two points of the aneurysm")
    clean = _region(volume, neck_m, (dome_m - neck_m) / distance, distance)
    background, noise = _noise(volume)
    lumen = _lumen(clean, background, noise, distance)
    level = 0.5 * (lumen + background)
    values, slope = _measured(clean, level)
    blur = (lumen - background) / (slope * np.sqrt(2.0 * np.pi))
    radius = (0.75 * values["volume"] / np.pi) ** (1.0 / 3.0)
    uncertain = slope * blur**2 / radius
    rng = np.random.default_rng(SEED)
    # in pairs of opposite sign: what is linear in level and plane leaves no error in the mean
    levels, planes = (np.concatenate([half, -half]) for half in rng.standard_normal((2, DRAWS // 2)))
    normal, drawn = (dome_m - neck_m) / distance, []
    for of_level, of_plane in zip(uncertain * levels, volume.spacing_m / np.sqrt(12.0) * planes, strict=True):
        noisy = Volume(volume.values + noise * rng.standard_normal(volume.values.shape, np.float32), volume.spacing_m, volume.rotation)
        region = _region(noisy, neck_m + of_plane * normal, normal, distance)
        drawn.append(_measured(region, level + of_level)[0])
    found = {name: np.array([each[name] for each in drawn]) for name in values}
    # noise makes a wall rough and wide; drawn once more, it shows by how much, and that is as uncertain as it is large
    rougher = {name: float(found[name].mean()) - value for name, value in values.items()}
    deviations = {name: float(np.hypot(np.std(found[name], ddof=1), rougher[name])) for name in values}
    return Shape({name: value - rougher[name] for name, value in values.items()}, deviations)


def _region(volume: Volume, neck_m: np.ndarray, normal: np.ndarray, distance: float) -> _Region:
    spacing = volume.spacing_m / PER_VOXEL
    first = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))])
    first /= np.linalg.norm(first)
    frame = np.column_stack([first, np.cross(normal, first), normal])
    half, below = int(np.ceil(REACH * distance / spacing)), 2
    across = spacing * np.arange(-half, half + 1)
    along = spacing * np.arange(-below, half + 1)
    grid = np.stack(np.meshgrid(across, across, along, indexing="ij"), axis=-1) @ frame.T + neck_m
    return _Region(volume.sample(grid), spacing, below, (half, half, below + round(distance / spacing)))


def _noise(volume: Volume) -> tuple[float, float]:
    """Return median and robust standard deviation of what is not lumen: most of a volume is background."""
    middle = float(np.median(volume.values))
    return middle, float(1.4826 * np.median(np.abs(volume.values - middle)))


def _lumen(region: _Region, background: float, noise: float, distance: float) -> float:
    reach = max(int(0.3 * distance / region.spacing_m), 1)
    around = tuple(slice(k - reach, k + reach + 1) for k in region.dome)
    lumen = float(np.median(region.values[around]))
    if lumen < background + 4.0 * noise or lumen <= background:
        raise UnusableInputError(
            f"at the dome's point the volume has {lumen:.3g} 1/m, around it {background:.3g} with noise of {noise:.2g}: no lumen is there"
        )
    return lumen


def _measured(region: _Region, level: float) -> tuple[dict[str, float], float]:
    """Return the numbers at a level, and the mean slope [1/m^2] of attenuation at the wall."""
    measure = extra_package("skimage.measure", "shapes of aneurysms")
    h = region.spacing_m
    height = h * (np.arange(region.values.shape[2]) - region.below)
    inside = (region.values > level) & (height > 0.0)
    parts, _ = label(inside)
    own = parts[region.dome]
    if own == 0:
        raise UnusableInputError("the dome's point is outside of the lumen: give one inside")
    part = parts == own
    if part[[0, -1]].any() or part[:, [0, -1]].any() or part[:, :, -1].any():
        raise UnusableInputError(
            "the dome is not closed beyond the neck's plane: a vessel leaves it; move --neck towards --dome, or turn the plane"
        )
    # closed by the plane, in units of length at the wall: attenuation over its slope
    slope = _slope(region.values, part, height, h)
    field = np.where(part | (parts == 0), (region.values - level) / slope, -h)
    clipped = np.minimum(field, np.broadcast_to(height, field.shape))
    vertices, faces, _, _ = measure.marching_cubes(clipped, 0.0, spacing=(h, h, h))
    a, b, c = (vertices[faces[:, k]].astype(float) for k in range(3))
    normals = np.cross(b - a, c - a)
    volume = abs(float(np.sum(a * normals)) / 6.0)
    surface = 0.5 * float(np.linalg.norm(normals, axis=1).sum())
    outlines = measure.find_contours(field[:, :, region.below], 0.0)
    if not outlines:
        raise UnusableInputError("the neck's plane cuts no lumen: give a point of the neck")
    neck = h * max(outlines, key=len)
    x, y = neck.T
    neck_area = 0.5 * abs(float(np.sum(x[:-1] * y[1:] - x[1:] * y[:-1])))
    neck_width = float(pdist(neck).max())
    widths = [
        float(pdist(h * outline).max())
        for k in range(region.below, region.values.shape[2])
        if part[:, :, k].any()
        for outline in measure.find_contours(field[:, :, k], 0.0)
    ]
    tall = float(vertices[:, 2].max()) - h * region.below
    values = {
        "volume": volume,
        "wall_area": surface - neck_area,
        "neck_width": neck_width,
        "dome_height": tall,
        "dome_width": max(widths),
        "aspect_ratio": tall / neck_width,
        "bottleneck_factor": max(widths) / neck_width,
        "sphericity": np.pi ** (1.0 / 3.0) * (6.0 * volume) ** (2.0 / 3.0) / surface,
    }
    return {name: float(value) for name, value in values.items()}, slope


def _slope(values: np.ndarray, part: np.ndarray, height: np.ndarray, spacing_m: float) -> float:
    """Return the mean gradient of the values along the part's wall beyond the plane."""
    wall = part & ~binary_erosion(part) & (height > 2.0 * spacing_m)
    gradient = np.linalg.norm([each[wall] for each in np.gradient(values, spacing_m)], axis=0)
    return max(float(gradient.mean()) if gradient.size else 0.0, np.finfo(float).tiny)
