"""What the pages say of where they come from: machine, files, pose, and whether a real machine was recorded."""

from __future__ import annotations

import math
import shlex
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from hil.machine import Machine
from hil.machine.load import name_of_recorded
from hil.recording import Recording

HASH_LETTERS = 12


def machine_fact(machine: Machine) -> str:
    """Return the name of a machine and the beginning of its file's hash."""
    return f"{machine.name} ({machine.hash[:HASH_LETTERS]})"


def recorded_machine(recordings: Iterable[Recording]) -> str:
    """Return name and hash of the machines that recordings name, "" where none does."""
    tables = [table for recording in recordings if (table := recording.metadata.get("machine", {})).get("name")]
    return ", ".join(dict.fromkeys(f"{table['name']} ({str(table.get('hash', ''))[:HASH_LETTERS]})" for table in tables))


def recorded_name(recording: Recording) -> str:
    """Return what the command line takes for the machine that a recording names."""
    table = recording.metadata.get("machine", {})
    return name_of_recorded(str(table.get("name", "")), str(table.get("hash", "")))


def files_fact(paths: Sequence[Path], most: int = 6) -> str:
    """Return the names of files, the first of many."""
    names = [path.name for path in paths[:most]]
    return ", ".join(names) + (f" and {len(paths) - most} more" if len(paths) > most else "")


def was_emulated(recordings: Iterable[Recording]) -> bool:
    """Return whether one of the recordings says that it is of an emulated machine."""
    return any(recording.emulated for recording in recordings)


def pose_of(recording: Recording) -> str:
    """Return where an experiment began, in degrees and millimetres; "" where the recording does not say."""
    pose = recording.experiment.get("start_pose")
    if not isinstance(pose, list) or len(pose) != len(recording.axes):
        return ""
    units = {axis: recording.channels[name].unit for axis in recording.axes if (name := f"position_{axis}") in recording}
    return pose_words({axis: (float(value), units.get(axis, "rad")) for axis, value in zip(recording.axes, pose, strict=True)})


def pose_words(pose: Mapping[str, tuple[float, str]]) -> str:
    """Return a pose in words, from (value, unit) of each axis."""
    scales = {"rad": (180.0 / math.pi, "°"), "m": (1e3, " mm")}
    parts = []
    for axis, (value, unit) in pose.items():
        factor, sign = scales.get(unit, (1.0, f" {unit}"))
        parts.append(f"{axis} {round(value * factor, 3) + 0.0:.4g}{sign}")
    return ", ".join(parts)


def command_line(*words: object) -> str:
    """Return a command as it is typed."""
    return " ".join(["isocenter", *(shlex.quote(str(word)) for word in words)])
