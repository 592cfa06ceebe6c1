"""The supervisor in the loop's own process, for lockstep: the same judgements, stepped by the frames, repeat bit for bit."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

from drivers.settings import BusSettings
from drivers.shared_memory.io_state import IoState
from drivers.supervisor.supervisor import NMT, Supervisor


def took_back(reason: str) -> str:
    """Return how the end of a permission is told."""
    return f"the supervisor took its permission back: {reason}"


class SupervisorLink(Protocol):
    """What the machine's link knows of its supervisor."""

    def begin(self) -> None:
        """Begin a session."""

    def end(self) -> None:
        """End the session: nothing is permitted before the next."""

    def ticks_begin(self) -> None:
        """Take note that the loop's ticks begin now, a period apart."""

    def trouble(self) -> str:
        """Return why nothing may move, in words; '' where it may."""


class SupervisorInProcess:
    """A supervisor that is stepped by what passes.

    Parameters
    ----------
    settings : BusSettings
    now : callable
        Virtual time [s].
    send : callable
        Sends a frame: identifier and data.
    supervisor : Supervisor, optional
        Who judges, where that is a compiled one: it finds the same in less time.

    Attributes
    ----------
    heard : list
        Frames of the bus that wait to be judged; whoever carries them notes them here, see `Supervisor.noted`.
    """

    def __init__(
        self,
        settings: BusSettings,
        now: Callable[[], float],
        send: Callable[[int, bytes], None],
        supervisor: Supervisor | None = None,
    ) -> None:
        self._supervisor = supervisor or Supervisor(settings)
        self.heard: list[Any] = self._supervisor.noted
        self._sync_id = settings.sync_cob_id
        self._now, self._send = now, send

    def begin(self) -> None:
        """Begin a session."""
        self._supervisor.begin()

    def end(self) -> None:
        """End the session: nothing is permitted before the next."""
        self._supervisor.end()

    def ticks_begin(self) -> None:
        """Take note of nothing: frames step it."""

    def trouble(self) -> str:
        """Return why nothing may move, in words; '' where it may."""
        return took_back(reason) if (reason := self._supervisor.reason) else ""

    def take(self) -> None:
        """Take what was heard; judge where that ends with a SYNC."""
        can_id, _, time_s = self.heard[-3:]
        if can_id != self._sync_id:
            self._supervisor.take_noted()
        elif not self._supervisor.check(time_s):
            for command in self._supervisor.commands(time_s):
                self._send(NMT, bytes(command))

    def refresh(self, state: IoState) -> int | None:
        """Take a state of the I/O; return the word that refreshes its outputs, None without permission."""
        now_s = self._now()
        self._supervisor.io(now_s, state.hold_to_run, state.door_closed, state.brakes_open)
        return self._supervisor.answer(now_s, state.word)
