"""Everything that the server knows and may ask for, apart from how it is asked over the web."""

from __future__ import annotations

import asyncio
import contextlib
import json
import math
import os
import time
from collections.abc import Mapping, Sequence
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from hil.bench.asking import ask_to_stop
from hil.console import starter
from hil.console.attention import SILENT_S, Attention
from hil.console.commands import Order
from hil.console.facts import Facts
from hil.console.files import Listing
from hil.console.forms import Form, forms_of
from hil.console.helper import Helper
from hil.console.io_state import IoWatch
from hil.console.live import NAME as LIVE_ROWS
from hil.console.live import Live, Turn
from hil.console.rows import RowHub
from hil.console.steps import missing_before, step_named, steps_of
from hil.console.told_rows import ToldRows
from hil.console.wire import WireWatch
from hil.console.work import Work
from hil.emulated.card import find
from hil.errors import NothingRunsError, UnusableInputError, in_one_line

LOOK_S = 0.05
"""Interval at which rows are looked for: the recorder writes them as often."""
JUDGE_S = 0.1
FRESH_S = 0.1
ALIVE_S = 0.5
ENDS_S = 10.0
"""Longest time that a run which the supervisor has stopped is given to write its recording, before its lead is let go."""
READ_S = 120.0
"""Longest time for reading recordings."""
PREVIEW_S = 120.0
"""Longest time for planning an experiment: the first on a computer compiles."""


