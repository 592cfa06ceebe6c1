"""MCAP recordings (`.mcap`): a JSON message per row on one topic, whose schema has the units, and the metadata as an attached TOML text.

Foxglove and any MCAP tool can show them. A file of another tool is a bag: see `bag`.
"""

from __future__ import annotations

import io
import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hil.errors import RecordingError
from hil.files.atomic import write_atomically
from hil.recording.bag import bag_of_mcap, recording_of_bag
from hil.recording.json_rows import SCHEMA_NAME, TOPIC, row_messages, row_schema, started
from hil.recording.mcap_stream import mcap_package
from hil.recording.metadata import metadata_text, parse_metadata
from hil.recording.naming import Column, Columns, Target, named_channels
from hil.recording.recording import Recording

if TYPE_CHECKING:
    from hil.machine.machine import Machine

ATTACHMENT = "recording.toml"


def write_mcap(recording: Recording, path: Path) -> None:
    """Write a recording; numbers read back bit for bit.

    Raises
    ------
    RecordingError
        The file cannot be written.
    UnusableInputError
        mcap is not installed.
    """
    started_ns = started(recording.metadata)
    channels = [(name, channel.unit) for name, channel in recording.channels.items()]
    metadata = metadata_text({**recording.metadata, "rows": recording.rows})
    content = io.BytesIO()
    writer = mcap_package("mcap.writer").Writer(content)
    writer.start(library="isocenter")
    schema_id = writer.register_schema(SCHEMA_NAME, "jsonschema", json.dumps(row_schema(channels)).encode())
    channel_id = writer.register_channel(TOPIC, "json", schema_id)
    writer.add_attachment(started_ns, started_ns, ATTACHMENT, "application/toml", metadata.encode())
    rows = recording.matrix(list(recording.channels))
    for row, (time_ns, message) in enumerate(row_messages(channels, rows, started_ns)):
        writer.add_message(channel_id, time_ns, message, time_ns, row)
    writer.finish()
    write_atomically({path: content.getvalue()})


def read_mcap(path: Path, machine: Machine | None = None, names: Mapping[str, Target] | None = None) -> Recording:
    """Read a recording of this project, or a bag.

    Raises
    ------
    RecordingError
        The file is damaged, or as in `recording_of_bag`.
    UnusableInputError
        mcap is not installed.
    """
    bag = bag_of_mcap([path])
    text = bag.attachments.get(ATTACHMENT)
    if text is None or TOPIC not in bag.rows:
        return recording_of_bag(bag, path, machine, names)
    metadata = parse_metadata(text.decode(errors="replace"), f"{path}: {ATTACHMENT}")
    rows = metadata.pop("rows", None)
    messages = [message for _, _, message in bag.rows[TOPIC]]
    if rows != len(messages):
        raise RecordingError(f"{path}: {len(messages)} rows, but its {ATTACHMENT} says rows = {rows}; the file was cut off or edited")
    columns = {name: Column(_values(messages, name, path), unit) for name, unit in _units(bag.schemas.get(TOPIC, b""), path).items()}
    wanted = {name: Target(name) for name in columns if name not in (names or {})} | dict(names or {})
    channels, _ = named_channels(Columns(columns), wanted, machine, path)
    try:
        return Recording({one.channel: channels[one.channel] for one in wanted.values()}, metadata)
    except RecordingError as problem:
        raise RecordingError(f"{path}: {problem}") from None


def _units(schema: bytes, path: Path) -> dict[str, str]:
    try:
        properties = json.loads(schema)["properties"]
        return {str(name): str(entry["unit"]) for name, entry in properties.items()}
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError):
        raise RecordingError(f"{path}: damaged: topic {TOPIC} without a schema that has units") from None


def _values(messages: list[dict[str, Any]], name: str, path: Path) -> np.ndarray:
    values = [message.get(name) for message in messages]
    if not all(value is None or isinstance(value, int | float) for value in values):
        raise RecordingError(f"{path}: damaged: {name} is no number in a row")
    return np.array([np.nan if value is None else value for value in values], dtype=np.float64)
