"""What a reader of another tool's file says besides the recording: kept in its metadata, and warned of in one line."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from hil.recording.warning import RecordingWarning

MOST_NAMED = 20
"""Names in one message; more would hide the rest of it."""


def source_table(
    path: Path, not_taken: Sequence[str] = (), notes: Sequence[str] = (), names: Mapping[str, str] | None = None, **tables: object
) -> dict[str, Any]:
    """Return the metadata's table `source`, and warn of what could not be taken and of how the rest was.

    Parameters
    ----------
    path : Path
        The file that was read.
    not_taken : sequence of str
        What is in the file and not in the recording.
    notes : sequence of str
        What was done to get the rest: resampled, summed, taken in another unit.
    names : mapping, optional
        Name in the file -> channel, where they differ.
    tables
        Further entries.
    """
    if not_taken:
        warnings.warn(f"{path}: not taken: {listed(not_taken)}", RecordingWarning, stacklevel=3)
    for note in notes:
        warnings.warn(f"{path}: {note}", RecordingWarning, stacklevel=3)
    parts: dict[str, Any] = {"names": dict(names or {}), "not_taken": list(not_taken), "notes": list(notes), **tables}
    return {"file": path.name} | {name: part for name, part in parts.items() if part}


def listed(names: Sequence[str]) -> str:
    """Return names in one line, `?` for what cannot be printed; of very many the first."""
    more = len(names) - MOST_NAMED
    line = "; ".join(names[:MOST_NAMED]) + (f"; and {more} more" if more > 0 else "")
    return printable(line)


def printable(text: str) -> str:
    """Return a text with `?` for what cannot be printed."""
    return "".join(letter if letter.isprintable() else "?" for letter in text)
