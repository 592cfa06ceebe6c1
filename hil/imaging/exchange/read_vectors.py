"""Geometry of exposures from the vectors of ASTRA, LEAP and TIGRE, in millimetres, under the names that `vectors` writes.

Circular scans of ASTRA and LEAP in few numbers are read too (`circles`). TIGRE's COR moves source and panel by COR (-sin, cos, 0) of
angle 1, as its projectors have it. ASTRA's may be a bare .npy of shape (N, 12), "cone_vec". A panel whose u x v points to the tube is read
with its rows counted the other way: its images are to be flipped up-down.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from hil.errors import UnusableInputError
from hil.files.regular import check_regular
from hil.imaging.detector import Detector
from hil.imaging.exchange.circles import ASTRA_CONE, LEAP_CONE, astra_circle, leap_circle
from hil.imaging.geometry import ConeBeam

SAME_PANEL = 1e-4
"""Largest difference of steps between exposures, as a share of a pixel, that single precision leaves of one panel."""

_LEAP = ("sourcePositions", "moduleCenters", "rowVectors", "colVectors", "pixelHeight", "pixelWidth")
_TIGRE = ("dso", "dsd")
_TURNS = 4.0 * np.pi
"""Span of angles [rad] from which it is said that they are taken in rad: a scan seldom goes round twice."""

_NUMBERS_OF_CONE = 12
_NUMBERS_OF = {6: "fan beam, fanflat_vec", 12: "cone_vec"}


class Vectors(NamedTuple):
    """What a file holds.

    Parameters
    ----------
    program : str
    beam : ConeBeam
    detector : Detector
    flipped : bool
        Its images are to be flipped up-down.
    notes : tuple of str
        What is not taken.
    """

    program: str
    beam: ConeBeam
    detector: Detector
    flipped: bool
    notes: tuple[str, ...] = ()


def program_of(arrays: Mapping[str, np.ndarray]) -> str:
    """Return whose vectors these are; "" for another archive."""
    names = {name.lower() for name in arrays}
    if "vectors" in names:
        return "astra"
    if set(ASTRA_CONE[:2]) <= names:
        return "astra"
    if {name.lower() for name in _LEAP[:4]} <= names or set(LEAP_CONE[:3]) <= names:
        return "leap"
    return "tigre" if set(_TIGRE) <= names else ""


def read_bare_vectors(path: Path, detector: Detector) -> Vectors:
    """Read ASTRA's vectors (N, 12) from a .npy; UnusableInputError where it is no such array."""
    check_regular(path)
    try:
        vectors = np.load(path, allow_pickle=False)
    except FileNotFoundError:
        raise UnusableInputError(f"{path}: no such file") from None
    except (OSError, ValueError, EOFError, MemoryError):
        raise UnusableInputError(f"{path}: no whole NumPy array (.npy)") from None
    return read_vectors(path, {"vectors": vectors}, detector)


def read_vectors(path: Path, arrays: Mapping[str, np.ndarray], detector: Detector) -> Vectors:
    """Return the geometry in arrays of one of the programs.

    Parameters
    ----------
    path : Path
        For the messages.
    arrays : mapping
    detector : Detector
        Columns and rows where the arrays do not say them.

    Raises
    ------
    UnusableInputError
        An array is missing, has another shape or no numbers, or says what a flat panel cannot.
    """
    found = {name.lower(): values for name, values in arrays.items()}
    program = program_of(arrays)
    try:
        read = {"astra": _astra, "leap": _leap, "tigre": _tigre}[program](found, detector)
    except KeyError as missing:
        raise UnusableInputError(f"{path}: {program.upper()}'s vectors without {missing.args[0]}") from None
    except (ValueError, TypeError) as problem:
        raise UnusableInputError(f"{path}: {program.upper()}'s vectors: {str(problem).partition(chr(10))[0]}") from None
    beam = read.beam
    if not all(np.isfinite(one).all() for one in (beam.source_m, beam.phantom_m, beam.rotation)) or np.any(
        np.abs(beam.source_m[:, 2]) < 1e-6
    ):
        raise UnusableInputError(f"{path}: {program.upper()}'s vectors: not finite, or a focal spot in the panel's plane")
    return read


