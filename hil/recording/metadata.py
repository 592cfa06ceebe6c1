"""Metadata of a recording: machine, experiment, initial states, software, as tables that TOML can hold."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from typing import Any, Protocol

from hil.errors import RecordingError
from hil.files.toml_text import plain, toml_text
from hil.version import software_version

RECORDING_FORMAT = 1
"""Key `recording_format`: marks a TOML text as a recording's metadata, so that a machine file of the same name is not mistaken for it."""


class MachineFile(Protocol):
    """The properties of a machine that a recording keeps."""

    @property
    def name(self) -> str:
        """Name of the machine."""

    @property
    def text(self) -> str:
        """Text of the machine file."""

    @property
    def hash(self) -> str:
        """SHA-256 of the text."""

    @property
    def axes(self) -> tuple[str, ...]:
        """Names of the axes."""


def machine_table(machine: MachineFile) -> dict[str, Any]:
    """Return the metadata's table `machine`."""
    return {"name": machine.name, "hash": machine.hash, "axes": list(machine.axes), "text": machine.text}


def recording_metadata(
    machine: MachineFile, experiment: Mapping[str, Any] | None = None, initial: Mapping[str, Any] | None = None, **tables: object
) -> dict[str, Any]:
    """Return the metadata of a new recording.

    Parameters
    ----------
    machine : MachineFile
        A loaded machine.
    experiment : mapping, optional
        The plan's metadata: kind, period_samples, settle_periods, realisation, experiment, excited_lines, seed, ...
    initial : mapping, optional
        States at row 0: `controller_states` (per axis), `brakes`, `seed` of the emulator.
    tables
        Further tables.
    """
    parts = {"machine": machine_table(machine), "experiment": experiment, "initial": initial, **tables}
    return plain({"software": software_version(), **{name: part for name, part in parts.items() if part is not None}})


def metadata_text(metadata: Mapping[str, Any]) -> str:
    """Return the TOML text of a recording's metadata, marked as such."""
    return toml_text({"recording_format": RECORDING_FORMAT, **{key: value for key, value in metadata.items() if key != "recording_format"}})


def parse_metadata(text: str, where: str) -> dict[str, Any]:
    """Read metadata from TOML text; `where` names the file in the error."""
    try:
        metadata = tomllib.loads(text)
    except (tomllib.TOMLDecodeError, RecursionError) as problem:
        raise RecordingError(f"{where}: no TOML: {problem}") from None
    if metadata.pop("recording_format", None) != RECORDING_FORMAT:
        raise RecordingError(
            f"{where}: no recording's metadata: it lacks `recording_format = {RECORDING_FORMAT}`;"
            " add that line, or, if it is another file, a machine's say, give it another name than the recording's"
        )
    for table in ("machine", "experiment", "initial"):
        if not isinstance(metadata.get(table, {}), dict):
            raise RecordingError(f"{where}: `{table}` must be a table")
    return metadata
