"""Cone-beam reconstruction over a circular scan with the geometry of each exposure, by RTK's FDK (thesis Appendix B)."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft
from scipy.ndimage import map_coordinates
from scipy.spatial.transform import Rotation

from hil.errors import UnusableInputError
from hil.extras import extra_package
from hil.imaging.circular import advancing, scan_circle
from hil.imaging.detector import Detector
from hil.imaging.geometry import ConeBeam
from hil.imaging.pixels import without_dead_pixels

FEWEST = 20
"""Fewest projections; with fewer, the volume shows nothing but streaks."""

LEAST_ARC_deg = 150.0
"""Smallest arc of a circular scan: FDK with short-scan weights cannot make up for less; 180 degrees plus the fan angle is complete."""

AT_ONCE = 16
"""Projections that are filtered together; their spectra take six times their memory."""


@dataclass(frozen=True)
class Volume:
    """A reconstructed volume.

    Attributes
    ----------
    values : (n, n, n) float32 array
        Attenuation [1/m]; index order z, y, x of the volume's own frame.
    spacing_m : float
    rotation : (3, 3) array
        Columns: the volume's x, y, z in the phantom's frame. y is the scan's axis.
    """

    values: np.ndarray
    spacing_m: float
    rotation: np.ndarray

    def sample(self, points_m: np.ndarray) -> np.ndarray:
        """Return values (...,) at points (..., 3) of the phantom's frame, linear between voxels; 0 outside."""
        own = np.asarray(points_m) @ self.rotation / self.spacing_m + (np.array(self.values.shape[::-1]) - 1) / 2.0
        sampled: np.ndarray = map_coordinates(self.values, np.moveaxis(own[..., ::-1], -1, 0), order=1, mode="constant")
        return sampled


def line_integrals(image: np.ndarray, open_beam: float | None = None) -> np.ndarray:
    """Return -log of counts over the open beam's, dead pixels repaired; the open beam is the image's 98th percentile unless given."""
    counts = np.maximum(without_dead_pixels(np.asarray(image, dtype=float)), 1.0).astype(np.float32)
    integrals: np.ndarray = np.log(np.float32(open_beam if open_beam is not None else np.percentile(counts, 98.0))) - np.log(counts)
    return integrals


def bytes_needed(size: int, projections: tuple[int, int, int]) -> float:
    """Return the memory of a reconstruction: three volumes (RTK's empty one, its result, ours) and six stacks of images."""
    return 4.0 * (3 * size**3 + 6 * float(np.prod(projections)))


def reconstruct(
    projections: np.ndarray, detector: Detector, beam: ConeBeam, size: int = 128, spacing_m: float = 1e-3, hann: float = 0.0
) -> Volume:
    """Reconstruct by Feldkamp, Davis and Kress with short-scan weights, every projection with its own geometry.

    Exposures at standstill before, between and after sweeps are left out.

    Parameters
    ----------
    projections : (N, rows, columns) array
        Line integrals.
    detector : Detector
        Without skew.
    beam : ConeBeam
        Geometry of the N exposures.
    size : int
        Voxels along each edge.
    spacing_m : float
    hann : float
        Cut-off of the Hann window on the ramp filter, relative to Nyquist; 0: none.

    Raises
    ------
    UnusableInputError
        There are too few projections, the arc is too short, the scan is not circular, or shapes do not match.
    """
    projections = np.ascontiguousarray(projections, dtype=np.float32)
    if projections.shape != (len(beam), detector.rows, detector.columns):
        raise UnusableInputError(
            f"projections {projections.shape}; {len(beam)} exposures of {detector.rows} x {detector.columns} pixels differ"
        )
    if detector.skew:
        raise UnusableInputError(f"the panel's pixels are skewed by {detector.skew:g} columns a row; straighten the images")
    if len(beam) < FEWEST:
        raise UnusableInputError(f"{len(beam)} projections; a reconstruction needs {FEWEST} at least, 100 to be of use")
    axis, angle = scan_circle(beam)
    arc = float(np.ptp(angle))
    if np.degrees(arc) < LEAST_ARC_deg:
        raise UnusableInputError(f"the scan covers {np.degrees(arc):.0f} degrees; a reconstruction needs {LEAST_ARC_deg:.0f} at least")
    chosen = advancing(angle)
    projections, beam = projections[chosen], beam[chosen]
    to_volume = _turned_to_y(axis)
    turned = beam.referred_to(np.zeros(3), to_volume)
    u, v = turned.rotation[:, :, 0], turned.rotation[:, :, 1]
    pitch_u, pitch_v = detector.pitch_m, detector.pitch_m * detector.aspect
    if np.abs(u[:, 1]).mean() > np.abs(v[:, 1]).mean():  # the ramp filter runs across the axis: swap the panel's directions
        projections = np.ascontiguousarray(np.swapaxes(projections, 1, 2))
        u, v, pitch_u, pitch_v = v, u, pitch_v, pitch_u
    weights = short_scan_weights(turned, u, pitch_u, projections.shape[2], arc)
    projections = projections * weights[:, None, :].astype(np.float32)
    frames = np.stack([turned.source_in_phantom_m, turned.detector_in_phantom_m, u, v], axis=1)
    values = _fdk(*_with_dark_ends(projections, frames), (pitch_u, pitch_v), size, spacing_m, hann)
    return Volume(values, spacing_m, to_volume)


