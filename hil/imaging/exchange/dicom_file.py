"""Angiographies of DICOM, classic and enhanced."""

from __future__ import annotations

from pathlib import Path

from hil.errors import UnusableInputError
from hil.files.regular import check_regular
from hil.imaging.exchange.dicom_enhanced import enhanced_positioner, is_enhanced
from hil.imaging.exchange.dicom_xa import Positioner, classic_positioner, pydicom_package


def read_xa(path: Path) -> Positioner:
    """Read the attributes of a file.

    Raises
    ------
    UnusableInputError
        No pydicom, no DICOM file, or an attribute is missing or malformed.
    """
    check_regular(path)
    pydicom = pydicom_package()
    try:
        data = pydicom.dcmread(path, stop_before_pixels=True)
    except OSError as error:
        raise UnusableInputError(f"{path}: {error.strerror or error}") from None
    except pydicom.errors.InvalidDicomError:
        raise UnusableInputError(f"{path}: no DICOM file") from None
    try:
        return enhanced_positioner(path, data) if is_enhanced(data) else classic_positioner(path, data)
    except UnusableInputError:
        raise
    except (TypeError, ValueError, ZeroDivisionError) as error:
        raise UnusableInputError(f"{path}: an attribute is no number, or not as many as it should be ({error})") from None
