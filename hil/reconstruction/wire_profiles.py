"""Quality of a reconstruction, judged on thin wires: peak, widths and artefacts of their cross sections (thesis Figs. 2.10, 2.11)."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from hil.errors import UnusableInputError
from hil.reconstruction.fdk import Volume

REACH_VOXELS = 10.0
"""Half the width of the cross section that is evaluated."""

PER_VOXEL = 4
"""Samples per voxel. The sub-pixel phase alone changes the peak of a thin wire by a quarter, so the peak is searched between voxels."""

SLICES = 41
"""Cross sections along the wire that are averaged."""

ENDS = 0.2
"""Share of the wire's length left out at each end."""

FEWEST_SLICES = 5
"""Fewest cross sections that the volume must hold."""


@dataclass(frozen=True)
class WireQuality:
    """Quality of one wire's cross section."""

    peak_1_m: float
    """Largest attenuation of the mean cross section at the wire's mean place; lower if the wire is not straight in the volume."""
    peak_ratio: float
    """Its ratio to the true attenuation of the wire; 1 where neither voxels, blur nor geometry reduce it."""
    widths_m: np.ndarray
    """Full widths at half the peak, (2,), in two directions across the wire."""
    offset_m: np.ndarray
    """Place of the wire relative to its drawing, (3,), in the phantom's frame."""
    artefact: float
    """Root mean square outside of the wire over the peak."""
    section: np.ndarray = field(metadata={"json": False})
    """The mean cross section (m, m)."""
    spacing_m: float = field(metadata={"json": False})
    """Spacing of the section's samples."""


def wire_quality(volume: Volume, start_m: np.ndarray, end_m: np.ndarray, attenuation_1_m: float) -> WireQuality:
    """Evaluate one straight wire, as far as the volume holds it.

    Parameters
    ----------
    volume : Volume
    start_m, end_m : (3,) arrays
        Its ends in the phantom's frame.
    attenuation_1_m : float
        True attenuation of the wire.

    Raises
    ------
    UnusableInputError
        The volume does not hold the wire, or holds no attenuation at its place.
    """
    axis = end_m - start_m
    length = np.linalg.norm(axis)
    along = axis / length
    first = np.cross(along, np.eye(3)[np.argmin(np.abs(along))])
    first /= np.linalg.norm(first)
    second = np.cross(along, first)
    step = volume.spacing_m / PER_VOXEL
    grid = np.arange(-REACH_VOXELS * PER_VOXEL, REACH_VOXELS * PER_VOXEL + 1) * step
    across = grid[:, None, None] * first + grid[None, :, None] * second
    places = start_m + np.linspace(ENDS, 1.0 - ENDS, SLICES)[:, None] * axis
    half = 0.5 * (np.array(volume.values.shape[::-1]) - 1) * volume.spacing_m
    places = places[(np.abs(places @ volume.rotation) <= half).all(axis=1)]
    if len(places) < FEWEST_SLICES:
        raise UnusableInputError(f"not in the volume, which is {1e3 * volume.spacing_m * volume.values.shape[0]:.3g} mm wide")
    points = places[:, None, None, :] + across[None]
    held = (np.abs(points @ volume.rotation) <= half).all(axis=(0, 3))
    sections = volume.sample(points)
    mean = sections.mean(axis=0)
    row, column = (int(index) for index in np.unravel_index(np.argmax(mean), mean.shape))
    if mean[row, column] <= 0.0:
        raise UnusableInputError("nothing attenuates where it should be")
    widths = np.array([_width(mean[:, column], row), _width(mean[row, :], column)]) * step
    outside = np.hypot(grid[:, None] - grid[row], grid[None, :] - grid[column]) > 3.0 * volume.spacing_m
    outside &= held
    return WireQuality(
        peak_1_m=float(mean[row, column]),
        peak_ratio=float(mean[row, column] / attenuation_1_m),
        widths_m=widths,
        offset_m=_center(mean, grid, row, column, 1.5 * volume.spacing_m) @ np.array([first, second]),
        artefact=float(np.sqrt(np.mean(mean[outside] ** 2)) / mean[row, column]),
        section=mean,
        spacing_m=float(step),
    )


def _center(section: np.ndarray, grid: np.ndarray, row: int, column: int, reach_m: float) -> np.ndarray:
    """Return the centroid (2,) of the samples above half the peak within `reach_m` of it."""
    near = np.hypot(grid[:, None] - grid[row], grid[None, :] - grid[column]) < reach_m
    weight = np.where(near, np.maximum(section - 0.5 * section[row, column], 0.0), 0.0)
    center: np.ndarray = np.array([np.sum(weight * grid[:, None]), np.sum(weight * grid[None, :])]) / weight.sum()
    return center


def _width(profile: np.ndarray, middle: int) -> float:
    """Return the samples between the half-height points on either side, linear between samples; to the border where there is none."""
    half = 0.5 * profile[middle]
    right = _first_below(profile[middle:], half)
    left = _first_below(profile[middle::-1], half)
    return left + right


def _first_below(values: np.ndarray, level: float) -> float:
    below = np.flatnonzero(values < level)
    if not below.size:
        return float(len(values) - 1)
    k = int(below[0])
    return k - 1 + float((values[k - 1] - level) / (values[k - 1] - values[k]))
