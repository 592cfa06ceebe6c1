"""The live view: an attended bench that the starter runs while no other work is done, and that gives way to it."""

from __future__ import annotations

import asyncio
import base64
import json
import time
from collections.abc import Mapping
from typing import Any

from hil.bench.attendant import HOLD_ENDED, HOW_TO_LEAVE
from hil.bench.told_state import AT_REST, HOLDING, READY, ROWS, STATE, STOPPING, TAKING_HOLD, WATCHING
from hil.console import starter
from hil.console.commands import on_the_bus
from hil.console.facts import Facts
from hil.console.rows import RowHub
from hil.console.work import PROGRESS, Line
from hil.errors import UnusableInputError

NAME = "live view"
"""What its rows are called, of which nothing is recorded."""
AGAIN_S = 1.0
"""Time after its end before it begins again."""

FOLLOWED = {"home": (WATCHING,), "jog": (READY, TAKING_HOLD, HOLDING)}
"""States in which an order to move is followed; in others it would wait, and move the machine when nobody expects it."""


class Live:
    """One attended bench at a time.

    Parameters
    ----------
    line : Line
        To the starter.
    facts : Facts
    rows : RowHub
        Takes its rows.
    """

    def __init__(self, line: Line, facts: Facts, rows: RowHub) -> None:
        self._line, self._facts, self._rows = line, facts, rows
        self._told: dict[str, Any] | None = None
        self.error = ""  # how it ended, in a line
        self._progress = ""  # of its start
        self.led = False
        """Whether orders move an axis, or did when the stop that is under way began."""
        self._asked = self._waits = False  # its end was asked for; a drive holds an axis until an operator releases it
        self._ended_s = float("-inf")
        self._pose: dict[str, float] = {}  # in which the emulated machine was left [rad or m]
        self.owner = ""  # the client that has moved the machine last
        self.trouble = ""
        self.running = False
        self.done = asyncio.Event()
        self.done.set()

    @property
    def moves(self) -> bool:
        """Whether an axis moves, or is held by its drive."""
        return self.running and self._told is not None and self._told["doing"] not in AT_REST

    @property
    def holds(self) -> bool:
        """Whether a drive alone holds an axis, until an operator releases it."""
        return self.running and self._waits

    @property
    def may_begin(self) -> bool:
        """Whether nothing speaks against its beginning: it runs not, has not just ended, and has not failed."""
        return not self.running and not self.trouble and time.monotonic() - self._ended_s > AGAIN_S

    def begin(self, recorded: Mapping[str, float | None]) -> None:
        """Connect; an emulated machine stands where it was left, by the last row of what was recorded since then, if anything."""
        facts = self._facts
        for axis in facts.axes:
            if (at := recorded.get(f"position_{axis.name}")) is not None:
                self._pose[axis.name] = at
        places = {axis: self._pose[axis.name] for axis in facts.axes if axis.name in self._pose}
        pose = ",".join(f"{axis.name}={min(max(axis.to_edge(at), axis.lower), axis.upper):.6f}" for axis, at in places.items())
        where = ["--pose", pose] if pose and facts.is_lockstep else []
        timing = [] if facts.real_time else ["--no-real-time"]
        self.running, self.trouble, self._told, self.error, self._asked, self._waits = True, "", None, "", False, False
        self.led, self._progress = False, ""
        self.done.clear()
        self._line.send((starter.RUN, ["attend", *on_the_bus(facts), *where, *timing, "--rows"]))

    def connect_again(self) -> None:
        """Forget why it has failed."""
        self.trouble = ""

    def end(self) -> None:
        """Let it come to rest, close its brakes, and end; one that has told nothing yet has moved nothing, and is not waited for."""
        if self.running and not self._asked:
            self._asked = True
            self._line.send((starter.LET_GO, None) if self._told is None else (starter.SAY, "end"))

    def let_go(self) -> None:
        """Stop it, motors first."""
        if self.running:
            self._asked = True
            self._line.send((starter.LET_GO, None))

    def say(self, text: str) -> None:
        """Write a line to it."""
        if self.running:
            self._line.send((starter.SAY, text))

    def order(self, client: str, text: str) -> None:
        """Order a motion, or `still`.

        Raises
        ------
        UnusableInputError
            It does not run, is about to end, or does something in which the order is not followed.
        """
        if not self.running or self._told is None:
            raise UnusableInputError("the machine is not connected just now; wait, or connect again")
        word, doing = text.split()[0], self._told["doing"]
        if word in FOLLOWED and (self._asked or doing not in FOLLOWED[word]):
            raise UnusableInputError(f"{word}: not now; the machine is {'disconnecting' if self._asked else doing}")
        self.owner = client
        self.say(text)

    def heed(self, what: str, *told: object) -> None:
        """Take what the starter tells."""
        if what == starter.ENDED:
            self._end(int(str(told[0])))
            return
        text = str(told[0])
        if text.startswith(STATE):
            self._told = json.loads(text.removeprefix(STATE))
            if self._told["doing"] != STOPPING:
                self.led = self._told["doing"] not in AT_REST
            if self._told["homed"]:  # before homing an encoder does not know where it stands
                self._pose |= {name: axis["position"] for name, axis in self._told["axes"].items() if axis["position"] is not None}
        elif text.startswith(ROWS):
            block = json.loads(text.removeprefix(ROWS))
            if "channels" in block:
                self._rows.show(NAME, block["channels"])
            else:
                self._rows.take_shown(block["rows"], base64.b64decode(block["values"]))
        elif text.startswith(PROGRESS):
            self._progress = text.removeprefix(PROGRESS)
        else:
            self._waits = HOW_TO_LEAVE in text or (self._waits and HOLD_ENDED not in text)
            if text.startswith("isocenter: "):
                self.error = text.removeprefix("isocenter: ")

    def _end(self, status: int) -> None:
        self.running, self.led, self._told, self._ended_s = False, False, None, time.monotonic()
        if status and not self._asked:
            self.trouble = self.error or f"the live view ended with status {status}"
        self.done.set()

    def state(self) -> dict[str, Any]:
        """Return what the page shows, as plain values."""
        state = {"running": self.running, "trouble": self.trouble, "told": self._told, "progress": self._progress}
        return state | {"holds": self.holds, "moves": self.moves}


class Turn:
    """The line to the starter, on which the live view gives way to work: what is to be run waits until the view has ended.

    Parameters
    ----------
    line : Line
    """

    def __init__(self, line: Line) -> None:
        self._line = line
        self._waiting: list[object] = []
        self.live: Live | None = None

    @property
    def waits(self) -> bool:
        """Whether some work waits for the view's end."""
        return bool(self._waiting)

    def send(self, obj: object) -> None:
        """Send, or keep until the live view has ended."""
        if self.live is not None and self.live.running:
            if not self._waiting:
                self.live.end()
            self._waiting.append(obj)
        else:
            self._line.send(obj)

    def go_on(self) -> None:
        """Send what has waited."""
        waiting, self._waiting = self._waiting, []
        for obj in waiting:
            self._line.send(obj)
