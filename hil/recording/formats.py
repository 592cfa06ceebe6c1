"""Reading, writing and converting recordings in the format of a file's suffix."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import TYPE_CHECKING

from hil.errors import RecordingError
from hil.files.regular import check_regular
from hil.recording.csv_table import read_csv, write_csv
from hil.recording.journal import part_path, recover
from hil.recording.model import Recording
from hil.recording.ticks import gap_words
from hil.recording.warning import RecordingWarning

if TYPE_CHECKING:
    from hil.machine.model import Machine

READABLE = (".mf4", ".csv", ".mat", ".log", ".blf")
WRITABLE = (".mf4", ".csv")


def read_recording(path: str | Path, machine: Machine | None = None, names: dict[str, str] | None = None) -> Recording:
    """Read a recording of any readable format.

    Parameters
    ----------
    path : str or Path
        `.mf4`, `.csv`, `.mat`, candump `.log`, `.blf`, or the `.part` of a recording that was cut short. Where the file is missing and its
        `.part` is there, that is read instead, with a warning; metadata then hold a table `recovered`.
    machine : Machine, optional
        A loaded machine, for files that do not name their machine.
    names : dict, optional
        For `.mat`: variable of the file -> channel.

    Raises
    ------
    RecordingError
        The file cannot be read; one line says what is wrong, where, and what would be right.
    """
    path = Path(path)
    part = part_path(path)
    if path.is_dir():
        raise RecordingError(f"{path}: is a folder; give the recordings in it")
    check_regular(path, RecordingError)
    if path.suffix == ".part":
        return recover(path)
    _check_suffix(path, READABLE, "read")
    if not path.exists():
        if not part.exists():
            raise RecordingError(f"{path}: no such file")
        recording = recover(part)
        warnings.warn(f"{path}: was not closed; {recording.rows} rows read from {part.name}", RecordingWarning, stacklevel=2)
        return recording
    if part.exists():
        warnings.warn(f"{path}: an unfinished recording of the same name is beside it: {part.name}", RecordingWarning, stacklevel=2)
    recording = _read(path, machine, names)
    if words := gap_words(recording):
        warnings.warn(f"{path}: {words}", RecordingWarning, stacklevel=2)
    return recording


def _read(path: Path, machine: Machine | None, names: dict[str, str] | None) -> Recording:
    match path.suffix.lower():
        case ".csv":
            return read_csv(path, machine)
        case ".mf4":
            from hil.recording.mdf4 import read_mdf4  # asammdf takes half a second to import

            return read_mdf4(path, machine)
        case ".mat":
            from hil.recording.mat import read_mat

            return read_mat(path, machine, names)
        case _:
            from hil.recording.can_signals import read_can

            return read_can(path, machine)


def write_recording(recording: Recording, path: str | Path) -> None:
    """Write a recording as `.mf4` or `.csv` (with its `.toml`); an incomplete file is never left.

    Raises
    ------
    RecordingError
        The suffix is another one, or the file cannot be written.
    """
    path = Path(path)
    check_writable(path)
    if path.suffix.lower() == ".csv":
        write_csv(recording, path)
    else:
        from hil.recording.mdf4 import write_mdf4

        write_mdf4(recording, path)


def convert(source: str | Path, target: str | Path, machine: Machine | None = None, names: dict[str, str] | None = None) -> Recording:
    """Read `source`, write `target`, return what was read."""
    check_writable(Path(target))
    recording = read_recording(source, machine, names)
    write_recording(recording, target)
    return recording


def check_writable(path: Path) -> None:
    """Raise RecordingError if a recording cannot be written under that name."""
    _check_suffix(path, WRITABLE, "written")


def _check_suffix(path: Path, suffixes: tuple[str, ...], verb: str) -> None:
    if path.suffix.lower() not in suffixes:
        raise RecordingError(f"{path}: a recording cannot be {verb} as `{path.suffix}`; {', '.join(suffixes)} can")
