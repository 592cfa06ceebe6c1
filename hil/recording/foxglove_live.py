"""Recordings live to Foxglove: a WebSocket server in a process of its own, which reads the recorder's journal."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hil.errors import UnusableInputError
from hil.extras import extra_package
from hil.recording.follow import JournalFollower, journals
from hil.recording.json_rows import TOPIC, row_messages, row_schema, started

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
    """Send every recording that is made at a place: in a folder until interrupted, or one recording until its end."""
    if hasattr(os, "nice"):
        os.nice(MODEST)
    while True:
        for part in journals(place):
            try:
                follower = JournalFollower(part)
            except FileNotFoundError:  # it has ended just now
                continue
            with follower:
                sent = _send_all(server, follower)
            say(f"{part.name.removesuffix('.part')}: {sent} rows sent")
            if not place.is_dir():
                return
        time.sleep(POLL_S)


def _send_all(server: FoxgloveServer, follower: JournalFollower) -> int:
    """Send a recording to its end; return the number of rows. Times are those of this computer where the recording does not say its own."""
    sent, started_ns = 0, 0
    while not follower.ended:
        rows = follower.rows()
        if len(rows):
            if not sent:
                server.begin(follower.channels)
                first_s = float(rows[0, [name for name, _ in follower.channels].index("time")])
                started_ns = started(follower.metadata) or time.time_ns() - round(first_s * 1e9)
            server.send(follower.channels, rows, started_ns)
            sent += len(rows)
        if not follower.ended:
            time.sleep(POLL_S)
    return sent
