"""Who looks after an axis that only its drive holds: an operator at a terminal, or nobody, in lockstep."""

from __future__ import annotations

import select
import sys
from collections.abc import Callable

LOCKSTEP_HOLD_S = 10.0
"""How long a hold is served in lockstep, where nothing real can fall: long enough for the brakes to be told to close once more."""

CONFIRM = "release"
HOW_TO_LEAVE = (
    f"This program stays, since it serves the hold: support the axis, then type {CONFIRM} and Enter here. Ctrl-C does not end it. "
    "A kill leaves it to the drive, which goes on holding if it watches the bench's heartbeat and its quick stop holds (6007h, 605Ah)."
)


class Operator:
    """An operator at a terminal, who confirms that an axis is supported by a line on the standard input.

    Parameters
    ----------
    say : callable
        Takes a line of text.
    """

    def __init__(self, say: Callable[[str], None] | None = None) -> None:
        self._say = say or (lambda text: print(text, file=sys.stderr, flush=True))
        self._listens = True

    def say(self, text: str) -> None:
        """Tell the operator what holds, and how to release it."""
        self._say(f"{text}. {HOW_TO_LEAVE}" if "held by its drive" in text else text)

    def stays(self, held_s: float) -> bool:
        """Stay as long as it takes."""
        return True

    def released(self) -> bool:
        """Return whether a line of the standard input says so; never waits."""
        while self._listens and _readable():
            line = sys.stdin.readline()
            self._listens = bool(line)
            if line.strip().lower() == CONFIRM:
                return True
        return False


class LockstepAttendant:
    """Leaves after `LOCKSTEP_HOLD_S` of virtual time; the emulated drives then hold by themselves."""

    def __init__(self) -> None:
        self.said: list[str] = []

    def say(self, text: str) -> None:
        """Keep what an operator would have been told."""
        self.said.append(text)

    def stays(self, held_s: float) -> bool:
        """Stay for a while."""
        return held_s < LOCKSTEP_HOLD_S

    def released(self) -> bool:
        """Nobody confirms anything."""
        return False


def _readable() -> bool:
    try:
        return bool(select.select([sys.stdin], [], [], 0.0)[0])
    except (OSError, ValueError):  # no standard input, or one that cannot be waited for
        return False