def short_scan_weights(beam: ConeBeam, u: np.ndarray, pitch_m: float, columns: int, arc: float) -> np.ndarray:
    """Return the weights of a scan of less than a turn: lines measured twice share a weight of 2, those measured once have 2.

    Parker, Medical Physics 9 (1982) 254, with the half overlap delta = (arc - pi) / 2 in place of the fan's half angle, so that arcs
    between half a turn and half a turn plus the fan use all measurements; an arc below half a turn measures no line twice. RTK expects a
    whole turn, hence the 2. The ray at fan angle gamma, here positive against the sweep, is measured again half a turn and 2 gamma later,
    at -gamma.

    Parameters
    ----------
    beam : ConeBeam
        Geometry of N exposures that turn about y.
    u : (N, 3) array
        The panel's direction across the axis, towards the columns' growing index.
    pitch_m : float
    columns : int
    arc : float
        Arc that the exposures cover [rad].

    Returns
    -------
    (N, columns) array
    """
    source = beam.source_in_phantom_m
    beta = np.unwrap(np.arctan2(source[:, 0], source[:, 2]))
    sense = np.sign(beta[-1] - beta[0])
    turn = (sense * (beta - beta[0]))[:, None]
    delta = 0.5 * (arc - np.pi)
    if delta <= 0.0:
        return np.full((len(beta), columns), 2.0)
    along = (np.arange(columns) - (columns - 1) / 2.0) * pitch_m
    with_sweep = sense * np.sign(np.sum(u * np.cross([0.0, 1.0, 0.0], source), axis=1))
    gamma = -with_sweep[:, None] * np.arctan(along / -beam.source_m[:, 2, None])
    weight = np.ones_like(gamma)
    rising, falling = turn < 2.0 * (delta - gamma), turn > np.pi - 2.0 * gamma
    weight[rising] = np.sin(0.25 * np.pi * (turn / (delta - gamma))[rising]) ** 2
    weight[falling] = np.sin(0.25 * np.pi * ((np.pi + 2.0 * delta - turn) / (delta + gamma))[falling]) ** 2
    weights: np.ndarray = 2.0 * weight
    return weights


def _turned_to_y(axis: np.ndarray) -> np.ndarray:
    """Return the frame (3, 3) whose y is the scan's axis and whose z is nearest to the present z."""
    y = axis * np.sign(axis[np.argmax(np.abs(axis))])
    z = np.array([0.0, 0.0, 1.0]) if abs(y[2]) < 0.9 else np.array([1.0, 0.0, 0.0])
    z = z - (z @ y) * y
    z /= np.linalg.norm(z)
    return np.column_stack([np.cross(y, z), y, z])


