"""RTK's geometry file: nine numbers a projection, lengths in millimetres and angles in degrees.

With M = Rz(-in-plane) Rx(-out-of-plane) Ry(-gantry), whose rows are the panel's u, v and their cross product n in the phantom's frame:
M source = (SourceOffsetX, SourceOffsetY, SourceToIsocenterDistance), M panel = (ProjectionOffsetX, ProjectionOffsetY,
SourceToIsocenterDistance - SourceToDetectorDistance). Here the focal spot has negative w, so both distances are negative, as RTK itself
makes them of such a panel. Most programs count rows the other way; then the distances are positive and the images are to be flipped.
"""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from scipy.spatial.transform import Rotation

from hil.errors import UnusableInputError
from hil.files.regular import check_regular
from hil.imaging.geometry import ConeBeam

ROOT = "RTKThreeDCircularGeometry"
FLIP = np.array([1.0, -1.0, -1.0])
"""A panel whose rows are counted the other way: v and w change sign."""

SAME_mm = 0.05
"""Largest distance on the panel of points seen by a matrix and by the numbers beside it; RTK's fewest digits, six, leave less."""

_POINTS = np.array([[x, y, z, 1.0] for x in (-50.0, 50.0) for y in (-50.0, 50.0) for z in (-50.0, 50.0)]).T

LENGTHS = ("SourceToIsocenterDistance", "SourceToDetectorDistance")
OFFSETS = ("SourceOffsetX", "SourceOffsetY", "ProjectionOffsetX", "ProjectionOffsetY")
ANGLES = ("GantryAngle", "InPlaneAngle", "OutOfPlaneAngle")


def write_rtk(path: Path, beam: ConeBeam, rows_up: bool = False) -> None:
    """Write a file that RTK reads.

    Parameters
    ----------
    rows_up : bool
        For images flipped up-down, with positive distances.

    Raises
    ------
    UnusableInputError
        The file cannot be written.
    """
    root = ElementTree.Element(ROOT, version="3")
    for k in range(len(beam)):
        turn, source, panel = beam.rotation[k].copy(), beam.source_m[k], beam.phantom_m[k]
        if rows_up:
            turn, source, panel = turn * FLIP, source * FLIP, panel * FLIP
        to_panel = turn.T
        source, center = 1e3 * (source - panel), -1e3 * panel  # from the phantom's origin, in the panel's directions
        gantry, out_of_plane, in_plane = _angles(to_panel)
        values = {
            "GantryAngle": np.degrees(gantry),
            "SourceToIsocenterDistance": source[2],
            "SourceToDetectorDistance": source[2] - center[2],
            "SourceOffsetX": source[0],
            "SourceOffsetY": source[1],
            "ProjectionOffsetX": center[0],
            "ProjectionOffsetY": center[1],
            "InPlaneAngle": np.degrees(in_plane),
            "OutOfPlaneAngle": np.degrees(out_of_plane),
        }
        projection = ElementTree.SubElement(root, "Projection")
        for name, value in values.items():
            ElementTree.SubElement(projection, name).text = _text(value)
        matrix = ElementTree.SubElement(projection, "Matrix")
        matrix.text = "\n" + "\n".join(" ".join(_text(value) for value in row) for row in _matrix(to_panel, source, center)) + "\n"
    ElementTree.indent(root)
    text = f'<?xml version="1.0"?>\n<!DOCTYPE RTKGEOMETRY>\n{ElementTree.tostring(root, encoding="unicode")}\n'
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise UnusableInputError(f"{path}: cannot be written: {error.strerror or error}") from None


