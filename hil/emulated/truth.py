"""The truth file: values that only an emulator knows, one row per sample, kept apart from the recording."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TextIO

import numpy as np

from hil.errors import UnusableInputError
from virtual_bus.settings import Joint

QUANTITIES = {"joint_position": "{length}", "joint_speed": "{length}/s", "friction_effort": "{effort}"}
"""Columns that exist for every joint, and their units."""


class TruthLog:
    """A CSV that grows while the machine is emulated. Header cells are `name [unit]`, poses as position and rotation by rows.

    Parameters
    ----------
    path : Path
    joints : sequence of Joint
        Joints of the plant in its order, which give the columns' names and units.

    Raises
    ------
    UnusableInputError
        The file cannot be written.
    """

    def __init__(self, path: Path, joints: Sequence[Joint]) -> None:
        self.path = path
        self._joints = tuple(joints)
        try:
            self._file: TextIO = path.open("w", encoding="utf-8")
        except OSError as error:
            raise UnusableInputError(f"--truth {path}: cannot be written: {error.strerror}") from None
        self._header = False
        self.recording = True  # the bench clears this to leave out rows before row 0 of a recording

    def add(self, time_s: float, truth: Mapping[str, np.ndarray]) -> None:
        """Write the row of one instant."""
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
        """Flush everything to the disk and close the file."""
        self._file.close()

    def _columns(self, name: str, values: np.ndarray) -> list[str]:
        if name.startswith("pose_"):
            parts = [f"{axis} [m]" for axis in "xyz"] + [f"r{row}{column}" for row in "123" for column in "123"]
            return [f"{name}_{part}" for part in parts]
        unit = QUANTITIES[name]
        return [f"{name}_{joint.name} [{unit.format(**_UNITS[joint.kind])}]" for joint in self._joints]


_UNITS = {"revolute": {"length": "rad", "effort": "Nm"}, "prismatic": {"length": "m", "effort": "N"}}
