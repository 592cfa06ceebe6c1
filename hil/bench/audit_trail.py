"""The audit trail of a run on the disk: a JSON object per line beside the recording, and a table inside its metadata."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from drivers.events import Event, Events
from hil.files.atomic import write_atomically

DIGITS = 6
"""Decimals of an event's time: microseconds, finer than any clock of the bench."""


def events_path(recording: Path) -> Path:
    """Return where the events of a recording stand: `run.events.jsonl` beside `run.mf4`."""
    return recording.with_suffix(".events.jsonl")


def events_table(events: Events) -> list[dict[str, Any]]:
    """Return the metadata's entry `events`: the time since the session began, who, what, and the details."""
    return [_plain(event) for event in _kept(events)]


def write_events(events: Events, recording: Path) -> None:
    """Write the events beside a recording.

    Raises
    ------
    RecordingError
        The file cannot be written.
    """
    lines = "".join(json.dumps(entry, ensure_ascii=False) + "\n" for entry in events_table(events))
    write_atomically({events_path(recording): lines.encode()})


def _plain(event: Event) -> dict[str, Any]:
    return {"time_s": round(event.time_s, DIGITS), "who": event.who, "what": event.what, **event.details}


def _kept(events: Events) -> list[Event]:
    """Return the events, with one that says how many are missing where some are."""
    kept = events.all()
    if events.dropped:
        kept.append(Event(kept[-1].time_s, "bench", "events dropped", {"events": events.dropped}))
    return kept
