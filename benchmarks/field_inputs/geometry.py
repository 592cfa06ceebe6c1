"""Circular and skewed scans in the words of other programs, by their documented equations; points must fall on the same pixels."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from field_inputs.kinds import RIGHT, WRONG, Input, Outcome, refused
from hil.errors import UnusableInputError
from hil.imaging import ConeBeam, Detector
from hil.imaging.exchange.dicom_file import read_xa
from hil.imaging.exchange.matrices import read_matrices, write_matrices
from hil.imaging.exchange.read_vectors import read_bare_vectors, read_vectors
from hil.imaging.exchange.rtk_xml import read_rtk, write_rtk
from hil.imaging.exchange.vectors import write_vectors

PANEL = Detector(620, 480, 0.6e-3)
POINTS = np.random.default_rng(3).uniform(-0.06, 0.06, (12, 3))
ANGLES = np.linspace(0.0, 3.3, 9)


def seen_by(source: np.ndarray, center: np.ndarray, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Columns and rows (P, 2) where rays [mm] meet the plane, from its middle in steps u and v."""
    points = 1e3 * POINTS
    steps = [np.linalg.solve(np.column_stack([u, v, source - point]), source - center)[:2] for point in points]
    return np.array(steps) + np.array([309.5, 239.5])


def compared(beam: ConeBeam, detector: Detector, flipped: bool, expected: np.ndarray, within: float = 1e-3) -> Outcome:
    seen = np.einsum("nij,pj->npi", beam.matrices(detector), np.column_stack([POINTS, np.ones(len(POINTS))]))
    pixels = seen[..., :2] / seen[..., 2:]
    if flipped:
        pixels[..., 1] = detector.rows - 1 - pixels[..., 1]
    off = float(np.abs(pixels - expected).max())
    return Outcome(RIGHT, f"{off:.1e} pixels") if off < within else Outcome(WRONG, f"off by {off:.3g} pixels")


