"""A scan on disk: images, when they were exposed, and by which panel (docs/generated/file-formats.md)."""

from __future__ import annotations

import csv
import math
import struct
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hil.errors import UnusableInputError
from hil.extras import extra_package
from hil.files.regular import check_regular
from hil.files.toml_text import toml_text
from hil.imaging.detector import Detector
from hil.machine import Machine

FORMAT = 1
FRAMES, EXPOSURES, DESCRIPTION = "frames.tif", "exposures.csv", "scan.toml"


@dataclass(frozen=True)
class ImageScan:
    """Exposures of one scan.

    Attributes
    ----------
    folder : Path
    detector : Detector
        As the images were read out.
    exposure_id : (N,) int array
    start_s, width_s : (N,) arrays
        In the loop's time.
    axes, units : tuples of str
        "rad" or "m" per axis.
    positions : (N, axes) array
        Measured axis positions in the middle of each exposure; NaN where nobody wrote them.
    notes : mapping
        The rest of scan.toml: machine, phantom, recording.
    """

    folder: Path
    detector: Detector
    exposure_id: np.ndarray
    start_s: np.ndarray
    width_s: np.ndarray
    axes: tuple[str, ...]
    units: tuple[str, ...]
    positions: np.ndarray
    notes: Mapping[str, Any]

    def __len__(self) -> int:
        """Return the number of exposures."""
        return len(self.exposure_id)

    @property
    def middle_s(self) -> np.ndarray:
        """Middle of each exposure in the loop's time, (N,)."""
        return self.start_s + 0.5 * self.width_s

    def positions_of(self, machine: Machine) -> np.ndarray:
        """Return positions (N, axes) in the order of a machine's axes.

        Raises
        ------
        UnusableInputError
            The scan has other axes, another order or other units, or a position is not known.
        """
        if self.axes != machine.axes:
            raise UnusableInputError(f"{self.folder}: a scan of axes {', '.join(self.axes)}; {machine.name} has {', '.join(machine.axes)}")
        units = tuple(axis.position for axis in machine.units)
        if self.units != units:
            raise UnusableInputError(
                f"{self.folder / EXPOSURES}: positions in {', '.join(self.units)}; {machine.name} has {', '.join(units)}"
            )
        if np.isnan(self.positions).any():
            raise UnusableInputError(f"{self.folder / EXPOSURES}: there are exposures without axis positions; geometry goes by position")
        return self.positions

    def frame(self, k: int) -> np.ndarray:
        """Return image k, (rows, columns).

        Raises
        ------
        UnusableInputError
            The file does not hold it, or not in this panel's size.
        """
        tifffile = extra_package("tifffile", "images")
        path = self.folder / FRAMES
        check_regular(path, most_bytes=math.inf)  # read image by image
        try:
            with tifffile.TiffFile(path) as file:
                page = file.pages[k]
                if page.shape == (self.detector.rows, self.detector.columns):  # nothing is read of one that claims terabytes
                    image: np.ndarray = page.asarray()
                    return image
                is_sized = f"{page.imagewidth} x {page.imagelength}"
        except (OSError, LookupError, ValueError, struct.error, tifffile.TiffFileError) as error:
            raise UnusableInputError(f"{path}: image {k} of {len(self)} cannot be read: {error}") from None
        right = f"{self.detector.columns} x {self.detector.rows}"
        raise UnusableInputError(f"{path}: image {k} is {is_sized}; {DESCRIPTION} says {right}")


def write_description(folder: Path, detector: Detector, axes: Sequence[str], notes: Mapping[str, Any]) -> None:
    """Write scan.toml of a new scan."""
    panel = {
        "columns": detector.columns,
        "rows": detector.rows,
        "pitch_mm": 1e3 * detector.pitch_m,
        "aspect": detector.aspect,
        "skew": detector.skew,
    }
    (folder / DESCRIPTION).write_text(toml_text({"format": FORMAT, "axes": list(axes), "detector": panel, **notes}), encoding="utf-8")


def write_exposures(
    folder: Path, exposure_id: np.ndarray, start_s: np.ndarray, width_s: np.ndarray, units: Mapping[str, str], positions: np.ndarray
) -> None:
    """Write exposures.csv of a new scan.

    `units` are those of each axis; a position that is not known is an empty cell.
    """
    with (folder / EXPOSURES).open("w", newline="", encoding="utf-8") as file:
        rows = csv.writer(file)
        rows.writerow(["exposure_id", "start [s]", "width [s]", *(f"position_{axis} [{unit}]" for axis, unit in units.items())])
        for k, number in enumerate(exposure_id):
            places = ["" if np.isnan(value) else repr(float(value)) for value in positions[k]]
            rows.writerow([int(number), repr(float(start_s[k])), repr(float(width_s[k])), *places])


