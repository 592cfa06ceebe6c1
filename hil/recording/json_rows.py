"""Rows of a recording as JSON messages, whose schema has the units: in MCAP files and live to Foxglove."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from datetime import datetime
from typing import Any

import numpy as np

TOPIC = "/isocenter/recording"
SCHEMA_NAME = "isocenter.recording"


def row_schema(channels: Sequence[tuple[str, str]]) -> dict[str, Any]:
    """Return the JSON schema of a row, by name and unit of its channels.

    Every channel is a plain number, as Foxglove wants it; a message leaves out what is missing.
    """
    properties = {name: {"type": "number", "unit": unit, "description": f"[{unit}]"} for name, unit in channels}
    return {"title": SCHEMA_NAME, "type": "object", "properties": properties}


def row_messages(channels: Sequence[tuple[str, str]], rows: np.ndarray, started_ns: int) -> Iterator[tuple[int, bytes]]:
    """Yield the time [ns since 1970] and the message of every row (n, channels); missing values are left out."""
    names = [name for name, _ in channels]
    time = names.index("time")
    for values in rows.tolist():
        text = json.dumps({name: value for name, value in zip(names, values, strict=True) if value == value})
        # JSON has no word for it, and a number beyond every double is read as one by all
        text = text.replace(": Infinity", ": 1e999").replace(": -Infinity", ": -1e999")
        yield max(0, started_ns + round(values[time] * 1e9)), text.encode()


def started(metadata: Mapping[str, Any]) -> int:
    """Return when the recording began [ns since 1970]; 0 where it does not say."""
    try:
        began = datetime.fromisoformat(str(metadata.get("started", "")))
    except ValueError:
        return 0
    return max(0, round(began.timestamp() * 1e6) * 1000)
