"""Sinograms of a plane as files: line integrals of parallel rays or of a fan, and their reconstruction (thesis Appendix B)."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hil.errors import UnusableInputError
from hil.files.arrays import read_arrays, write_arrays
from hil.reconstruction.filtered_backprojection import fan_projections, fan_reconstruction, filtered_backprojection

PARALLEL, FAN = ("spacing_m",), ("psi_rad", "source_m")
"""Arrays of a sinogram beside `projections` and `angles_rad`, by its kind."""

MOST_VALUES = 2**24
"""Most line integrals, and most pixels of an image: 128 MB each."""


@dataclass(frozen=True)
class Sinogram:
    """Line integrals through a plane.

    Attributes
    ----------
    projections : (n, bins) array
    angles : (n,) array
        [rad]; of the source about the origin, or of the line (cos, sin) along which parallel bins count, the origin at bin bins // 2.
    spacing_m : float
        Of the bins; of a fan, where its rays pass the origin.
    psi : (bins,) array, optional
        Angle of every ray of a fan from the central one [rad].
    source_m : float
        Distance of a fan's source from the origin.
    """

    projections: np.ndarray
    angles: np.ndarray
    spacing_m: float
    psi: np.ndarray | None = None
    source_m: float = 0.0


def read_sinogram(path: Path) -> Sinogram:
    """Read a sinogram: `projections`, `angles_rad`, and `spacing_m`, or `psi_rad` and `source_m` of a fan.

    Raises
    ------
    UnusableInputError
        No such file, or arrays that are missing, of another shape, or not finite.
    """
    arrays = read_arrays(path, "a sinogram")
    kind = FAN if "psi_rad" in arrays else PARALLEL
    for name in ("projections", "angles_rad", *kind):
        if name not in arrays:
            wanted = f"projections, angles_rad, and {' and '.join(FAN)} of a fan or {PARALLEL[0]} of parallel rays"
            raise UnusableInputError(f"{path}: no array {name}: must have {wanted}")
        if arrays[name].dtype.kind not in "iuf" or not np.isfinite(arrays[name]).all():
            raise UnusableInputError(f"{path}: {name}: must be finite numbers")
    projections = np.asarray(arrays["projections"], dtype=float)
    if projections.ndim != 2 or min(projections.shape) < 3 or projections.size > MOST_VALUES:
        raise UnusableInputError(f"{path}: projections of shape {projections.shape}: must be (n, bins), 3 to {MOST_VALUES} values in all")
    for name, length in (("angles_rad", projections.shape[0]), ("psi_rad", projections.shape[1])):
        if name in arrays and arrays[name].shape != (length,):
            raise UnusableInputError(f"{path}: {name} of shape {arrays[name].shape}: must be ({length},), as the projections")
    length_m = float(arrays[kind[-1]].ravel()[0]) if arrays[kind[-1]].size == 1 else 0.0
    if not length_m > 0.0:
        raise UnusableInputError(f"{path}: {kind[-1]}: must be one positive number")
    angles = np.asarray(arrays["angles_rad"], dtype=float)
    if kind is PARALLEL:
        return Sinogram(projections, angles, length_m)
    psi = np.asarray(arrays["psi_rad"], dtype=float)
    return Sinogram(projections, angles, length_m * abs(float(psi[1] - psi[0])), psi, length_m)


def write_sinogram(sinogram: Sinogram, path: Path) -> None:
    """Write a sinogram as `read_sinogram` has it."""
    own = {"spacing_m": sinogram.spacing_m} if sinogram.psi is None else {"psi_rad": sinogram.psi, "source_m": sinogram.source_m}
    write_arrays(path, {"projections": sinogram.projections, "angles_rad": sinogram.angles, **own})


def fan_of(discs: np.ndarray, source_m: float, views: int, rays: int) -> Sinogram:
    """Return a fan's exact line integrals of discs (k, 4), as of `fan_projections`, over a whole turn.

    Raises
    ------
    UnusableInputError
        A disc reaches the source.
    """
    reach = float((np.hypot(discs[:, 0], discs[:, 1]) + discs[:, 2]).max())
    if reach * 1.05 >= source_m:
        raise UnusableInputError(
            f"discs reach {1e3 * reach:g} mm from the origin: the source must be well outside, not at {1e3 * source_m:g} mm"
        )
    psi = np.linspace(-1.0, 1.0, rays) * np.arcsin(1.05 * reach / source_m)
    angles = 2.0 * np.pi * np.arange(views) / views
    return Sinogram(fan_projections(discs, angles, psi, source_m), angles, source_m * float(psi[1] - psi[0]), psi, source_m)


def image_of(sinogram: Sinogram, window: str | None, size: int | None, spacing_m: float | None) -> tuple[np.ndarray, float]:
    """Return the image [1/m], rows along y, columns along x, and the edge of its pixels [m].

    Parameters
    ----------
    sinogram : Sinogram
    window : str, optional
        Of the ramp filter of parallel rays, scikit-image's names; None: unfiltered, (B.6).
    size : int, optional
        Pixels along each edge; as many as bins unless given.
    spacing_m : float, optional
        Edge of a pixel; the bins' spacing unless given.

    Raises
    ------
    UnusableInputError
        Angles of which the formula is not true, or an option that is of the other kind of rays.
    """
    if sinogram.psi is not None:
        if window != "ramp":
            raise UnusableInputError(f"--window {window or 'none'}: a fan's filter is that of (B.19); only parallel rays have windows")
        pixels, edge_m = size or sinogram.projections.shape[1], spacing_m or sinogram.spacing_m
        image = fan_reconstruction(sinogram.projections, sinogram.angles, sinogram.psi, sinogram.source_m, pixels, edge_m)
        return image, edge_m
    if size is not None or spacing_m is not None:
        raise UnusableInputError("--size and --spacing: of a fan; parallel rays give a pixel a bin")
    steps = np.diff(np.unwrap(sinogram.angles, period=2.0 * np.pi))
    turned = abs(steps[0]) * len(sinogram.angles)
    if not np.allclose(steps, steps[0]) or not np.isclose(np.round(turned / np.pi) * np.pi, turned) or turned < 1.0:
        raise UnusableInputError(
            f"angles of parallel rays must go in even steps once or more around half a turn, not over {np.degrees(turned):.4g} deg"
        )
    image = filtered_backprojection(sinogram.projections, -sinogram.angles, sinogram.spacing_m, window)  # rows up, not down
    return image, sinogram.spacing_m


def drawn(discs: np.ndarray, size: int, spacing_m: float, fine: int = 4) -> np.ndarray:
    """Return discs (k, 4) as an image (size, size) [1/m], averaged over fine x fine points a pixel."""
    along = (np.arange(size * fine) - (size * fine - 1) / 2.0) * spacing_m / fine
    x, y = np.meshgrid(along, along)
    values = np.zeros(x.shape)
    for at_x, at_y, radius, attenuation in discs:
        values += attenuation * ((x - at_x) ** 2 + (y - at_y) ** 2 < radius**2)
    averaged: np.ndarray = values.reshape(size, fine, size, fine).mean(axis=(1, 3))
    return averaged


def means_in(image: np.ndarray, discs: np.ndarray, spacing_m: float) -> np.ndarray:
    """Return an image's mean (k,) in the inner half of each disc; NaN where no pixel's middle is."""
    along = (np.arange(len(image)) - (len(image) - 1) / 2.0) * spacing_m
    x, y = np.meshgrid(along, along)
    parts = [image[np.hypot(x - disc[0], y - disc[1]) < 0.5 * disc[2]] for disc in discs]
    return np.array([part.mean() if part.size else np.nan for part in parts])
