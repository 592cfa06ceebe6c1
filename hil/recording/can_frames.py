"""CAN frames of a log."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

CSV_HEADER = b"timestamp,arbitration_id,extended,remote,error,dlc,data"
"""First line of python-can's table of frames."""


class CanFrame(NamedTuple):
    """One frame of a log; error frames, which are no frames of the bus, are left out by the readers, and counted."""

    time_s: float  # since the log's own origin of time; NaN in a log without time stamps
    channel: str
    can_id: int
    extended: bool
    remote: bool
    data: bytes
    fd: bool = False


@dataclass(frozen=True)
class CanLog:
    """What a log holds.

    Parameters
    ----------
    frames : sequence of CanFrame
    not_taken : sequence of str
        What else was in it, a kind each, such as `3 error frames`.
    notes : sequence of str
        How it was read where that was not plain.
    """

    frames: Sequence[CanFrame]
    not_taken: Sequence[str] = ()
    notes: Sequence[str] = ()


def counted(number: int, what: str) -> str:
    """Return `1 error frame` or `3 error frames`."""
    return f"{number} {what}{'' if number == 1 else 's'}"


def is_frames_csv(path: Path) -> bool:
    """Return whether a CSV is python-can's table of CAN frames."""
    try:
        with path.open("rb") as file:
            return file.read(len(CSV_HEADER) + 3).removeprefix(b"\xef\xbb\xbf").startswith(CSV_HEADER)
    except OSError:
        return False  # whoever reads it says why
