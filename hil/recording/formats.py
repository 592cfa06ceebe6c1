"""Reading, writing and converting recordings in the format of a file's suffix."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from hil.errors import RecordingError
from hil.extras import extra_package
from hil.files.regular import check_regular
from hil.recording.can_frames import is_frames_csv
from hil.recording.candump import is_candump
from hil.recording.csv_table import read_csv, write_csv
from hil.recording.journal import part_path, recover
from hil.recording.naming import Target, target
from hil.recording.recording import Recording
from hil.recording.ticks import gap_words
from hil.recording.warning import RecordingWarning

if TYPE_CHECKING:
    from hil.machine.machine import Machine

WRITABLE = (".mf4", ".csv", ".parquet", ".mcap")
READABLE = (*WRITABLE, ".mdf", ".dat", ".mat", ".db3", ".log", ".blf", ".asc", ".trc", ".db")
TEXTS = (".txt", ".tsv")
"""Suffixes of tables and of what candump prints, and of any other text: read where one is given, not looked for in folders."""

BAG_MARK = "metadata.yaml"
"""File by which a folder is a bag of ROS 2."""

_WRITTEN_BY = {".parquet": ("pyarrow", "Parquet files"), ".mcap": ("mcap", "MCAP files")}
"""Package of an extra that writes a format, and what the message calls it."""

_FIRST = {
    (".gz", ".bz2", ".xz", ".zip", ".zst", ".7z"): "unpack it first",
    (".bag",): "`rosbags-convert --src IN.bag --dst OUT` makes a bag of ROS 2 of it",
    (".tdms",): 'nptdms does: `nptdms.TdmsFile("IN").as_dataframe(time_index=True).to_csv("OUT.csv", index_label="time [s]")`',
    (".xlsx", ".xls", ".ods"): 'save its sheet as CSV, or `pandas.read_excel("IN").to_csv("OUT.csv", index=False)`',
    (".h5", ".hdf5", ".hdf", ".feather", ".arrow", ".pkl", ".pickle", ".json", ".jsonl", ".npz", ".npy"): (
        'put its columns into a table of pandas and `to_csv("OUT.csv", index=False)` or `to_parquet`'
    ),
    (".ulg",): "`ulog2csv IN` makes a CSV of each topic",
    (".dbc", ".eds", ".dcf"): "it says what frames mean and holds none",
}
"""Suffixes of files that others bring -> what makes a readable one of them."""

PART = "part"
"""What `names` makes of a sender, bus or run, where a file has several: its samples alone are taken."""

Names = Mapping[str, str | Target]
"""Name in another tool's file -> channel."""


def read_recording(path: str | Path, machine: Machine | None = None, names: Names | None = None) -> Recording:
    """Read a recording of any readable format.

    Parameters
    ----------
    path : str or Path
        Any of `READABLE`, the folder of a ROS 2 bag, or the `.part` of a recording that was cut short. Where the file is missing and its
        `.part` is there, that is read instead, with a warning; metadata then hold a table `recovered`.
    machine : Machine, optional
        A loaded machine, for files that do not name their machine.
    names : mapping, optional
        Name in another tool's file -> channel, as `"position_roll"`, `"position_roll [deg]"` or a `Target`. Where a file has several
        senders, buses or runs, its refusal names the parts that can be taken, such as `{"@1": "part"}` or `{"can0": "part"}`.

    Raises
    ------
    RecordingError
        The file cannot be read; one line says what is wrong, where, and what would be right.

    Examples
    --------
    >>> import hil
    >>> made = hil.Recording({"time": hil.Channel("s", [0.0, 0.005]), "position_roll": hil.Channel("rad", [0.0, 0.1])}, {})
    >>> hil.write_recording(made, "roll.csv")
    >>> recording = hil.read_recording("roll.csv")
    >>> recording.sample_rate_Hz, recording["position_roll"].tolist()
    (200.0, [0.0, 0.1])
    """
    path = Path(path)
    targets = {name: target(one, f"{path}: {name}") if isinstance(one, str) else one for name, one in (names or {}).items()}
    part = part_path(path)
    if path.is_dir() and (path / BAG_MARK).exists():
        return _said_gaps(path, _read(path, machine, targets))
    if path.is_dir():
        raise RecordingError(f"{path}: is a folder; give the recordings in it")
    check_regular(path, RecordingError)
    if path.suffix == ".part":
        return recover(path)
    _check_suffix(path, (*READABLE, *TEXTS), "read")
    if not path.exists():
        if not part.exists():
            raise RecordingError(f"{path}: no such file")
        recording = recover(part)
        warnings.warn(f"{path}: was not closed; {recording.rows} rows read from {part.name}", RecordingWarning, stacklevel=2)
        return recording
    if part.exists():
        warnings.warn(f"{path}: an unfinished recording of the same name is beside it: {part.name}", RecordingWarning, stacklevel=2)
    return _said_gaps(path, _read(path, machine, targets))


