"""Geometry of exposures as the vectors of ASTRA, LEAP and TIGRE: NumPy archives whose arrays bear those programs' names, in millimetres.

ASTRA ("cone_vec", its documentation of 3D geometries): source, panel centre, the step from a column to the next, the step from a row to
the next. LEAP (`set_modularbeam`): the same, the steps as unit vectors beside the pixels' sizes. TIGRE: the source stands at E (DSO, 0, 0)
with E = Rz(angle 1) Ry(angle 2) Rz(angle 3), the panel's point (0, y, z) at E (D (0, y, z) + (DSO - DSD, offset y, offset z)) with
D = Rz(roll) Ry(pitch) Rx(yaw), columns along y and rows along z. TIGRE looks at the panel from the tube, so its images are flipped up-down.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from hil.errors import UnusableInputError
from hil.files.arrays import write_arrays
from hil.imaging.detector import Detector
from hil.imaging.geometry import ConeBeam

PROGRAMS = ("astra", "leap", "tigre")

UNTRIED = ("leap", "tigre")
"""Programs whose packages need a graphics processor to be built: their arrays follow the documentation, tried by its equations alone."""


def write_vectors(path: Path, beam: ConeBeam, detector: Detector, program: str) -> list[str]:
    """Write the arrays of one of `PROGRAMS`; return what is to be known about them.

    Raises
    ------
    UnusableInputError
        The panel's pixels are skewed, which the program cannot say, or the file cannot be written.
    """
    make = {"astra": astra_vectors, "leap": leap_vectors, "tigre": tigre_vectors}[program]
    write_arrays(path, make(beam, detector))
    notes = [f"for images of {detector.columns} x {detector.rows} pixels, lengths in mm"]
    if program == "tigre":
        notes.append("for images flipped up-down")
    if program in UNTRIED:
        notes.append(f"written by {program.upper()}'s documented equations; not tried with the program")
    return notes


def astra_vectors(beam: ConeBeam, detector: Detector) -> dict[str, np.ndarray]:
    """Return the arguments of `astra.create_proj_geom("cone_vec", rows, columns, vectors)`, `vectors` of shape (N, 12)."""
    steps = detector.to_metres(np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]))
    u, v = (beam.rotation[:, :, :2] @ step for step in (steps[1] - steps[0], steps[2] - steps[0]))
    vectors = 1e3 * np.concatenate([beam.source_in_phantom_m, beam.detector_in_phantom_m, u, v], axis=1)
    return {"vectors": vectors, "det_row_count": np.array(detector.rows), "det_col_count": np.array(detector.columns)}


def leap_vectors(beam: ConeBeam, detector: Detector) -> dict[str, np.ndarray]:
    """Return the arguments of LEAP's `set_modularbeam` by name; vectors (N, 3)."""
    _check_square(detector, "LEAP")
    return {
        "numAngles": np.array(len(beam)),
        "numRows": np.array(detector.rows),
        "numCols": np.array(detector.columns),
        "pixelHeight": np.array(1e3 * detector.pitch_m * detector.aspect),
        "pixelWidth": np.array(1e3 * detector.pitch_m),
        "sourcePositions": (1e3 * beam.source_in_phantom_m).astype(np.float32),
        "moduleCenters": (1e3 * beam.detector_in_phantom_m).astype(np.float32),
        "rowVectors": np.ascontiguousarray(beam.rotation[:, :, 1], dtype=np.float32),
        "colVectors": np.ascontiguousarray(beam.rotation[:, :, 0], dtype=np.float32),
    }


def tigre_vectors(beam: ConeBeam, detector: Detector) -> dict[str, np.ndarray]:
    """Return the attributes of a TIGRE geometry by name, and `angles` (N, 3); pairs are of rows and columns, as in Python."""
    _check_square(detector, "TIGRE")
    source, center = 1e3 * beam.source_in_phantom_m, 1e3 * beam.detector_in_phantom_m
    # the panel as TIGRE has it: x towards the tube, y along the columns, z along the flipped rows
    panel = np.stack([-beam.rotation[:, :, 2], beam.rotation[:, :, 0], -beam.rotation[:, :, 1]], axis=2)
    towards = source / np.linalg.norm(source, axis=1)[:, None]
    across = panel[:, :, 1] - np.sum(panel[:, :, 1] * towards, axis=1)[:, None] * towards
    across /= np.linalg.norm(across, axis=1)[:, None]
    turned = np.stack([towards, across, np.cross(towards, across)], axis=2)
    back = np.swapaxes(turned, 1, 2)
    place = (back @ center[..., None])[..., 0]
    distance = np.linalg.norm(source, axis=1)
    pitch = 1e3 * detector.pitch_m
    return {
        "DSO": distance,
        "DSD": distance - place[:, 0],
        "offDetector": place[:, [2, 1]],
        "rotDetector": Rotation.from_matrix(back @ panel).as_euler("ZYX"),
        "angles": Rotation.from_matrix(turned).as_euler("ZYZ"),
        "nDetector": np.array([detector.rows, detector.columns]),
        "dDetector": np.array([pitch * detector.aspect, pitch]),
    }


def _check_square(detector: Detector, program: str) -> None:
    if detector.skew:
        raise UnusableInputError(f"the panel's pixels are skewed by {detector.skew:g} columns a row, which {program} cannot say")