class Desk:
    """The server's work, without the web.

    Parameters
    ----------
    facts : Facts
    folder : Path
        Where runs record.
    line : Connection
        To the starter.
    """

    def __init__(self, facts: Facts, folder: Path, line: Connection) -> None:
        self.facts, self.folder, self._line = facts, folder, line
        self.attention = Attention()
        self.rows = RowHub(folder, time.time() - 1.0)
        self.listing = Listing(folder)
        self.forms = forms_of(facts)
        self.steps = steps_of(facts, folder)
        self._turn = Turn(line)
        self.live = self._turn.live = Live(line, facts, self.rows)
        self.work = Work(self._turn, folder, self._ended, ToldRows(self.rows, facts.axes).take)
        self._wire = WireWatch(facts.settings, facts.bus)
        self._io = IoWatch(facts.bus, [axis.name for axis in facts.axes])
        self.passed: dict[str, bool] = {}
        self._results: dict[str, dict[str, Any]] = {}
        self._stop: dict[str, Any] | None = None
        self._stopping: asyncio.Task[None] | None = None
        self._asking = False
        self._plans: dict[tuple[str, str], asyncio.Task[dict[str, Any]]] = {}
        self.helper = Helper(facts.name)
        self._tasks: list[asyncio.Task[None]] = []
        self._said: dict[tuple[bool, bool], tuple[float, str]] = {}
        self.results_version = 0

    async def open(self) -> None:
        """Begin to look, to judge and to listen to the starter."""
        loop = asyncio.get_running_loop()
        loop.add_reader(self._line.fileno(), self._hear)
        self._tasks = [asyncio.create_task(each) for each in (self._look(), self._judge(), self._be_alive(), self._watch())]

    async def close(self) -> None:
        """End what was begun; a run that is still going is let go by the starter."""
        asyncio.get_running_loop().remove_reader(self._line.fileno())
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        await self.helper.close()
        self._wire.close()
        self.rows.close()

    def begin_step(self, name: object, values: Mapping[str, Any], client: str) -> None:
        """Begin a step of the commissioning.

        Raises
        ------
        UnusableInputError
            There is no such step, an earlier one has yet to pass, a field cannot be used, or something else is running.
        """
        step = step_named(self.steps, name)
        if missing := missing_before(step.name, self.passed, values):
            raise UnusableInputError(missing)
        self._begin(step.order(values), client)

    def begin(self, order: Order, client: str) -> None:
        """Begin any other work; raises as `begin_step`."""
        self._begin(order, client)

    def _begin(self, order: Order, client: str) -> None:
        if self._stopping is not None:
            raise UnusableInputError("a stop is under way; wait for its end")
        if order.moves and not self.attention.is_here(client):
            raise UnusableInputError("this page does not answer the server's pings, so it may start no motion; reload it")
        self.work.begin(order, client)
        self._stop = None  # an old event
        if order.step and self.work.running:  # one that ended at once has told its result
            self.results_version += 1
            self.passed.pop(order.step, None)
            self._results.pop(order.step, None)

    def move_live(self, client: str, text: str) -> None:
        """Order a motion of the live view: `home`, or `jog AXIS SPEED`, the speed in the unit of the forms; `still` ends a jog.

        Raises
        ------
        UnusableInputError
            It is no such order, another browser moves the machine, nothing is connected, or the page does not answer.
        """
        words = text.split()
        match words:
            case ["home" | "still"]:
                order = words[0]
            case ["jog", name, speed] if name in [axis.name for axis in self.facts.axes]:
                order = f"jog {name} {self.facts.axis(name).from_edge(_finite(speed)):.9g}"
            case _:
                raise UnusableInputError(f"{text[:40]}: is no order to move")
        if order != "still":  # anybody may let go
            if self._stopping is not None or self.work.running:
                raise UnusableInputError("something else is under way; wait for its end")
            if self.live.moves and self.live.owner != client and self.attention.is_here(self.live.owner):
                raise UnusableInputError("another browser moves the machine just now")
            if not self.attention.is_here(client):
                raise UnusableInputError("this page does not answer the server's pings, so it may start no motion; reload it")
        self.live.order(self.live.owner if order == "still" else client, order)
        if order != "still":
            self._stop = None  # old events
            self.work.forget()

    def form(self, kind: object) -> Form:
        """Return the form of an experiment.

        Raises
        ------
        UnusableInputError
            There is none of this kind.
        """
        if not isinstance(kind, str) or kind not in self.forms:
            raise UnusableInputError(f"no experiment {str(kind)[:40]}; there is {', '.join(self.forms)}")
        return self.forms[kind]

    async def preview(self, kind: object, values: Mapping[str, Any], who: tuple[str, str] = ("", "")) -> dict[str, Any]:
        """Plan a filled form without running it: one at a time, and of those that one card of one page asks for, the newest alone.

        Parameters
        ----------
        kind : object
            Of experiment.
        values : mapping
            The form.
        who : tuple of str
            Page and card that ask.

        Returns
        -------
        dict
            See `hil.console.preview.preview`, and the file's `text`.
        """
        text = self.form(kind).text(self.facts, values)
        if (older := self._plans.get(who)) is not None:
            older.cancel()
        self._plans[who] = plan = asyncio.create_task(self._plan(text))
        try:
            await asyncio.wait([plan])
        finally:
            plan.cancel()
            if self._plans.get(who) is plan:
                del self._plans[who]
        planned = {"refused": "the form was changed meanwhile"} if plan.cancelled() else plan.result()
        return planned | {"text": text}

    async def _plan(self, text: str) -> dict[str, Any]:
        try:
            planned: dict[str, Any] = json.loads(await self.helper.ask({"plan": text}, PREVIEW_S))
        except TimeoutError:
            planned = {"refused": "planning it takes long on this computer; it is tried again", "again": True}
        except ValueError:
            planned = {"refused": "planning it failed; `isocenter run` with the file below says why"}
        return planned

    async def curves(self, files: Sequence[str], channels: Sequence[str], align: str) -> bytes:
        """Return channels of recordings as `hil.console.curves` does, a JSON object.

        Raises
        ------
        UnusableInputError
            They could not be read.
        """
        try:
            return await self.helper.ask({"files": files, "channels": channels, "align": align}, READ_S)
        except (TimeoutError, ValueError):
            raise UnusableInputError("the recordings could not be read; `isocenter plot` with them says why") from None

    def stop(self, who: str) -> None:
        """Stop whatever runs on the bus: by the supervisor, as `isocenter stop` does, and what this server has started by its lead.

        Asked again it does so again, unless the supervisor is being asked just now, as it then is five times a second.
        """
        if self._asking:
            return
        if self._stopping is not None:
            self._stopping.cancel()  # it has asked, and only waits
        ran = self.work.running or bool(self._stop and self._stop["ran"] and self._stopping is not None)
        self._stop = {"by": who, "lines": [], "began_s": time.monotonic(), "seconds": None, "trouble": "", "ran": ran}
        self._stopping = asyncio.create_task(self._stop_all(who, self._stop))

    async def _stop_all(self, who: str, stop: dict[str, Any]) -> None:
        lines: list[str] = stop["lines"]
        self.work.stopped_by = self.work.stopped_by or (who if self.work.running else "")
        try:
            try:
                if not self.facts.is_lockstep:
                    await self._ask_supervisor(who, stop)
            finally:
                self.work.let_go(who)  # where no supervisor was there yet, or the run goes on after its stop
                self.live.let_go()
            if self.live.running and not self.work.running:
                await self.live.done.wait()
                lines.append(self.live.error or "the live view has ended")
            if not self.work.running and not lines and not stop["trouble"]:
                lines.append("nothing runs here")
            if self.work.running:
                await self.work.done.wait()
                lines.append("what was started here has ended")
        finally:
            if stop["seconds"] is None:
                stop["seconds"] = _since(stop)
            if self._stop is stop:
                self._stopping = None

    async def _ask_supervisor(self, who: str, stop: dict[str, Any]) -> None:
        """Ask the supervisor on the bus, whoever started what it watches, and give a run of ours the time to write its recording."""
        ran, moved = self.work.running, self.work.moves
        if not moved:
            self.work.let_go(who)  # what only computes waits for no supervisor, and none waits for it
        self._asking = True
        try:
            await asyncio.to_thread(ask_to_stop, self.facts.bus, stop["lines"].append, who)
        except Exception as error:  # whatever it is, it must be seen, and the lead be let go
            said = in_one_line(error)[0]
            if ran and isinstance(error, NothingRunsError):
                stop["lines"].append(said)  # no bench on the bus: what runs here has not come so far
            else:
                stop["trouble"] = said
            return
        finally:
            self._asking = False
        stop["seconds"] = _since(stop)
        for done in [*([self.work.done] if moved else []), *([self.live.done] if self.live.running else [])]:
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(done.wait(), ENDS_S)

    def state(self) -> dict[str, Any]:
        """Return everything that changes, as plain values."""
        rows = self.rows
        rows_are_now = rows.named == LIVE_ROWS if self.live.running else rows.recording is not None and rows.recording["live"]
        return {
            "type": "state",
            "emulated": self._emulated(),
            "work": self.work.state_now(),
            "live": self.live.state(),
            "steps": {name: self._results.get(name, {}) for name in self.steps},
            "stop": None if self._stop is None else {key: self._stop[key] for key in ("by", "lines", "seconds", "trouble", "ran")},
            "wire": self._wire.state(rows.newest if rows_are_now else {}),
            "io": self._io.state(),
            "recording": rows.recording,
            "newest": rows.newest,
            "rows_are_now": rows_are_now,
            "timeliness": rows.timeliness.summary(),
            "readers": rows.readers,
        }

    def state_text(self, client: str, whole: bool) -> str:
        """Return the state as JSON, made once for all who ask within an interval; the steps' results, which are long, only in the whole.

        A client is told whether the work is its own, and no name of another, as which it could go on.
        """
        now_s, own = time.monotonic(), client == self.work.owner
        said_s, text = self._said.get((whole, own), (float("-inf"), ""))
        if whole or now_s - said_s > FRESH_S:
            state = self.state() | {"own": own} | ({} if whole else {"steps": None})
            text = json.dumps(state, allow_nan=False)
            self._said[whole, own] = now_s, text
        return text

    def described(self) -> dict[str, Any]:
        """Return everything that stays: the machine, the steps, the forms."""
        facts = self.facts
        return {
            "machine": {"name": facts.title, "description": facts.description, "bus": facts.bus, "rate_Hz": facts.rate_Hz},
            "axes": [vars(axis) for axis in facts.axes],
            "bodies": [vars(body) for body in facts.bodies],
            "steps": [
                {"name": s.name, "title": s.title, "does": s.does, "fields": [vars(f) for f in s.fields], "experiment": s.experiment}
                | {"moves": s.moves, "mend": s.mend}
                for s in self.steps.values()
            ],
            "forms": [
                {"kind": form.kind, "title": form.title, "says": form.says, "fields": [vars(field) for field in form.fields]}
                for form in self.forms.values()
            ],
            "has_demo": facts.is_lockstep,
            "has_live": facts.live,
            "has_io": facts.settings.io is not None,
            "has_imu": facts.settings.imu is not None,
            "folder": str(self.folder),
            "silent_s": SILENT_S,
        }

    def _emulated(self) -> bool:
        if self.facts.is_lockstep:
            return True
        try:
            return find(self.facts.bus) is not None
        except UnusableInputError:
            return False

    def _ended(self, order: Order, passed: bool) -> None:
        if order.step:
            self.results_version += 1
            self.passed[order.step] = passed
            self._results[order.step] = self.work.state_now() | {"lines": self.work.lines}

    def _hear(self) -> None:
        with contextlib.suppress(BlockingIOError):
            try:
                while self._line.poll():
                    told = self._line.recv()
                    if self.live.running:
                        self.live.heed(*told)
                    else:
                        self.work.heed(*told)
                    if not self.live.running and self._turn.waits:
                        self._turn.go_on()
            except (EOFError, OSError):
                os._exit(1)  # the starter is gone, and what it ran was let go with it

    async def _look(self) -> None:
        while True:
            self.rows.look()
            await asyncio.sleep(LOOK_S)

    async def _judge(self) -> None:
        while True:
            await asyncio.sleep(JUDGE_S)
            try:
                mover = self.work.owner if self.work.moves else self.live.owner if self.live.led else None
                if mover is not None and self._stopping is None and not self.attention.is_here(mover):
                    self.stop(f"the browser that started it has answered no ping for {SILENT_S:g} s")
            except Exception as error:  # nobody else judges the browser: what nobody judges must not move
                with contextlib.suppress(OSError):
                    self.work.let_go(f"the server cannot judge whether the browser is there: {error!r}")
                    self.live.let_go()

    async def _watch(self) -> None:
        """Keep the machine connected for as long as somebody looks and no work is done."""
        while self.facts.live:
            await asyncio.sleep(JUDGE_S)
            idle = not (self.work.running or self._turn.waits or self._stopping)
            if idle and self.attention.somebody_looks and self.live.may_begin:
                self.live.begin(self.rows.take_recorded())
            elif not self.attention.somebody_looks and not self.live.moves:
                self.live.end()

    async def _be_alive(self) -> None:
        while True:
            self._line.send((starter.ALIVE, None))
            await asyncio.sleep(ALIVE_S)


def _since(stop: Mapping[str, Any]) -> float:
    return round(time.monotonic() - float(stop["began_s"]), 2)


def _finite(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise UnusableInputError(f"{text[:40]}: is no speed")
    return value