def _with_dark_ends(projections: np.ndarray, frames: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Add an empty projection one step before the first and one after the last.

    RTK weights a projection by the angle to its neighbours around the whole turn; without these, the first and last would represent all of
    the turn that was not scanned.
    """
    angle = np.unwrap(np.arctan2(frames[:, 0, 0], frames[:, 0, 2]))
    step = (angle[-1] - angle[0]) / (len(angle) - 1)
    before = Rotation.from_rotvec([0.0, -step, 0.0]).apply(frames[0])
    after = Rotation.from_rotvec([0.0, step, 0.0]).apply(frames[-1])
    nothing = np.zeros((1, *projections.shape[1:]), dtype=np.float32)
    return np.concatenate([nothing, projections, nothing]), np.concatenate([before[None], frames, after[None]])


def ramp_filtered(projections: np.ndarray, pitch_m: float, hann: float = 0.0) -> np.ndarray:
    """Convolve projections along their columns with the ramp, band-limited at the pixels' Nyquist frequency.

    Kak and Slaney, Principles of Computerized Tomographic Imaging, (3.61): 1 / 4 in the middle, -1 / (pi n)^2 at odd n, over the pitch.
    RTK's own filter gives the same numbers but is slower: docs/explanation/imaging.md.

    Parameters
    ----------
    projections : (N, rows, columns) float array
        Line integrals.
    pitch_m : float
        Distance between columns.
    hann : float
        As in `reconstruct`.

    Returns
    -------
    (N, rows, columns) array
        [1/m], of the projections' type.
    """
    columns = projections.shape[2]
    length = next_fast_len(2 * columns - 1, real=True)
    n = np.arange(length)
    n = np.minimum(n, length - n)
    kernel = np.where(n % 2 == 1, -1.0 / (np.pi * np.maximum(n, 1)) ** 2, 0.0)
    kernel[0] = 0.25
    response = rfft(kernel).real / pitch_m
    if hann > 0.0:
        share = np.arange(len(response)) / max(round(min(hann, 1.0) * len(response)), 1)
        response *= np.where(share < 1.0, 0.5 + 0.5 * np.cos(np.pi * share), 0.0)
    response = response.astype(projections.dtype)
    filtered = np.empty_like(projections)
    for first in range(0, len(projections), AT_ONCE):
        part = slice(first, first + AT_ONCE)
        spectrum = rfft(projections[part], length, axis=2, workers=-1)
        filtered[part] = irfft(spectrum * response, length, axis=2, workers=-1)[:, :, :columns]
    return filtered


def _fdk(projections: np.ndarray, frames: np.ndarray, pitch_m: tuple[float, float], size: int, spacing_m: float, hann: float) -> np.ndarray:
    """Return the attenuation (size, size, size) [1/m]; weights and backprojection by RTK, which works in millimetres.

    `frames` (N, 4, 3) are source, panel, its u and v.
    """
    itk = extra_package("itk", "reconstructions")
    if not hasattr(itk, "RTK"):
        raise UnusableInputError("reconstructions need itk-rtk beside itk: pip install 'isocenter[imaging]'")
    rtk = itk.RTK
    image_type = itk.Image[itk.F, 3]
    point, vector = itk.Point[itk.D, 3], itk.Vector[itk.D, 3]
    geometry = rtk.ThreeDCircularProjectionGeometry.New()
    for k, (source, panel, u, v) in enumerate(frames):
        if not geometry.AddProjection(point(1e3 * source), point(1e3 * panel), vector(u), vector(v)):
            raise UnusableInputError(f"exposure {k}: RTK does not take its geometry")
    _, rows, columns = projections.shape

    def stack_of(values: np.ndarray) -> object:
        stack = itk.image_from_array(values)
        stack.SetSpacing([1e3 * pitch_m[0], 1e3 * pitch_m[1], 1.0])
        stack.SetOrigin([-0.5e3 * (columns - 1) * pitch_m[0], -0.5e3 * (rows - 1) * pitch_m[1], 0.0])
        return stack

    weights = rtk.FDKWeightProjectionFilter[image_type].New()
    weights.SetInput(stack_of(projections))
    weights.SetGeometry(geometry)
    weights.Update()
    filtered = ramp_filtered(itk.array_view_from_image(weights.GetOutput()), pitch_m[0], hann)
    empty = rtk.ConstantImageSource[image_type].New()
    empty.SetSpacing([1e3 * spacing_m] * 3)
    empty.SetOrigin([-0.5e3 * (size - 1) * spacing_m] * 3)
    empty.SetSize([size] * 3)
    empty.SetConstant(0.0)
    smear = rtk.FDKBackProjectionImageFilter[image_type, image_type].New()
    smear.SetInput(0, empty.GetOutput())
    smear.SetInput(1, stack_of(filtered))
    smear.SetGeometry(geometry)
    smear.SetNumberOfWorkUnits(1)  # two units on two processors take four times the processor time (ITK 5.4)
    smear.Update()
    values: np.ndarray = itk.array_from_image(smear.GetOutput())
    return values


def write_volume(volume: Volume, path: Path) -> None:
    """Write a MetaImage (.mha) in millimetres, with the directions of the phantom's frame; 3D Slicer and ITK-SNAP open it."""
    import itk

    image = itk.image_from_array(volume.values)
    spacing = 1e3 * volume.spacing_m
    image.SetSpacing([spacing] * 3)
    corner = -0.5 * spacing * (np.array(volume.values.shape[::-1]) - 1)
    image.SetOrigin([float(value) for value in volume.rotation @ corner])
    image.SetDirection(itk.matrix_from_array(np.ascontiguousarray(volume.rotation)))
    itk.imwrite(image, str(path))
