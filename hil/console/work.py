"""The work that is being done: one order at a time, its commands one after the other, what they say, and what came of it."""

from __future__ import annotations

import asyncio
import json
import time
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Any, Protocol, cast

from hil.bench.attendant import HOLD_ENDED, HOW_TO_LEAVE
from hil.bench.told_state import STATE
from hil.console import starter
from hil.console.commands import Order
from hil.errors import UnusableInputError

PROGRESS = "... "
"""How a command begins a line that says how far it is, every few seconds: the newest takes the place of the one before."""
MOST_LINES = 200
"""Newest lines of a command that the page shows."""


class Line(Protocol):
    """The connection to the starter."""

    def send(self, obj: object) -> None:
        """Send a message."""


class Work:
    """One piece of work at a time.

    Parameters
    ----------
    line : Line
        To the starter.
    folder : Path
        Where the commands' answers go, `KEY.json`.
    changed : callable
        Called when the work has ended, with its order and whether it has passed.
    show : callable
        Takes each state that is told.
    """

    def __init__(
        self,
        line: Line,
        folder: Path,
        changed: Callable[[Order, bool], None],
        show: Callable[[dict[str, Any]], None] = lambda told: None,
    ) -> None:
        self._line, self._folder, self._changed, self._show = line, folder, changed, show
        self._order: Order | None = None
        self._at = 0
        self._began_s = self._ended_s = 0.0
        self._lines: deque[tuple[str, bool]] = deque(maxlen=MOST_LINES)
        self._error = self._progress = ""
        self._told: dict[str, Any] | None = None  # by the command that moves the machine
        self.answers: dict[str, Any] = {}
        self._waits = False  # for an operator who releases what a drive holds
        self.owner = ""
        self.state = "idle"  # or running, passed, bad (its answer is), failed (to give one), stopped
        self.why = ""
        self.stopped_by = ""
        self.done = asyncio.Event()
        self.done.set()

    @property
    def running(self) -> bool:
        """Whether something is being done."""
        return self.state == "running"

    @property
    def lines(self) -> list[tuple[str, bool]]:
        """What was said last, and whether on the error stream."""
        return list(self._lines)

    @property
    def moves(self) -> bool:
        """Whether what is being done may move the machine."""
        return self.running and self._order is not None and any(each.moves for each in self._order.commands[self._at : self._at + 1])

    @property
    def holds(self) -> bool:
        """Whether a drive alone holds an axis, until an operator releases it."""
        return self.running and self._waits

    def begin(self, order: Order, owner: str) -> None:
        """Begin an order.

        Raises
        ------
        UnusableInputError
            Another is being done.
        """
        if self.running:
            assert self._order is not None
            raise UnusableInputError(f"{self._order.title} is running; stop it or wait for its end")
        self._order, self._at, self.owner = order, 0, owner
        self._lines.clear()
        self.state, self.why, self.stopped_by, self._error = "running", "", "", ""
        self._began_s = time.monotonic()
        self.done.clear()
        self._next()

    def forget(self) -> None:
        """Forget what has ended: something else is done meanwhile."""
        if not self.running:
            self.state, self._order = "idle", None

    def let_go(self, who: str) -> None:
        """Stop the command that runs, motors first."""
        if self.running:
            self.stopped_by = self.stopped_by or who
            self._line.send((starter.LET_GO, None))

    def say(self, text: str) -> None:
        """Write a line to the command that runs."""
        if self.running:
            self._line.send((starter.SAY, text))

    def heed(self, what: str, *told: object) -> None:
        """Take what the starter tells."""
        if what == starter.SAID:
            text, is_error = str(told[0]), bool(told[1])
            if text.startswith(STATE):
                self._told = told_now = json.loads(text.removeprefix(STATE))
                self._show(told_now)
                return
            if text.startswith(PROGRESS):
                self._progress = text.removeprefix(PROGRESS)
                return
            self._lines.append((text[:2000], is_error))
            self._waits = HOW_TO_LEAVE in text or (self._waits and HOLD_ENDED not in text)
            if is_error and text.startswith("isocenter: "):
                self._error = text.removeprefix("isocenter: ")
        elif what == starter.ENDED and self.running:
            self._told, self._progress = None, ""
            self._ended(cast("int", told[0]))

    def state_now(self) -> dict[str, Any]:
        """Return what the page shows, as plain values."""
        if self._order is None:
            return {"state": "idle"}
        took_s = (time.monotonic() if self.running else self._ended_s) - self._began_s
        return {
            "state": self.state,
            "title": self._order.title,
            "step": self._order.step,
            "moves": self.moves,
            "command": self._order.commands[self._at].key if self._at < len(self._order.commands) else "",
            "seconds": round(took_s, 1),
            "why": self.why,
            "holds": self.holds,
            "told": self._told,
            "progress": self._progress,
            "lines": self.lines if self.running else [],
            "made": [name for name in self._order.made if (self._folder / name).is_file()] if not self.running else [],
        }

    def _next(self) -> None:
        assert self._order is not None
        if self._at == len(self._order.commands):
            try:
                passed, why = self._order.judge(self.answers)
            except Exception as error:  # an answer that is not as expected must not leave the work running for ever
                self._end("failed", f"its answer cannot be judged: {_told_by(error)}")
                return
            self._end("passed" if passed else "bad", why)
            return
        command = self._order.commands[self._at]
        try:
            arguments = command.arguments(self.answers)
            answer = self._folder / f"{command.key}.json"
            answer.unlink(missing_ok=True)
            self._lines.append((f"$ isocenter {' '.join(arguments)}", False))
            self._waits = False
            self._line.send((starter.RUN, [*arguments, "--json", str(answer)]))
        except Exception as error:
            self._end("failed", f"{command.key} cannot begin: {_told_by(error)}")

    def _ended(self, status: int) -> None:
        assert self._order is not None
        command = self._order.commands[self._at]
        try:
            self.answers[command.key] = json.loads((self._folder / f"{command.key}.json").read_text(encoding="utf-8"))
            answered = True
        except (OSError, ValueError):
            answered = False
        if self.stopped_by:
            self._end("stopped", self.stopped_by + (f": {self._error}" if self._error else ""))
        elif status != 0 or not answered:
            said = self._error or next((text for text, _ in reversed(self._lines) if not text.startswith("$")), "")
            judged = self._judged_all_the_same() if answered and status == 1 else ""
            self._end("bad" if judged else "failed", judged or said or f"{command.key} ended with status {status}")
        else:
            self._at += 1
            self._next()

    def _judged_all_the_same(self) -> str:
        """Return why an answer is bad, where the command has given one and it was the last."""
        assert self._order is not None
        if self._at + 1 < len(self._order.commands):
            return ""
        try:
            passed, why = self._order.judge(self.answers)
        except Exception:  # what the command has said is told instead
            return ""
        return "" if passed else why

    def _end(self, state: str, why: str) -> None:
        assert self._order is not None
        self.state, self.why, self._ended_s = state, why, time.monotonic()
        self.done.set()
        self._changed(self._order, state == "passed")


def _told_by(error: Exception) -> str:
    return str(error) if isinstance(error, OSError | ValueError) else repr(error)
