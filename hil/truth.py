"""The truth file: what only an emulator knows, one row per sample, kept apart from the recording."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TextIO

import numpy as np


class TruthLog:
    """A CSV that grows while the machine is emulated. Header cells are `name [unit]`, poses as position and rotation by rows.

    Parameters
    ----------
    path : Path
    joints : tuple of str, optional
        Names for the joint columns; numbers unless given.
    """

    def __init__(self, path: Path, joints: tuple[str, ...] = ()) -> None:
        self.path = path
        self._joints = joints
        self._file: TextIO = path.open("w", encoding="utf-8")
        self._header = False
        self.recording = True  # rows before row 0 of a recording are left out by whoever clears this

    def add(self, time_s: float, truth: Mapping[str, np.ndarray]) -> None:
        """One instant."""
        if not self.recording:
            return
        if not self._header:
            self._file.write(
                ",".join(["time [s]", *(column for name, values in truth.items() for column in self._columns(name, values))]) + "\n"
            )
            self._header = True
        numbers = [time_s, *(value for values in truth.values() for value in values)]
        self._file.write(",".join(repr(float(number)) for number in numbers) + "\n")

    def close(self) -> None:
        """Everything is on the disk after this."""
        self._file.close()

    def _columns(self, name: str, values: np.ndarray) -> list[str]:
        if name.startswith("pose_"):
            parts = [f"{axis} [m]" for axis in "xyz"] + [f"r{row}{column}" for row in "123" for column in "123"]
            return [f"{name}_{part}" for part in parts]
        joints = self._joints or tuple(str(index) for index in range(len(values)))
        return [f"{name}_{joint}" for joint in joints]
