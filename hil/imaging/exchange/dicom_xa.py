"""X-ray angiography attributes of DICOM (PS3.3 C.8.7.5, C.8.7.6): positioner angles, distances, pixel spacing.

Patient on the table, head first, supine, feet towards the world's x, left side towards y, front towards z. With d the unit vector from the
focal spot to the panel: PositionerPrimaryAngle (LAO positive) = atan2(d_left, d_front), PositionerSecondaryAngle (CRA positive) =
asin(d_head) [deg]. On the C-arm they are minus propeller and minus roll.
The attributes hold a machine without errors: no offset, no turn in the panel's plane; `positioner_of` returns what is lost.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial.transform import Rotation

from hil.errors import UnusableInputError
from hil.extras import extra_package
from hil.imaging.detector import Detector
from hil.imaging.geometry import ConeBeam

if TYPE_CHECKING:
    from pydicom.dataset import Dataset

XA_IMAGE_STORAGE = "1.2.840.10008.5.1.4.1.1.12.1"
EXPLICIT_LITTLE_ENDIAN = "1.2.840.10008.1.2.1"
_MOST_LETTERS = 16
"""Of a decimal string (PS3.5 6.2)."""


@dataclass(frozen=True)
class Positioner:
    """The attributes of N exposures.

    Attributes
    ----------
    primary_rad, secondary_rad : (N,) arrays
    source_to_patient_m, source_to_detector_m : float or (N,) arrays
        Focal spot to isocentre, and to the panel.
    detector : Detector or None
        None where the file names no pixels, or not their size.
    size : tuple of int or None
        Columns and rows, where the file names them.
    notes : tuple of str
        What the file holds and is not taken.
    """

    primary_rad: np.ndarray
    secondary_rad: np.ndarray
    source_to_patient_m: float | np.ndarray
    source_to_detector_m: float | np.ndarray
    detector: Detector | None
    notes: tuple[str, ...] = ()
    size: tuple[int, int] | None = None

    @property
    def beam(self) -> ConeBeam:
        """Return the geometry of a machine without errors, in the world's directions about the isocentre."""
        turn = Rotation.from_euler("XY", -np.column_stack([self.primary_rad, self.secondary_rad])).as_matrix()
        normal = turn[:, :, 2]
        to_patient, to_detector = (np.atleast_1d(one)[:, None] for one in (self.source_to_patient_m, self.source_to_detector_m))
        source = -to_patient * normal
        return ConeBeam.from_frames(source, source + to_detector * normal, turn)


def positioner_of(beam: ConeBeam, detector: Detector | None, *, each_distance: bool = False) -> tuple[Positioner, np.ndarray]:
    """Return the attributes nearest to a geometry, and the deviation (N, 9) that they lose, as `ConeBeam.moved` takes it.

    With `each_distance` every exposure has its own distances, as Enhanced XA allows.
    """
    to_detector = -beam.source_m[:, 2]
    ray = beam.detector_in_phantom_m - beam.source_in_phantom_m
    ray = ray / np.linalg.norm(ray, axis=1)[:, None]
    to_patient = -np.sum(beam.source_in_phantom_m * ray, axis=1)
    found = Positioner(
        primary_rad=np.arctan2(ray[:, 1], ray[:, 2]),
        secondary_rad=np.arcsin(np.clip(-ray[:, 0], -1.0, 1.0)),
        source_to_patient_m=to_patient if each_distance else float(np.mean(to_patient)),
        source_to_detector_m=to_detector if each_distance else float(np.mean(to_detector)),
        detector=detector,
    )
    return found, beam.deviation_from(found.beam)


def write_xa(path: Path, positioner: Positioner, images: np.ndarray | None = None, patient: str = "phantom") -> None:
    """Write the attributes, and the images (N, rows, columns) uint16 where they are given.

    Raises
    ------
    UnusableInputError
        No pydicom, or the file cannot be written.
    """
    pydicom = pydicom_package()
    data = new_dataset(XA_IMAGE_STORAGE, patient)
    data.PositionerMotion = "DYNAMIC" if len(positioner.primary_rad) > 1 else "STATIC"
    data.NumberOfFrames = len(positioner.primary_rad)
    data.DistanceSourceToDetector = decimal(1e3 * float(np.mean(positioner.source_to_detector_m)))
    data.DistanceSourceToPatient = decimal(1e3 * float(np.mean(positioner.source_to_patient_m)))
    for name, angles in (("Primary", positioner.primary_rad), ("Secondary", positioner.secondary_rad)):
        degrees = np.degrees(angles)
        setattr(data, f"Positioner{name}Angle", decimal(degrees[0]))
        if len(degrees) > 1:  # increments are from the first frame (C.8.7.5.1.3)
            setattr(data, f"Positioner{name}AngleIncrement", [decimal(value) for value in degrees - degrees[0]])
    if positioner.detector is not None:
        panel = positioner.detector
        data.Rows, data.Columns = panel.rows, panel.columns
        data.ImagerPixelSpacing = [decimal(1e3 * panel.pitch_m * panel.aspect), decimal(1e3 * panel.pitch_m)]
    write_dataset(path, data, images, pydicom)


