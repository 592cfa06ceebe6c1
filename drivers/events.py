"""The audit trail of a run: who did or saw what, and when. Memory is bounded; writing it down is the bench's."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

FIRST_KEPT = 256
"""Events of the beginning that are kept for good: a session's commissioning and start have fewer than 50."""

LAST_KEPT = 768
"""Newest events that are kept: a stop and what led to it are always among them."""

Detail = str | float | int | bool


@dataclass(frozen=True)
class Event:
    """One event."""

    time_s: float  # since the session began
    who: str  # "operator", "bench", "loop", or a device by its name
    what: str
    details: Mapping[str, Detail] = field(default_factory=dict)


class Events:
    """Collects the events of a session.

    Parameters
    ----------
    now : callable
        Returns the clock's seconds.

    Attributes
    ----------
    dropped : int
        Events between the first and the newest ones that were not kept.
    """

    def __init__(self, now: Callable[[], float]) -> None:
        self._now = now
        self.begin()

    def begin(self) -> None:
        """Begin a session: its time is zero now, and nothing has happened."""
        self._began_s = self._now()
        self._first: list[Event] = []
        self._last: deque[Event] = deque(maxlen=LAST_KEPT)
        self.dropped = 0

    @property
    def time_s(self) -> float:
        """Seconds since the session began."""
        return self._now() - self._began_s

    def append(self, time_s: float, who: str, what: str, details: Mapping[str, Detail] | None = None) -> None:
        """Keep one event, at a time since the session began."""
        event = Event(time_s, who, what, details or {})
        if len(self._first) < FIRST_KEPT:
            self._first.append(event)
            return
        self.dropped += len(self._last) == LAST_KEPT
        self._last.append(event)

    def add(self, who: str, what: str, **details: Detail) -> None:
        """Keep an event of this moment."""
        self.append(self.time_s, who, what, details)

    def all(self) -> list[Event]:
        """Return what is kept, in the order in which it happened."""
        return [*self._first, *self._last]