def read_scan(folder: str | Path) -> ImageScan:
    """Read a scan's description and exposures; images are read one by one.

    Raises
    ------
    UnusableInputError
        Something is missing, unreadable, or does not belong together.
    """
    folder = Path(folder)
    description = folder / DESCRIPTION
    check_regular(description)
    try:
        document = tomllib.loads(description.read_text(encoding="utf-8"))
    except OSError as error:
        raise UnusableInputError(
            f"{description}: {error.strerror}; a scan's folder holds {DESCRIPTION}, {EXPOSURES} and {FRAMES}"
        ) from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise UnusableInputError(f"{description}: {error}") from None
    if document.get("format") != FORMAT:
        raise UnusableInputError(f"{description}: format = {document.get('format')!r}; this version reads {FORMAT}")
    axes = tuple(str(axis) for axis in document.get("axes", ()))
    units, table = _table(folder / EXPOSURES, axes)
    if not (folder / FRAMES).exists():
        raise UnusableInputError(f"{folder / FRAMES}: missing; a scan's images are one TIFF of as many pages as {EXPOSURES} has rows")
    notes = {key: value for key, value in document.items() if key not in ("format", "axes", "detector")}
    detector = detector_from(description, document.get("detector"))
    return ImageScan(folder, detector, table[:, 0].astype(int), table[:, 1], table[:, 2], axes, units, table[:, 3:], notes)


def detector_from(path: Path, panel: object) -> Detector:
    """Return the panel that a file's table `detector` describes.

    Raises
    ------
    UnusableInputError
        No table, or a value that is missing or no positive number.
    """
    if not isinstance(panel, Mapping):
        raise UnusableInputError(f"{path}: no detector with columns, rows and pitch_mm")
    try:
        detector = Detector(
            int(panel["columns"]),
            int(panel["rows"]),
            1e-3 * float(panel["pitch_mm"]),
            float(panel.get("aspect", 1.0)),
            float(panel.get("skew", 0.0)),
        )
    except KeyError as error:
        raise UnusableInputError(f"{path}: detector.{error.args[0]} is missing") from None
    except (TypeError, ValueError) as error:
        raise UnusableInputError(f"{path}: detector: {error}") from None
    if detector.columns < 1 or detector.rows < 1 or not detector.pitch_m > 0.0 or not detector.aspect > 0.0:
        raise UnusableInputError(f"{path}: detector: columns, rows, pitch_mm and aspect must be positive")
    return detector


def _table(path: Path, axes: Sequence[str]) -> tuple[tuple[str, ...], np.ndarray]:
    """Return the unit of every axis, and numbers (N, 3 + axes)."""
    check_regular(path)
    try:
        with path.open(newline="", encoding="utf-8") as file:
            lines = list(csv.reader(file))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise UnusableInputError(f"{path}: {error}") from None
    header = lines[0] if lines else []
    units = tuple("m" if f"position_{axis} [m]" in header else "rad" for axis in axes)
    wanted = ["exposure_id", "start [s]", "width [s]", *(f"position_{axis} [{unit}]" for axis, unit in zip(axes, units, strict=True))]
    if header != wanted:
        raise UnusableInputError(f"{path}: the first line must be {','.join(wanted)}")
    numbers = np.full((len(lines) - 1, len(wanted)), np.nan)
    for k, line in enumerate(lines[1:]):
        if len(line) != len(wanted):
            raise UnusableInputError(f"{path}: line {k + 2} has {len(line)} cells; {len(wanted)} belong there")
        for column, cell in enumerate(line):
            if not cell and column >= 3:
                continue
            try:
                numbers[k, column] = float(cell)
            except ValueError:
                raise UnusableInputError(f"{path}: line {k + 2}, {wanted[column]}: {cell!r} is no number") from None
    if not len(numbers):
        raise UnusableInputError(f"{path}: no exposure")
    if not np.isfinite(numbers[:, :3]).all() or (np.diff(numbers[:, 1]) <= 0.0).any() or (numbers[:, 2] < 0.0).any():
        raise UnusableInputError(f"{path}: starts must rise and widths be 0 or more; is the panel's clock the loop's?")
    return units, numbers
