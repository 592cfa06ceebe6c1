"""Projection matrices as CSV or JSON: from the phantom's coordinates [mm] to columns and rows.

Each matrix is scaled so that the third row's first three numbers are a unit vector and the third coordinate the depth from the focal spot
[mm]; other scales and signs are read too.
"""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np

from hil.errors import UnusableInputError
from hil.files.regular import check_regular
from hil.imaging.detector import Detector
from hil.imaging.geometry import ConeBeam
from hil.imaging.scan_folder import detector_from

FORMAT = 1
HEADER = ["exposure_id", *(f"m{i}{j}" for i in range(3) for j in range(4))]
MILLIMETRES = np.diag([1e-3, 1e-3, 1e-3, 1.0])


def write_matrices(path: Path, beam: ConeBeam, detector: Detector) -> None:
    """Write matrices in the format of the suffix, .csv or .json.

    Raises
    ------
    UnusableInputError
        The file cannot be written.
    """
    matrices = beam.matrices(detector) @ MILLIMETRES
    matrices /= np.linalg.norm(matrices[:, 2, :3], axis=1)[:, None, None]
    try:
        if path.suffix.lower() == ".json":
            panel = {"columns": detector.columns, "rows": detector.rows, "pitch_mm": 1e3 * detector.pitch_m}
            panel |= {"aspect": detector.aspect, "skew": detector.skew}
            path.write_text(json.dumps({"format": FORMAT, "unit": "mm", "detector": panel, "matrices": matrices.tolist()}) + "\n")
            return
        with path.open("w", newline="", encoding="utf-8") as file:
            rows = csv.writer(file)
            rows.writerow(HEADER)
            rows.writerows([k, *(repr(float(value)) for value in matrix.ravel())] for k, matrix in enumerate(matrices))
    except OSError as error:
        raise UnusableInputError(f"{path}: cannot be written: {error.strerror or error}") from None


def read_matrices(path: Path, detector: Detector) -> tuple[ConeBeam, Detector]:
    """Read matrices from .csv or .json, and the detector they are for; a JSON file may name its own.

    Raises
    ------
    UnusableInputError
        Missing, of another form, or a matrix that is no projection with square-angled axes on this detector.
    """
    check_regular(path)
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise UnusableInputError(f"{path}: {getattr(error, 'strerror', None) or error}") from None
    if path.suffix.lower() == ".json":
        matrices, detector = _from_json(path, text, detector)
    else:
        matrices = _from_csv(path, text)
    try:
        beam = ConeBeam.from_matrices(matrices @ np.linalg.inv(MILLIMETRES), detector)
    except ValueError as error:
        raise UnusableInputError(f"{path}: {error}") from None
    _same(path, beam, matrices, detector)
    return beam, detector


def _same(path: Path, beam: ConeBeam, matrices: np.ndarray, detector: Detector) -> None:
    """Refuse matrices of other pixels: the nine parameters must reproduce them."""
    points = np.array([[x, y, z, 1.0] for x in (-50.0, 50.0) for y in (-50.0, 50.0) for z in (-50.0, 50.0)])
    seen = np.einsum("nij,pj->npi", matrices, points)
    again = np.einsum("nij,pj->npi", beam.matrices(detector) @ MILLIMETRES, points)
    off = np.abs(seen[..., :2] / seen[..., 2:] - again[..., :2] / again[..., 2:]).max(axis=(1, 2))
    if not off.max() < OFF_PIXELS:
        worst = int(np.argmax(np.nan_to_num(off, nan=np.inf)))
        raise UnusableInputError(
            f"{path}: matrix {worst} has other pixels than {1e3 * detector.pitch_m:g} mm with aspect {detector.aspect:g} and skew"
            f" {detector.skew:g} (points within 50 mm differ by {off[worst]:.2g} pixels); give the binning the images have"
        )


OFF_PIXELS = 1e-3
"""Matrices that were fitted with six parameters or nine differ by rounding; a wrong pixel size by tens of pixels."""


def _from_csv(path: Path, text: str) -> np.ndarray:
    lines = list(csv.reader(text.splitlines()))
    if not lines or [cell.strip() for cell in lines[0]] != HEADER:
        raise UnusableInputError(f"{path}: the first line must be {','.join(HEADER)}")
    try:
        values = np.array([[float(cell) for cell in line[1:]] for line in lines[1:]])
    except ValueError as error:
        raise UnusableInputError(f"{path}: {error}") from None
    if values.ndim != 2 or values.shape[1] != 12:
        raise UnusableInputError(f"{path}: no matrix; every line holds an exposure and twelve numbers")
    return values.reshape(-1, 3, 4)


def _from_json(path: Path, text: str, detector: Detector) -> tuple[np.ndarray, Detector]:
    try:
        document = json.loads(text)
        if not isinstance(document, dict) or document.get("format") != FORMAT or document.get("unit") != "mm":
            raise UnusableInputError(f'{path}: must be {{"format": {FORMAT}, "unit": "mm", "matrices": [...]}}')
        matrices = np.array(document["matrices"], dtype=float)
        if document.get("detector") is not None:
            detector = detector_from(path, document["detector"])
    except UnusableInputError:
        raise
    except (ValueError, KeyError, TypeError) as error:
        raise UnusableInputError(f"{path}: no matrices ({type(error).__name__}: {error})") from None
    if matrices.ndim != 3 or matrices.shape[1:] != (3, 4) or not len(matrices):
        raise UnusableInputError(f"{path}: matrices must be of 3 rows and 4 columns each; this array has shape {matrices.shape}")
    return matrices, detector
