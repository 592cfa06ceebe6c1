"""Who looks after an axis that only its drive holds: an operator at a terminal, or nobody, in lockstep."""

from __future__ import annotations

import os
import select
import sys
from collections.abc import Callable, Collection

from drivers.errors import KEEP_AWAY

LOCKSTEP_HOLD_S = 10.0
"""How long a hold is served in lockstep, where nothing real can fall: long enough for the brakes to be told to close once more."""

CONFIRM = "release"
HELD = ("held by its drive", "its drive is told to hold it")
"""Words by which a stop says that a drive alone holds an axis."""
STAYS = (
    "This program stays, since it serves the hold. Ctrl-C does not end it. "
    "A kill leaves it to the drive, which goes on holding if it watches the bench's heartbeat and its quick stop holds (6007h, 605Ah)."
)
HOW_TO_LEAVE = f"{STAYS} Support the axis, then type {CONFIRM} and its name here, as in `{CONFIRM} roll`."
"""Said of axes that stand alone: who goes to one that may move is hurt."""

HOLD_ENDED = "The hold has ended."
MOST_READS = 64
"""Most reads of the standard input at once, each a line of a terminal: a stream without end must not keep a hold from its tick."""


class TypedLines:
    """Lines typed at the terminal, as far as they are there. What a pipe or a file holds was written before anybody saw the machine."""

    def __init__(self) -> None:
        self._begun, self._listens = b"", True

    def take(self) -> list[str]:
        """Return the lines that were ended since the last call; never waits."""
        try:
            typed = sys.stdin.fileno()
            self._listens = self._listens and os.isatty(typed)
            for _ in range(MOST_READS):
                if not self._listens or not select.select([typed], [], [], 0.0)[0]:
                    break
                read = os.read(typed, 4096)
                self._listens = bool(read)
                self._begun += read
        except (OSError, ValueError, AttributeError):  # no standard input, or one that cannot be waited for
            return []
        *lines, self._begun = self._begun.split(b"\n")
        return [line.decode(errors="replace") for line in lines]


class Operator:
    """An operator at a terminal, who confirms that an axis is supported by a line with its name.

    Parameters
    ----------
    say : callable
        Takes a line of text.
    """

    def __init__(self, say: Callable[[str], None] | None = None) -> None:
        self._say = say or (lambda text: print(text, file=sys.stderr, flush=True))
        self._typed = TypedLines()

    def say(self, text: str) -> None:
        """Tell the operator what holds, and how to release it, or that nothing does any more."""
        held = any(words in text for words in HELD)
        self._say(f"{text}. {HOLD_ENDED if not held else STAYS if KEEP_AWAY in text else HOW_TO_LEAVE}")

    def stays(self, held_s: float) -> bool:
        """Stay as long as it takes."""
        return True

    def released(self) -> Collection[str]:
        """Return the axes that lines at the terminal, of all that are there, release by name; never waits."""
        words = [line.split() for line in self._typed.take()]
        return [two[1] for two in words if len(two) == 2 and two[0].lower() == CONFIRM]


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

    def released(self) -> Collection[str]:
        """Nobody confirms anything."""
        return ()
