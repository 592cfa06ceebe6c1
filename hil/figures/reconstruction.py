"""Figures of a reconstruction: slices, projections of the largest value, and the cross sections of wires."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure

from hil.reconstruction.fdk import Volume
from hil.reconstruction.sinogram import Sinogram
from hil.reconstruction.wire_profiles import WireQuality

PLANES = (("z", 0, "x", "y"), ("y", 1, "x", "z"), ("x", 2, "y", "z"))
"""Direction looked along, its index in the array (z, y, x), and the picture's axes."""


def volume_figure(volume: Volume, title: str) -> Figure:
    """Draw three slices through the middle over three largest-value projections; the volume's own frame, millimetres."""
    figure = Figure(figsize=(11.0, 7.6), layout="constrained")
    panels = figure.subplots(2, 3)
    half = 0.5e3 * volume.values.shape[0] * volume.spacing_m
    high = float(np.percentile(volume.values, 99.95))
    for column, (name, index, across, up) in enumerate(PLANES):
        middle = np.take(volume.values, volume.values.shape[index] // 2, axis=index)
        for row, (picture, kind) in enumerate(((middle, f"slice {name} = 0"), (volume.values.max(axis=index), f"largest along {name}"))):
            panel = panels[row, column]
            shown = panel.imshow(picture, cmap="gray", origin="lower", extent=(-half, half, -half, half), vmin=0.0, vmax=high)
            panel.set_title(kind, fontsize=10)
            panel.set_xlabel(f"{across} [mm]")
            panel.set_ylabel(f"{up} [mm]")
    figure.colorbar(shown, ax=panels, label="attenuation [1/m]", shrink=0.7)
    figure.suptitle(f"{title}\nthe volume's own frame: its middle the isocentre, y along the scan's axis", fontsize=10)
    return figure


def plane_figure(sinogram: Sinogram, image: np.ndarray, spacing_m: float) -> Figure:
    """Draw a sinogram, and the image of it in millimetres."""
    figure = Figure(figsize=(10.0, 4.6), layout="constrained")
    rays, plane = figure.subplots(1, 2)
    across = 1e3 * sinogram.spacing_m * np.array([-0.5, 0.5]) * sinogram.projections.shape[1]
    unit = "ray from the middle, at the origin [mm]"
    if sinogram.psi is not None:
        across, unit = np.degrees(sinogram.psi[[0, -1]]), "ray from the central one [deg]"
    turned = np.degrees(np.unwrap(sinogram.angles)[[0, -1]])
    shown = rays.imshow(sinogram.projections, cmap="gray", origin="lower", aspect="auto", extent=(*across, *turned))
    rays.set(title="line integrals", xlabel=unit, ylabel="angle [deg]")
    figure.colorbar(shown, ax=rays)
    half = 0.5e3 * len(image) * spacing_m
    shown = plane.imshow(image, cmap="gray", origin="lower", extent=(-half, half, -half, half))
    plane.set(title="attenuation [1/m]", xlabel="x [mm]", ylabel="y [mm]")
    figure.colorbar(shown, ax=plane)
    return figure


def wires_figure(qualities: Mapping[str, WireQuality], title: str) -> Figure:
    """Draw the cross section of each wire, and its profiles through the peak."""
    figure = Figure(figsize=(3.8 * len(qualities), 7.0), layout="constrained")
    panels = figure.subplots(2, len(qualities), squeeze=False)
    for column, (name, quality) in enumerate(qualities.items()):
        half = 0.5e3 * (quality.section.shape[0] - 1) * quality.spacing_m
        picture, profile = panels[0, column], panels[1, column]
        picture.imshow(quality.section, cmap="gray", origin="lower", extent=(-half, half, -half, half))
        picture.set_title(f"{name}: peak {quality.peak_1_m:.0f} 1/m", fontsize=10)
        picture.set_xlabel("across [mm]")
        picture.set_ylabel("across [mm]")
        row, at = np.unravel_index(np.argmax(quality.section), quality.section.shape)
        along = np.linspace(-half, half, quality.section.shape[0])
        profile.plot(along, quality.section[row, :], color="#0072B2", label=f"width {1e3 * quality.widths_m[1]:.2f} mm")
        profile.plot(along, quality.section[:, at], color="#D55E00", linestyle="--", label=f"width {1e3 * quality.widths_m[0]:.2f} mm")
        profile.set_xlabel("across [mm]")
        profile.set_ylabel("attenuation [1/m]")
        profile.legend(fontsize=8)
        profile.grid(alpha=0.3)
    figure.suptitle(title)
    return figure