def _said_gaps(path: Path, recording: Recording) -> Recording:
    """Return the recording; warn of rows that are missing in it."""
    if words := gap_words(recording):
        warnings.warn(f"{path}: {words}", RecordingWarning, stacklevel=3)
    return recording


def _read(path: Path, machine: Machine | None, names: Mapping[str, Target]) -> Recording:
    parts = [name for name, one in names.items() if one.channel == PART]
    if len(parts) > 1:
        raise RecordingError(f"{path}: {' and '.join(parts)} are to be part; one is taken at a time")
    part, names = "".join(parts), {name: one for name, one in names.items() if one.channel != PART}
    match path.suffix.lower() if path.is_file() else "":
        case ".txt" if is_candump(path):
            from hil.recording.can_signals import read_can

            return read_can(path, machine, part)
        case ".csv" | ".txt" | ".tsv" if not is_frames_csv(path):
            return read_csv(path, machine, names, part)
        case ".mf4" | ".mdf" | ".dat":
            from hil.recording.mdf4 import read_mdf4  # asammdf takes half a second to import

            return read_mdf4(path, machine, names, part)
        case ".mat":
            from hil.recording.mat import read_mat

            return read_mat(path, machine, names or None, part)
        case ".parquet":
            from hil.recording.parquet import read_parquet

            return read_parquet(path, machine, names, part)
        case ".mcap" | ".db3" | "" if part:
            instead = "`/joint_states.position[roll]@1=position_roll`"
            raise RecordingError(f"{path}: {part}=part: a bag names the parts of its signals, such as {instead}")
        case ".mcap":
            from hil.recording.mcap_file import read_mcap

            return read_mcap(path, machine, names)
        case ".db3" | "":
            from hil.recording.bag import read_bag

            return read_bag(path, machine, names)
        case _:
            from hil.recording.can_signals import read_can

            if names:
                raise RecordingError(f"{path}: a CAN log has no names but those that the machine file's PDO maps give; leave --map out")
            return read_can(path, machine, part)


def write_recording(recording: Recording, path: str | Path) -> None:
    """Write a recording as `.mf4`, `.csv` (with its `.toml`), `.parquet` or `.mcap`; an incomplete file is never left.

    Raises
    ------
    RecordingError
        The suffix is another one, or the file cannot be written.
    """
    path = Path(path)
    check_writable(path)
    match path.suffix.lower():
        case ".csv":
            write_csv(recording, path)
        case ".parquet":
            from hil.recording.parquet import write_parquet

            write_parquet(recording, path)
        case ".mcap":
            from hil.recording.mcap_file import write_mcap

            write_mcap(recording, path)
        case _:
            from hil.recording.mdf4 import write_mdf4

            write_mdf4(recording, path)


def convert(source: str | Path, target: str | Path, machine: Machine | None = None, names: Names | None = None) -> Recording:
    """Read `source`, write `target`, return what was read."""
    check_writable(Path(target))
    recording = read_recording(source, machine, names)
    write_recording(recording, target)
    return recording


def check_writable(path: Path) -> None:
    """Raise RecordingError if a recording cannot be written under that name, UnusableInputError if what writes it is not installed."""
    _check_suffix(path, WRITABLE, "written")
    if needed := _WRITTEN_BY.get(path.suffix.lower()):
        extra_package(*needed)


def _check_suffix(path: Path, suffixes: tuple[str, ...], verb: str) -> None:
    suffix = path.suffix.lower()
    if suffix not in suffixes:
        first = next((way for others, way in _FIRST.items() if suffix in others), "") if verb == "read" else ""
        raise RecordingError(f"{path}: a recording cannot be {verb} as `{path.suffix}`; {', '.join(suffixes)} can{first and f': {first}'}")