def new_dataset(sop_class_uid: str, patient: str) -> Dataset:
    """Return an empty angiography of this SOP class."""
    from pydicom.dataset import Dataset, FileMetaDataset
    from pydicom.uid import UID, generate_uid

    meta = FileMetaDataset()
    meta.MediaStorageSOPClassUID, meta.TransferSyntaxUID = UID(sop_class_uid), UID(EXPLICIT_LITTLE_ENDIAN)
    meta.MediaStorageSOPInstanceUID = generate_uid()
    data = Dataset()
    data.file_meta = meta
    data.SOPClassUID, data.SOPInstanceUID = meta.MediaStorageSOPClassUID, meta.MediaStorageSOPInstanceUID
    data.StudyInstanceUID, data.SeriesInstanceUID = generate_uid(), generate_uid()
    data.Modality, data.PatientName, data.PatientID = "XA", patient, patient
    return data


def write_dataset(path: Path, data: Dataset, images: np.ndarray | None, pydicom: ModuleType) -> None:
    """Write a dataset, with images (N, rows, columns) uint16 where they are given."""
    if images is not None:
        data.SamplesPerPixel, data.PhotometricInterpretation, data.PixelIntensityRelationship = 1, "MONOCHROME2", "LIN"
        data.BitsAllocated, data.BitsStored, data.HighBit, data.PixelRepresentation = 16, 16, 15, 0
        data.PixelData = np.ascontiguousarray(images, dtype="<u2").tobytes()
    try:
        pydicom.dcmwrite(path, data, enforce_file_format=True)
    except OSError as error:
        raise UnusableInputError(f"{path}: cannot be written: {error.strerror or error}") from None


def classic_positioner(path: Path, data: Dataset) -> Positioner:
    """Return the attributes of a classic object; UnusableInputError names the one that is missing."""
    count = int(data.get("NumberOfFrames") or 1)
    moves = ("TableMotion = DYNAMIC",) if data.get("TableMotion") == "DYNAMIC" else ()
    detector = None
    if data.get("Rows") and data.get("Columns") and data.get("ImagerPixelSpacing"):
        rows_mm, columns_mm = (float(value) for value in data.ImagerPixelSpacing)
        detector = Detector(int(data.Columns), int(data.Rows), 1e-3 * columns_mm, rows_mm / columns_mm)
    return Positioner(
        primary_rad=_angles(path, data, "Primary", count),
        secondary_rad=_angles(path, data, "Secondary", count),
        source_to_patient_m=1e-3 * _number(path, data, "DistanceSourceToPatient"),
        source_to_detector_m=1e-3 * _number(path, data, "DistanceSourceToDetector"),
        detector=detector,
        notes=notes_of(*not_taken(data), *moves),
        size=size_of(data),
    )


def size_of(data: Dataset) -> tuple[int, int] | None:
    """Return columns and rows, where a file names both."""
    return (int(data.Columns), int(data.Rows)) if data.get("Rows") and data.get("Columns") else None


def not_taken(item: Dataset) -> list[str]:
    """Return what turns or moves the images on the panel, or the patient on the table, and is not taken: attributes with their values."""
    found = []
    for name, usual in (("FieldOfViewRotation", 0.0), ("FieldOfViewHorizontalFlip", "NO"), ("FieldOfViewOrigin", 0.0)):
        value = item.get(name)
        if value is None or value == "":
            continue
        is_usual = value == usual if isinstance(usual, str) else not np.any(np.array(value, dtype=float))
        found += [] if is_usual else [f"{name} = {value}"]
    if item.get("PatientPosition") not in (None, "", "HFS"):
        found.append(f"PatientPosition = {item.get('PatientPosition')}: the angles are the patient's")
    return found


def notes_of(*lost: str) -> tuple[str, ...]:
    """Return one note of what was not taken."""
    return (f"not taken: {', '.join(lost)}",) if lost else ()


def _angles(path: Path, data: Dataset, name: str, count: int) -> np.ndarray:
    first = _number(path, data, f"Positioner{name}Angle")
    increments = data.get(f"Positioner{name}AngleIncrement")
    if increments is None or increments == "":
        if count > 1 and data.get("PositionerMotion") == "DYNAMIC":
            raise UnusableInputError(f"{path}: the positioner moves over {count} frames, and there is no Positioner{name}AngleIncrement")
        return np.full(count, np.radians(first))
    values = np.atleast_1d(np.array(increments, dtype=float))
    if len(values) != count:
        raise UnusableInputError(f"{path}: {len(values)} values of Positioner{name}AngleIncrement for {count} frames")
    return np.radians(first + values)


def _number(path: Path, data: Dataset, name: str) -> float:
    value = data.get(name)
    if value is None or value == "":
        raise UnusableInputError(f"{path}: no {name} in this {sop_class(data)}")
    return float(value)


def sop_class(data: Dataset) -> str:
    """Return what a file is by its SOP class, in words."""
    uid = data.get("SOPClassUID")
    return "file without a SOP class" if uid is None else str(getattr(uid, "name", uid))


def decimal(value: float) -> str:
    """Write a number as a decimal string of at most 16 characters."""
    from pydicom.valuerep import format_number_as_ds

    text = format_number_as_ds(float(value))
    # of a number that rounds up to another power of ten it makes a letter too many
    return text if len(text) <= _MOST_LETTERS else format_number_as_ds(float(f"{value:.10g}"))


def pydicom_package() -> ModuleType:
    """Import pydicom; UnusableInputError names the extra where it is missing."""
    extra_package("pydicom.errors", "DICOM files")
    return extra_package("pydicom", "DICOM files")
