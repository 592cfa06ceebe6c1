"""Recordings live to Foxglove: a WebSocket server in a process of its own, which reads the recorder's journal."""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hil.errors import RecordingError, UnusableInputError
from hil.extras import extra_package
from hil.recording.journal import part_path
from hil.recording.json_rows import TOPIC, row_messages, row_schema, started
from hil.recording.tail import JournalTail

POLL_S = 0.05
"""As often as the recorder writes."""

BACKLOG = 4096
"""Messages kept for a client that is slow; the oldest go first. Ten seconds at 256 Hz, a second and a half of catching up at the begin."""

MODEST = 10
"""Niceness: the loop and the recorder go first."""


class FoxgloveServer:
    """Serves rows on one topic, whose schema changes with the recording.

    Raises
    ------
    UnusableInputError
        foxglove-sdk is not installed, or the port is taken.
    """

    def __init__(self, host: str, port: int) -> None:
        self._foxglove = extra_package("foxglove", "live views in Foxglove")
        self._context = self._foxglove.Context()
        try:
            self._server = self._foxglove.start_server(
                name="isocenter", host=host, port=port, context=self._context, message_backlog_size=BACKLOG
            )
        except (RuntimeError, OSError) as error:
            raise UnusableInputError(f"--port {port}: cannot be served on {host}: {error}") from None
        self._channel: Any = None
        self._schema: dict[str, Any] = {}

    @property
    def port(self) -> int:
        """Port that it listens on."""
        return int(self._server.port)

    def begin(self, channels: Sequence[tuple[str, str]]) -> None:
        """Begin a recording: viewers forget the one before."""
        if self._channel is not None:
            self._server.clear_session()
        schema = row_schema(channels)
        if schema != self._schema:
            if self._channel is not None:
                self._channel.close()
            self._channel = self._foxglove.Channel(TOPIC, schema=schema, message_encoding="json", context=self._context)
            self._schema = schema

    def send(self, channels: Sequence[tuple[str, str]], rows: np.ndarray, started_ns: int) -> None:
        """Send rows (n, channels)."""
        for time_ns, message in row_messages(channels, rows, started_ns):
            self._channel.log(message, log_time=time_ns)

    def close(self) -> None:
        """End."""
        self._server.stop()


def serve(place: Path, server: FoxgloveServer, say: Callable[[str], None]) -> None:
    """Send every recording that is made at a place: in a folder the newest, until interrupted, or one recording until its end."""
    if hasattr(os, "nice"):
        os.nice(MODEST)
    while True:
        if (part := _newest(place)) is not None:
            with contextlib.suppress(RecordingError):  # its header is not whole yet, or it has ended just now
                tail = JournalTail(part)
                try:
                    sent = _send_all(server, tail, place)
                finally:
                    tail.close()
                say(f"{part.name.removesuffix('.part')}: {sent} rows sent")
                if not place.is_dir():
                    return
        time.sleep(POLL_S)


def _newest(place: Path) -> Path | None:
    """Return the newest journal in a folder, or that of one recording."""
    parts = place.glob("*.part") if place.is_dir() else [part_path(place)]
    there = []
    for part in parts:
        with contextlib.suppress(FileNotFoundError):
            there.append((part.stat().st_mtime_ns, part))
    return max(there)[1] if there else None


def _send_all(server: FoxgloveServer, tail: JournalTail, place: Path) -> int:
    """Send a recording until it ends or a newer one begins; return the number of rows.

    Times are those of this computer where the recording does not say its own.
    """
    begun, started_ns, ended = False, 0, False
    time_column = [name for name, _ in tail.channels].index("time")
    while not ended:
        ended = tail.ended or _newest(place) not in (None, tail.path)  # asked first: what was written last is sent all the same
        for count, values in tail.take():
            rows = np.frombuffer(values, dtype="<f8").reshape(count, len(tail.channels))
            if not begun:
                begun = True
                server.begin(tail.channels)
                started_ns = started(tail.metadata) or time.time_ns() - round(float(rows[0, time_column]) * 1e9)
            server.send(tail.channels, rows, started_ns)
        if not ended:
            time.sleep(POLL_S)
    return tail.rows