def _astra(found: Mapping[str, np.ndarray], detector: Detector) -> Vectors:
    kind = str(found.get("type", "cone_vec" if "vectors" in found else "cone"))
    if kind not in ("cone_vec", "cone"):
        raise ValueError(f"type = {kind}; cone_vec and cone are read")
    rows = _whole(found, ("det_row_count", "detectorrowcount"), detector.rows)
    columns = _whole(found, ("det_col_count", "detectorcolcount"), detector.columns)
    if kind == "cone":
        source, center, u, v = (1e-3 * one for one in astra_circle(found))
        read = _from_steps("astra", source, center, u, v, columns, rows)
        return read._replace(notes=_turns(np.asarray(found["projectionangles"], dtype=np.float64)))
    vectors = np.asarray(found["vectors"], dtype=np.float64)
    if vectors.ndim != 2 or vectors.shape[1] != _NUMBERS_OF_CONE or not len(vectors):
        is_fan = vectors.ndim == 2 and vectors.shape[1] in _NUMBERS_OF
        what = f", {_NUMBERS_OF[vectors.shape[1]]}" if is_fan else ""
        raise ValueError(f"shape {vectors.shape}{what}; cone_vec has (N, {_NUMBERS_OF_CONE})")
    source, center, u, v = (1e-3 * vectors[:, start : start + 3] for start in range(0, _NUMBERS_OF_CONE, 3))
    return _from_steps("astra", source, center, u, v, columns, rows)


def _leap(found: Mapping[str, np.ndarray], detector: Detector) -> Vectors:
    if _LEAP[0].lower() not in found:
        rows, columns = (_whole(found, (name,), 0) for name in ("numrows", "numcols"))
        source, center, across, down = (1e-3 * one for one in leap_circle(found))
        return _from_steps("leap", source, center, across, down, columns, rows)
    source, center, down, across = (np.asarray(found[name.lower()], dtype=np.float64) for name in _LEAP[:4])
    if not source.shape == center.shape == down.shape == across.shape or source.ndim != 2 or source.shape[1] != 3 or not len(source):
        raise ValueError(f"shapes {source.shape}, {center.shape}, {down.shape}, {across.shape}; each has (N, 3)")
    height, width = (1e-3 * _number(found, name.lower()) for name in _LEAP[4:])
    rows, columns = _whole(found, ("numrows",), detector.rows), _whole(found, ("numcols",), detector.columns)
    down, across = (values / np.linalg.norm(values, axis=1)[:, None] for values in (down, across))
    return _from_steps("leap", 1e-3 * source, 1e-3 * center, width * across, height * down, columns, rows)


def _tigre(found: Mapping[str, np.ndarray], detector: Detector) -> Vectors:
    angles = np.asarray(found["angles"], dtype=np.float64)
    if angles.ndim == 1:  # about z alone
        angles = np.column_stack([angles, np.zeros((len(angles), 2))])
    if angles.ndim != 2 or angles.shape[1] != 3 or not len(angles):
        raise ValueError(f"angles of shape {angles.shape}; (N,) or (N, 3) would be right")
    if str(found.get("mode", "cone")) != "cone":
        raise ValueError(f"mode = {found['mode']}; cone is read")
    count = len(angles)
    to_origin, to_panel = (_each(found, name, count) for name in ("dso", "dsd"))
    offset, tilt = _rows_of(found, "offdetector", count, 2), _rows_of(found, "rotdetector", count, 3)
    if "ddetector" in found:
        height, width = (1e-3 * float(one) for one in np.asarray(found["ddetector"], dtype=np.float64))
    else:
        width, height = detector.pitch_m, detector.pitch_m * detector.aspect
    rows, columns = detector.rows, detector.columns
    if "ndetector" in found:
        rows, columns = (int(one) for one in np.asarray(found["ndetector"]))
    gantry = Rotation.from_euler("ZYZ", angles).as_matrix()
    panel = gantry @ Rotation.from_euler("ZYX", tilt).as_matrix()
    source = to_origin[:, None] * gantry[:, :, 0]
    center = (gantry @ np.column_stack([to_origin - to_panel, offset[:, 1], offset[:, 0]])[..., None])[..., 0]
    aside = _each(found, "cor", count)[:, None] * np.column_stack([-np.sin(angles[:, 0]), np.cos(angles[:, 0]), np.zeros(count)])
    source, center = source + aside, center + aside  # a centre of rotation beside the origin moves both
    read = _from_steps("tigre", 1e-3 * source, 1e-3 * center, width * panel[:, :, 1], height * panel[:, :, 2], columns, rows)
    notes = ("offOrigin is the volume's place and was not taken",) if np.any(found.get("offorigin", 0.0)) else ()
    return read._replace(notes=(*notes, *_turns(angles[:, 0])))


