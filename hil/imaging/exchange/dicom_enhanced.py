"""Enhanced XA of DICOM (PS3.3 A.47): positioner angles and distances in functional groups, shared by all frames or one for each.

PositionerPositionSequence has the angles, XRayGeometrySequence the distances from the focal spot to isocentre and detector,
FramePixelDataPropertiesSequence the pixels. Angles and frames as in `dicom_xa`.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hil.errors import UnusableInputError
from hil.imaging.detector import Detector
from hil.imaging.exchange.dicom_xa import (
    Positioner,
    decimal,
    new_dataset,
    not_taken,
    notes_of,
    pydicom_package,
    size_of,
    sop_class,
    write_dataset,
)

if TYPE_CHECKING:
    from pydicom.dataset import Dataset

ENHANCED_XA_STORAGE = "1.2.840.10008.5.1.4.1.1.12.1.1"

_ANGLES, _DISTANCES, _PIXELS = "PositionerPositionSequence", "XRayGeometrySequence", "FramePixelDataPropertiesSequence"
_VIEW = "FieldOfViewSequence"
_NOT_TAKEN = ("IsocenterReferenceSystemSequence", "TablePositionSequence", "PatientOrientationInFrameSequence")
"""Groups that place table and patient; the isocentre is the origin here."""


def is_enhanced(data: Dataset) -> bool:
    """Return whether a file has functional groups, whatever its SOP class."""
    return str(data.get("SOPClassUID", "")) == ENHANCED_XA_STORAGE or "PerFrameFunctionalGroupsSequence" in data


def enhanced_positioner(path: Path, data: Dataset) -> Positioner:
    """Return the attributes of a file with functional groups.

    Raises
    ------
    UnusableInputError
        A frame has no group, or a group no attribute; the message names frame, group and attribute.
    """
    count = int(data.get("NumberOfFrames") or 1)
    groups = data.get("PerFrameFunctionalGroupsSequence") or []
    if len(groups) not in (0, count):
        raise UnusableInputError(f"{path}: {len(groups)} items of PerFrameFunctionalGroupsSequence for {count} frames")
    shared = next(iter(data.get("SharedFunctionalGroupsSequence") or []), None)

    def values(group: str, name: str) -> list[Any]:
        return [_value(path, data, (groups[k] if groups else None, shared), k, group, name) for k in range(count)]

    primary, secondary = (
        np.radians(np.array(values(_ANGLES, f"Positioner{which}Angle"), dtype=float)) for which in ("Primary", "Secondary")
    )
    to_detector, to_patient = (
        1e-3 * np.array(values(_DISTANCES, f"DistanceSourceTo{what}"), dtype=float) for what in ("Detector", "Isocenter")
    )
    there = {name for item in (shared, *groups) if item is not None for name in _NOT_TAKEN if name in item}
    views = [item[_VIEW].value[0] for item in (shared, *groups) if item is not None and _VIEW in item and item[_VIEW].value]
    turned = {words for item in (data, *views) for words in not_taken(item)}
    detector = _detector(path, data, [(item, shared) for item in groups or (None,)])
    return Positioner(primary, secondary, to_patient, to_detector, detector, notes_of(*sorted(there), *sorted(turned)), size_of(data))


def _value(path: Path, data: Dataset, items: tuple[Dataset | None, Dataset | None], frame: int, group: str, name: str) -> Any:  # noqa: ANN401
    """Return an attribute of a frame, from its own group or the shared one."""
    found = next((item[group].value for item in items if item is not None and group in item and item[group].value), None)
    value = None if found is None else found[0].get(name)
    if value is None or value == "":
        what = f"no {name} in {group}" if found is not None else f"no {group}"
        raise UnusableInputError(f"{path}: frame {frame + 1} of {data.get('NumberOfFrames') or 1} has {what}, of this {sop_class(data)}")
    return value


def _detector(path: Path, data: Dataset, frames: list[tuple[Dataset | None, Dataset | None]]) -> Detector | None:
    """Return the pixels, of which all frames must have the same."""
    spacings = []
    for items in frames:
        found = next((item[_PIXELS].value[0] for item in items if item is not None and _PIXELS in item and item[_PIXELS].value), None)
        spacing = None if found is None else found.get("ImagerPixelSpacing")
        spacings.append(tuple(float(value) for value in spacing) if spacing else ())
    if other := next((k for k, spacing in enumerate(spacings) if spacing != spacings[0]), 0):
        words = f"frame {other + 1} has ImagerPixelSpacing {spacings[other]}, the first {spacings[0]}"
        raise UnusableInputError(f"{path}: {words}; one panel has one, split the file by it")
    if not (spacings[0] and data.get("Rows") and data.get("Columns")):
        return None
    rows_mm, columns_mm = spacings[0]
    return Detector(int(data.Columns), int(data.Rows), 1e-3 * columns_mm, rows_mm / columns_mm)


def write_enhanced_xa(path: Path, positioner: Positioner, images: np.ndarray | None = None, patient: str = "phantom") -> None:
    """Write the attributes of every frame in its own groups, and the images (N, rows, columns) uint16 where they are given.

    Raises
    ------
    UnusableInputError
        No pydicom, or the file cannot be written.
    """
    pydicom = pydicom_package()
    from pydicom.dataset import Dataset

    def item(**attributes: object) -> Dataset:
        made = Dataset()
        for name, value in attributes.items():
            setattr(made, name, value)
        return made

    count = len(positioner.primary_rad)
    data = new_dataset(ENHANCED_XA_STORAGE, patient)
    data.NumberOfFrames, data.PositionerType = count, "CARM"
    to_detector, to_patient = (np.broadcast_to(one, count) for one in (positioner.source_to_detector_m, positioner.source_to_patient_m))
    shared = Dataset()
    if positioner.detector is not None:
        panel = positioner.detector
        data.Rows, data.Columns = panel.rows, panel.columns
        spacing = [decimal(1e3 * panel.pitch_m * panel.aspect), decimal(1e3 * panel.pitch_m)]
        shared.FramePixelDataPropertiesSequence = [item(ImagerPixelSpacing=spacing)]
    data.SharedFunctionalGroupsSequence = [shared]
    data.PerFrameFunctionalGroupsSequence = [
        item(
            PositionerPositionSequence=[
                item(
                    PositionerPrimaryAngle=decimal(np.degrees(positioner.primary_rad[k])),
                    PositionerSecondaryAngle=decimal(np.degrees(positioner.secondary_rad[k])),
                )
            ],
            XRayGeometrySequence=[
                item(DistanceSourceToDetector=decimal(1e3 * to_detector[k]), DistanceSourceToIsocenter=float(1e3 * to_patient[k]))
            ],
        )
        for k in range(count)
    ]
    write_dataset(path, data, images, pydicom)