def read_rtk(path: Path) -> tuple[ConeBeam, bool]:
    """Return the geometry of a file that RTK or `write_rtk` wrote, and whether its images must be flipped up-down for us.

    Raises
    ------
    UnusableInputError
        Missing, no such file, a cylindrical panel, or a source in the panel's plane.
    """
    check_regular(path)
    try:
        root = ElementTree.parse(path).getroot()
    except OSError as error:
        raise UnusableInputError(f"{path}: {error.strerror or error}") from None
    except (ElementTree.ParseError, UnicodeDecodeError) as error:
        raise UnusableInputError(f"{path}: no XML: {error}") from None
    if root.tag != ROOT:
        raise UnusableInputError(f"{path}: <{root.tag}>; RTK's geometry is <{ROOT}>")
    common = _numbers(path, root)
    found = [common | _numbers(path, each) for each in root.iter("Projection")]
    if not found:
        raise UnusableInputError(f"{path}: no <Projection>")
    if any(each.get("RadiusCylindricalDetector", 0.0) for each in found):
        raise UnusableInputError(f"{path}: a cylindrical detector; this version knows flat ones")
    table = np.array([[each.get(name, 0.0) for name in (*LENGTHS, *OFFSETS, *ANGLES)] for each in found])
    distance, to_panel = table[:, 1], table[:, 0] - table[:, 1]
    if not np.isfinite(table).all() or (np.abs(distance) < 1e-6).any() or (np.sign(distance) != np.sign(distance[0])).any():
        raise UnusableInputError(f"{path}: SourceToDetectorDistance must be given, all of one sign and none zero")
    turns = Rotation.from_euler("yxz", -np.radians(table[:, [6, 8, 7]])).as_matrix()  # Rz Rx Ry
    source = 1e-3 * np.column_stack([table[:, 2:4], table[:, 0]])
    center = 1e-3 * np.column_stack([table[:, 4:6], to_panel])
    _check_matrices(path, root, turns, 1e3 * source, 1e3 * center)
    flipped = bool(distance[0] > 0.0)
    sign = FLIP if flipped else np.ones(3)
    return ConeBeam((source - center) * sign, -center * sign, np.swapaxes(turns, 1, 2) * sign), flipped


def _check_matrices(path: Path, root: ElementTree.Element, turns: np.ndarray, source: np.ndarray, center: np.ndarray) -> None:
    """Refuse a file whose matrices are of another geometry than its numbers, as one has that was changed by hand."""
    for k, projection in enumerate(root.iter("Projection")):
        text = projection.findtext("Matrix")
        if text is None:
            continue
        expected = _matrix(turns[k], source[k], center[k])
        try:
            matrix = np.array(text.split(), dtype=float).reshape(3, 4)
        except ValueError:
            raise UnusableInputError(f"{path}: <Matrix> of projection {k} is no 3 x 4 numbers") from None
        seen, again = matrix @ _POINTS, expected @ _POINTS
        with np.errstate(all="ignore"):
            off = np.abs(seen[:2] / seen[2] - again[:2] / again[2]).max()
        if not off < SAME_mm:
            raise UnusableInputError(f"{path}: <Matrix> of projection {k} is another geometry than its distances, offsets and angles")


def _text(value: float) -> str:
    """Write every digit; no subnormal numbers, which RTK's reader does not take."""
    return repr(float(value) if abs(value) > np.finfo(float).tiny else 0.0)


def _numbers(path: Path, element: ElementTree.Element) -> dict[str, float]:
    result = {}
    for child in element:
        if child.tag in ("Projection", "Matrix"):
            continue
        try:
            result[child.tag] = float(child.text or "")
        except ValueError:
            raise UnusableInputError(f"{path}: <{child.tag}> {child.text!r} is no number") from None
    return result


def _angles(to_panel: np.ndarray) -> tuple[float, float, float]:
    """Return gantry, out-of-plane, in-plane [rad] of M; gantry zero where the panel's normal is along y."""
    normal = to_panel[2]
    out_of_plane = float(np.arctan2(-normal[1], np.hypot(normal[0], normal[2])))
    gantry = float(np.arctan2(normal[0], normal[2])) if np.hypot(normal[0], normal[2]) > 1e-12 else 0.0
    rest = to_panel @ Rotation.from_euler("yx", [-gantry, -out_of_plane]).as_matrix().T
    return gantry, out_of_plane, float(np.arctan2(rest[0, 1], rest[0, 0]))


def _matrix(to_panel: np.ndarray, source: np.ndarray, center: np.ndarray) -> np.ndarray:
    """Return the matrix (3, 4) from the phantom's coordinates [mm] to (u, v) [mm] times depth, and depth.

    Source and centre are in the panel's directions.
    """
    depth = center[2] - source[2]
    upper = np.array([[depth, 0.0, source[0] - center[0]], [0.0, depth, source[1] - center[1]], [0.0, 0.0, 1.0]])
    matrix: np.ndarray = upper @ np.column_stack([to_panel, -source])
    return matrix