def _from_steps(program: str, source: np.ndarray, center: np.ndarray, u: np.ndarray, v: np.ndarray, columns: int, rows: int) -> Vectors:
    """Return the geometry of sources and panel centres (N, 3) [m] and the steps (N, 3) [m] to the next column and row."""
    pitch = np.linalg.norm(u, axis=1)
    x = u / pitch[:, None]
    aside = np.sum(v * x, axis=1)
    upright = v - aside[:, None] * x
    height = np.linalg.norm(upright, axis=1)
    y = upright / height[:, None]
    rotation = np.stack([x, y, np.cross(x, y)], axis=2)
    towards = np.sum((source - center) * rotation[:, :, 2], axis=1)
    flipped = towards > 0.0
    if flipped.any() and not flipped.all():
        raise ValueError(f"exposure {int(np.argmin(flipped == flipped[0]))} has its rows counted the other way than the first")
    if flipped.all():
        rotation = rotation * np.array([1.0, -1.0, -1.0])
        aside = -aside
    panel = np.column_stack([pitch, height, aside])
    uneven = np.flatnonzero(np.abs(panel - panel[0]).max(axis=1) > SAME_PANEL * panel[0, 0])
    if uneven.size:
        steps = ", ".join(f"{1e3 * value:.6g}" for value in panel[uneven[0]])
        raise ValueError(f"exposure {int(uneven[0])} has pixels of another size than the first ({steps} mm); one panel has one")
    pitch_m, height_m, aside_m = (float(value) for value in np.median(panel, axis=0))
    skew = -aside_m / pitch_m if abs(aside_m) > SAME_PANEL * pitch_m else 0.0
    detector = Detector(columns, rows, pitch_m, height_m / pitch_m, skew)
    return Vectors(program, ConeBeam.from_frames(source, center, rotation), detector, bool(flipped.all()))


def _turns(angles_rad: np.ndarray) -> tuple[str, ...]:
    """Return a note on angles that go round often, as degrees taken for rad do."""
    span = float(np.ptp(angles_rad)) if angles_rad.size else 0.0
    return (f"its angles span {span:.4g}, taken in rad: {span / (2.0 * np.pi):.3g} turns",) if span > _TURNS else ()


def _each(found: Mapping[str, np.ndarray], name: str, count: int) -> np.ndarray:
    """Return a number of each exposure (N,), 0 where there is none but DSO and DSD."""
    values = np.asarray(found[name] if name in _TIGRE else found.get(name, 0.0), dtype=np.float64).ravel()
    if values.size not in (1, count):
        raise ValueError(f"{_written(name)} has {values.size} numbers; 1 or {count}, those of angles, would be right")
    return np.broadcast_to(values, (count,)).astype(np.float64)


def _rows_of(found: Mapping[str, np.ndarray], name: str, count: int, width: int) -> np.ndarray:
    """Return some numbers of each exposure (N, width), 0 where there are none."""
    values = np.asarray(found.get(name, np.zeros(width)), dtype=np.float64)
    if values.shape not in ((width,), (1, width), (count, width)):
        raise ValueError(f"{_written(name)} of shape {values.shape}; ({width},) or ({count}, {width}) would be right")
    return np.broadcast_to(values, (count, width)).astype(np.float64)


def _written(name: str) -> str:
    """Return a name as TIGRE writes it."""
    return {"offdetector": "offDetector", "rotdetector": "rotDetector"}.get(name, name.upper())


def _number(found: Mapping[str, np.ndarray], name: str) -> float:
    value = np.asarray(found[name], dtype=np.float64)
    if value.size != 1 or not value.ravel()[0] > 0.0:
        raise ValueError(f"{name} must be one number above 0")
    return float(value.ravel()[0])


def _whole(found: Mapping[str, np.ndarray], names: tuple[str, ...], default: int) -> int:
    named = next((name for name in names if name in found), None)
    return default if named is None else int(_number(found, named))
