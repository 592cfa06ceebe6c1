"""Whether the browser that started a motion is still there: it answers pings, or the motion is stopped.

The page answers from a worker, which a browser does not slow down when the tab is hidden.
"""

from __future__ import annotations

import secrets
import time
from collections.abc import Callable

SILENT_S = 2.0
"""Time without an answer after which the motion that a browser started is stopped."""
PING_S = 0.25
"""Interval of pings, each of which tells the state: four times a second are read as live, and some late answers do not stop a motion."""
FORGET_S = 3600.0
AWAY_S = 5.0
"""Time without any client in which one may be back: a page that is reloaded takes less."""


class Attention:
    """Clients, and when each has answered last.

    Parameters
    ----------
    now : callable
        Monotonic time [s].
    """

    def __init__(self, now: Callable[[], float] = time.monotonic) -> None:
        self._now = now
        self._heard: dict[str, float] = {}
        self._connected: set[str] = set()
        self._left_s = float("-inf")

    def welcome(self, client: str) -> str:
        """Return the name of a client that has connected: its own, where it was here before and has left, or a new one.

        A tab that was duplicated asks for the name of the first: were both one, the second would keep running what the first has started.
        """
        now_s = self._now()
        self._heard = {name: heard_s for name, heard_s in self._heard.items() if now_s - heard_s < FORGET_S}
        if client not in self._heard or client in self._connected:
            client = secrets.token_urlsafe(12)
        self._connected.add(client)
        self._heard[client] = now_s
        return client

    def leave(self, client: str) -> None:
        """Take note that the line to a client has ended."""
        self._connected.discard(client)
        self._left_s = self._now()

    def heard(self, client: str) -> None:
        """Take note of an answer."""
        if client in self._heard:
            self._heard[client] = self._now()

    @property
    def somebody_looks(self) -> bool:
        """Whether a line to any client is open, or was so just now."""
        return bool(self._connected) or self._now() - self._left_s < AWAY_S

    def silent_s(self, client: str) -> float:
        """Return for how long a client has not answered [s]; for ever, where nobody knows it."""
        return self._now() - self._heard.get(client, float("-inf"))

    def is_here(self, client: str) -> bool:
        """Return whether a client has answered lately."""
        return self.silent_s(client) <= SILENT_S
