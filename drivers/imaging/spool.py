"""Frames in a folder, one file each: a panel writes them there and the bench reads them as they appear.

A file is written under another name and renamed when it is complete, so that nobody reads half a frame. Any detector whose software can
write a file per frame can be used; `Frame` lists what the file must hold.
"""

from __future__ import annotations

import os
import zipfile
import zlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from drivers.errors import DriverError

FORMAT = 1
PATTERN = "frame_*.npz"
MOST_BYTES = 2**28  # unpacked; the largest flat panels have 16 million pixels of two bytes


class SpoolError(DriverError):
    """The folder of a panel does not hold valid frames.

    Example scenarios
    -----------------
    - The folder does not exist, or cannot be read.
    - A file in it is named like a frame but is none, or two frames have one number.
    """


@dataclass(frozen=True)
class Frame:
    """One exposure.

    Attributes
    ----------
    exposure_id : int
        Number of the exposure; counts up by one.
    panel_s, width_s : float
        Start and length by the panel's clock.
    pulse_s : float
        Loop time of the tick at which the exposure's pulse was first seen; for a panel that counts SYNCs, in periods of SYNC since row 0.
    image : (rows, columns) uint16 array
    """

    exposure_id: int
    panel_s: float
    width_s: float
    pulse_s: float
    image: np.ndarray


def write_frame(folder: Path, frame: Frame) -> None:
    """Write a frame into a folder, as a panel does."""
    whole = folder / f"frame_{frame.exposure_id:06d}.npz"
    partial = whole.with_suffix(".partial")
    with partial.open("wb") as file:
        numbers = np.array([frame.panel_s, frame.width_s, frame.pulse_s])
        np.savez(file, format=FORMAT, exposure_id=frame.exposure_id, times_s=numbers, image=frame.image)
    os.replace(partial, whole)


class FrameSpool:
    """The folder of a panel, read from its first frame; a skipped number is a lost frame.

    Parameters
    ----------
    folder : Path
    """

    def __init__(self, folder: Path) -> None:
        if not folder.is_dir():
            raise SpoolError(f"{folder}: no folder; the panel's software must write its frames there")
        self.folder = folder
        self._seen: set[Path] = set()
        self._next: int | None = None

    def poll(self) -> list[Frame]:
        """Return the frames that have appeared since the last call, in order.

        Raises
        ------
        SpoolError
            A frame cannot be read, or its number has been used.
        """
        fresh = sorted(set(self.folder.glob(PATTERN)) - self._seen)
        frames = [self._read(path) for path in fresh]
        self._seen.update(fresh)
        for frame in frames:
            if self._next is not None and frame.exposure_id < self._next:
                raise SpoolError(f"{self.folder}: frame {frame.exposure_id} after frame {self._next - 1}; is an earlier run's still there?")
            self._next = frame.exposure_id + 1
        return frames

    @staticmethod
    def _read(path: Path) -> Frame:
        try:
            if not path.is_file():
                raise SpoolError(f"{path}: is a folder, device or pipe: a frame is a regular file")
            with zipfile.ZipFile(path) as archive:
                claimed = sum(entry.file_size for entry in archive.infolist())
            if claimed > MOST_BYTES:
                raise SpoolError(f"{path}: claims {claimed} bytes unpacked; a frame has at most {MOST_BYTES}")
            with np.load(path, allow_pickle=False) as file:
                if int(file["format"]) != FORMAT:
                    raise SpoolError(f"{path}: format {int(file['format'])}; this version reads {FORMAT}")
                panel_s, width_s, pulse_s = (float(value) for value in file["times_s"])
                frame = Frame(int(file["exposure_id"]), panel_s, width_s, pulse_s, file["image"])
        except (OSError, KeyError, TypeError, ValueError, EOFError, MemoryError, zipfile.BadZipFile, zlib.error) as error:
            raise SpoolError(f"{path}: no frame of a panel ({error})") from None
        if frame.image.dtype != np.uint16:
            raise SpoolError(f"{path}: the image is of {frame.image.dtype}; photon counts are uint16")
        if frame.image.ndim != 2 or not np.isfinite([panel_s, width_s, pulse_s]).all() or width_s < 0.0:
            raise SpoolError(f"{path}: a frame is one image with a start, a width of 0 or more and a pulse")
        return frame