def circle(offset_mm: tuple[float, float] = (0.0, 0.0), tilt_rad: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> list[np.ndarray]:
    """Source, centre, u, v (N, 3) [mm] of a scan about z, its panel shifted and turned."""
    turn = Rotation.from_euler("z", ANGLES[:, None]).as_matrix()
    panel = turn @ Rotation.from_euler("ZYX", tilt_rad).as_matrix()
    source = turn @ [810.0, 0.0, 0.0]
    center = turn @ [-350.0, *offset_mm]
    return [source, center, 0.6 * panel[:, :, 1], 0.6 * panel[:, :, 2]]


def astra(folder: Path, bare: bool, rows_down: bool, **scan: tuple[float, ...]) -> Outcome:
    source, center, u, v = circle(**scan)
    v = -v if rows_down else v
    vectors = np.concatenate([source, center, u, v], axis=1)
    expected = np.array([seen_by(*one) for one in zip(source, center, u, v, strict=True)])
    if bare:
        np.save(folder / "a.npy", vectors)
        found = read_bare_vectors(folder / "a.npy", PANEL)
    else:
        found = read_vectors(
            folder / "a.npz", {"Vectors": vectors, "DetectorRowCount": np.array(480), "DetectorColCount": np.array(620)}, PANEL
        )
    return compared(found.beam, found.detector, found.flipped, expected)


def leap(folder: Path, **scan: tuple[float, ...]) -> Outcome:
    source, center, u, v = circle(**scan)
    arrays = {"sourcePositions": source, "moduleCenters": center, "colVectors": u / 0.6, "rowVectors": v / 0.6}
    arrays |= {"pixelWidth": 0.6, "pixelHeight": 0.6, "numRows": 480, "numCols": 620}
    found = read_vectors(folder / "a.npz", {name: np.asarray(one) for name, one in arrays.items()}, PANEL)
    return compared(found.beam, found.detector, found.flipped, np.array([seen_by(*one) for one in zip(source, center, u, v, strict=True)]))


def tigre(folder: Path, single: bool, **scan: tuple[float, ...]) -> Outcome:
    source, center, u, v = circle(**scan)
    y, z = scan.get("offset_mm", (0.0, 0.0))
    count = len(ANGLES)
    arrays = {"DSO": 810.0, "DSD": 1160.0, "offDetector": [z, y], "rotDetector": scan.get("tilt_rad", (0.0, 0.0, 0.0))}
    arrays |= {"angles": ANGLES, "nDetector": [480, 620], "dDetector": [0.6, 0.6]}
    if not single:
        arrays |= {
            "DSO": np.full(count, 810.0),
            "offDetector": np.tile([z, y], (count, 1)),
            "angles": np.column_stack([ANGLES, np.zeros((count, 2))]),
        }
    found = read_vectors(folder / "a.npz", {name: np.asarray(one) for name, one in arrays.items()}, PANEL)
    return compared(found.beam, found.detector, found.flipped, np.array([seen_by(*one) for one in zip(source, center, u, v, strict=True)]))


def tigre_beside(folder: Path, cor: float, **scan: tuple[float, ...]) -> Outcome:
    """A centre of rotation beside the origin: source and panel moved across the angle."""
    source, center, u, v = circle(**scan)
    y, z = scan.get("offset_mm", (0.0, 0.0))
    arrays = {"DSO": 810.0, "DSD": 1160.0, "offDetector": [z, y], "rotDetector": scan.get("tilt_rad", (0.0, 0.0, 0.0)), "COR": cor}
    arrays |= {"angles": ANGLES, "nDetector": [480, 620], "dDetector": [0.6, 0.6]}
    aside = cor * np.column_stack([-np.sin(ANGLES), np.cos(ANGLES), 0.0 * ANGLES])
    found = read_vectors(folder / "a.npz", {name: np.asarray(one) for name, one in arrays.items()}, PANEL)
    expected = [seen_by(*one) for one in zip(source + aside, center + aside, u, v, strict=True)]
    return compared(found.beam, found.detector, found.flipped, np.array(expected))


def astra_few(folder: Path) -> Outcome:
    """ASTRA's cone, whose angle 0 has the source at -y."""
    arrays = {"type": "cone", "ProjectionAngles": ANGLES + np.pi / 2.0, "DistanceOriginSource": 810.0, "DistanceOriginDetector": 350.0}
    arrays |= {"DetectorSpacingX": 0.6, "DetectorSpacingY": 0.6, "DetectorRowCount": 480, "DetectorColCount": 620}
    found = read_vectors(folder / "a.npz", {name: np.asarray(one) for name, one in arrays.items()}, PANEL)
    return compared(found.beam, found.detector, found.flipped, np.array([seen_by(*one) for one in zip(*circle(), strict=True)]))


def leap_few(folder: Path, tau: float, column: float) -> Outcome:
    """LEAP's cone beam by its manual, which counts angles from -90 degrees."""
    arrays = {"phis": np.degrees(ANGLES) + 90.0, "sod": 810.0, "sdd": 1160.0, "tau": tau, "centerRow": 239.5, "centerCol": column}
    arrays |= {"pixelHeight": 0.6, "pixelWidth": 0.6, "numRows": 480, "numCols": 620}
    source, center, u, v = circle(offset_mm=(0.6 * (309.5 - column), 0.0))
    aside = -tau * np.column_stack([-np.sin(ANGLES), np.cos(ANGLES), 0.0 * ANGLES])
    found = read_vectors(folder / "a.npz", {name: np.asarray(one) for name, one in arrays.items()}, PANEL)
    expected = [seen_by(*one) for one in zip(source + aside, center + aside, u, v, strict=True)]
    return compared(found.beam, found.detector, found.flipped, np.array(expected))


def refused_vectors(folder: Path, arrays: dict[str, object], words: str) -> Outcome:
    try:
        read_vectors(folder / "a.npz", {name: np.asarray(one) for name, one in arrays.items()}, PANEL)
    except UnusableInputError as refusal:
        return refused(str(refusal), words)
    return Outcome(WRONG, "was read")


def there_and_back(
    folder: Path, write: Callable[[Path, ConeBeam], None], read: Callable[[Path], tuple[ConeBeam, Detector]], **scan: tuple[float, ...]
) -> Outcome:
    source, center, u, v = circle(**scan)
    rotation = np.stack([u / 0.6, -v / 0.6, np.cross(u, -v) / 0.36], axis=2)
    beam = ConeBeam.from_frames(1e-3 * source, 1e-3 * center, rotation)
    path = folder / "a"
    write(path, beam)
    found, detector = read(path)
    return compared(found, detector, False, np.array([seen_by(*one) for one in zip(source, center, u, -v, strict=True)]))


def of_rtk(path: Path) -> tuple[ConeBeam, Detector]:
    return read_rtk(path)[0], PANEL


def of_dicom(path: Path) -> tuple[ConeBeam, Detector]:
    found = read_xa(path)
    return found.beam, found.detector or PANEL


def vectors_of(path: Path) -> tuple[ConeBeam, Detector]:
    found = read_vectors(path, dict(np.load(path)), PANEL)
    return found.beam, found.detector


SHIFT, TILT = (31.0, -7.0), (0.01, -0.02, 0.015)
HALF_FAN = (150.0, 0.0)
SCANS: dict[str, dict[str, tuple[float, ...]]] = {
    "circle": {},
    "half fan": {"offset_mm": HALF_FAN},
    "tilted and shifted": {"offset_mm": SHIFT, "tilt_rad": TILT},
}
WRITERS = {
    "RTK": (lambda path, beam: write_rtk(path, beam), of_rtk),
    "RTK with rows up": (lambda path, beam: write_rtk(path, beam, rows_up=True), of_rtk),
    "matrices": (lambda path, beam: write_matrices(path, beam, PANEL), lambda path: read_matrices(path, PANEL)),
    "ASTRA and back": (lambda path, beam: write_vectors(path, beam, PANEL, "astra"), vectors_of),
}
INPUTS: list[Input] = []
for title, scan in SCANS.items():
    INPUTS += [
        Input(f"ASTRA, {title}, bare array", "geometry", "equations", partial(astra, bare=True, rows_down=False, **scan)),
        Input(f"ASTRA, {title}, rows down", "geometry", "equations", partial(astra, bare=False, rows_down=True, **scan)),
        Input(f"LEAP, {title}", "geometry", "equations", partial(leap, **scan)),
        Input(f"TIGRE, {title}, single numbers", "geometry", "equations", partial(tigre, single=True, **scan)),
        Input(f"TIGRE, {title}, each exposure", "geometry", "equations", partial(tigre, single=False, **scan)),
    ]
    for program in ("RTK", "RTK with rows up"):
        write, read = WRITERS[program]
        INPUTS.append(Input(f"{program}, {title}", "geometry", "equations", partial(there_and_back, write=write, read=read, **scan)))
for title, scan in SCANS.items():
    INPUTS.append(Input(f"TIGRE, {title}, COR", "geometry", "equations", partial(tigre_beside, cor=4.5, **scan)))
INPUTS.append(Input("ASTRA, circle in few numbers", "geometry", "equations", astra_few))
for title, tau, column in (("circle", 0.0, 309.5), ("half fan", 0.0, 60.0), ("axis aside", -3.5, 309.5)):
    INPUTS.append(Input(f"LEAP, {title} in few numbers", "geometry", "equations", partial(leap_few, tau=tau, column=column)))
LEAP_NUMBERS = {"phis": [0.0], "sod": 810.0, "sdd": 1160.0}
REFUSED: list[tuple[str, dict[str, object], str]] = [
    ("ASTRA, parallel vectors", {"vectors": np.ones((3, 12)), "type": "parallel3d_vec"}, "cone_vec and cone are read"),
    ("LEAP, helix", {**LEAP_NUMBERS, "helicalPitch": 2.0}, "convert_to_modularbeam"),
    ("LEAP, tilted circle", {**LEAP_NUMBERS, "tiltAngle": 1.0}, "convert_to_modularbeam"),
    ("TIGRE, parallel", {"DSO": 810.0, "DSD": 1160.0, "angles": [0.0], "mode": "parallel"}, "cone is read"),
]
INPUTS += [Input(name, "geometry", "equations", partial(refused_vectors, arrays=arrays, words=words)) for name, arrays, words in REFUSED]
