"""The live view: it gives way to work, tells the machine's state, and moves nothing that nobody holds a button for."""

from __future__ import annotations

import base64
import json
import re
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bench_page import BenchPage, Watcher, bench_page

from hil.bench.told_state import ROWS, STATE
from hil.console import starter
from hil.console.desk import Desk
from hil.console.facts import Facts, facts_of
from hil.console.live import Live, Turn
from hil.console.rows import RowHub
from hil.errors import UnusableInputError
from hil.machine import load_machine

CONNECTS_S = 240.0


class Line:
    """A starter that only listens."""

    def __init__(self) -> None:
        self.sent: list[Any] = []

    def send(self, obj: object) -> None:
        self.sent.append(obj)


@pytest.fixture(scope="module")
def facts() -> Facts:
    return facts_of("turntable", load_machine("turntable"), "lockstep:", live=True)


def state_line(doing: str, position: float = 0.5, homed: bool = True) -> str:
    return STATE + json.dumps({"doing": doing, "says": "", "homed": homed, "axes": {"turn": {"position": position}}})


def live_of(facts: Facts, folder: Path) -> tuple[Live, Line, RowHub]:
    line, rows = Line(), RowHub(folder, 0.0)
    return Live(line, facts, rows), line, rows


def test_work_waits_until_the_live_view_has_ended_and_keeps_its_order(facts: Facts, tmp_path: Path) -> None:
    live, line, _ = live_of(facts, tmp_path)
    turn = Turn(line)
    turn.live = live
    live.begin({})
    live.heed(starter.SAID, state_line("ready"), False)
    for message in ((starter.RUN, ["run"]), (starter.LET_GO, None)):
        turn.send(message)
    assert [what for what, _ in line.sent] == [starter.RUN, starter.SAY]
    assert line.sent[-1] == (starter.SAY, "end")
    live.heed(starter.ENDED, 0)
    turn.go_on()
    assert line.sent[2:] == [(starter.RUN, ["run"]), (starter.LET_GO, None)]
    assert not live.trouble


def test_one_that_has_told_nothing_yet_is_not_waited_for(facts: Facts, tmp_path: Path) -> None:
    live, line, _ = live_of(facts, tmp_path)
    live.begin({})
    live.end()
    assert line.sent[-1] == (starter.LET_GO, None)
    live.heed(starter.SAID, "isocenter: asked to stop by SIGINT", True)
    live.heed(starter.ENDED, 130)
    assert not live.trouble


def test_an_emulated_machine_stands_where_it_was_left(facts: Facts, tmp_path: Path) -> None:
    live, line, _ = live_of(facts, tmp_path)
    live.begin({})
    assert "--pose" not in line.sent[-1][1]
    live.heed(starter.SAID, state_line("ready", np.radians(12.5)), False)
    live.heed(starter.ENDED, 0)
    live.begin({})
    assert "turn=12.500000" in line.sent[-1][1]
    live.heed(starter.ENDED, 0)
    live.heed(starter.SAID, state_line("stopping", 0.0, homed=False), False)  # nobody knows, before it is homed
    live.heed(starter.ENDED, 0)
    live.begin({})
    assert "turn=12.500000" in line.sent[-1][1]
    live.heed(starter.ENDED, 0)
    live.begin({"position_turn": np.radians(-3.0)})
    assert "turn=-3.000000" in line.sent[-1][1]


def test_a_stop_from_rest_needs_no_browser_and_that_of_a_motion_does(facts: Facts, tmp_path: Path) -> None:
    live, _, _ = live_of(facts, tmp_path)
    live.begin({})
    for doing, led, moves in (("ready", False, False), ("stopping", False, True), ("holding", True, True), ("stopping", True, True)):
        live.heed(starter.SAID, state_line(doing), False)
        assert (live.led, live.moves) == (led, moves), doing
    live.heed(starter.ENDED, 0)
    assert not live.led


def test_its_rows_go_to_the_scope_and_are_no_recording(facts: Facts, tmp_path: Path) -> None:
    live, _, rows = live_of(facts, tmp_path)
    live.begin({})
    reader = rows.join()
    live.heed(starter.SAID, ROWS + json.dumps({"channels": [["time", "s"], ["position_turn", "rad"]]}), False)
    values = np.array([[0.0, 0.5], [0.005, 0.6]])
    live.heed(starter.SAID, ROWS + json.dumps({"rows": 2, "values": base64.b64encode(values.tobytes()).decode()}), False)
    assert rows.newest == {"time": 0.005, "position_turn": 0.6}
    assert rows.recording is None
    assert [type(each).__name__ for each in reader._waiting] == ["str", "Block"]


def test_one_that_fails_says_why_and_begins_again_when_asked(facts: Facts, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hil.console.live.AGAIN_S", 0.0)
    live, _, _ = live_of(facts, tmp_path)
    live.begin({})
    live.heed(starter.SAID, "isocenter: turn_drive (node 1): does not answer", True)
    live.heed(starter.ENDED, 2)
    assert live.trouble == "turn_drive (node 1): does not answer"
    assert not live.may_begin
    live.connect_again()
    assert live.may_begin


@pytest.mark.parametrize("order", ["jog turn fast", "jog elsewhere 5", "jog turn nan", "end", "release turn", "home\nend"])
def test_orders_that_are_none_never_reach_the_machine(facts: Facts, tmp_path: Path, order: str) -> None:
    line = Line()
    desk = Desk(facts, tmp_path, line)  # type: ignore[arg-type]
    client = desk.attention.welcome("")
    desk.live.begin({})
    desk.live.heed(starter.SAID, state_line("ready"), False)
    sent = len(line.sent)
    with pytest.raises(UnusableInputError):
        desk.move_live(client, order)
    assert len(line.sent) == sent


def test_who_moves_answers_pings_and_has_the_machine_alone_and_anybody_lets_go(facts: Facts, tmp_path: Path) -> None:
    line = Line()
    desk = Desk(facts, tmp_path, line)  # type: ignore[arg-type]
    first, second = desk.attention.welcome(""), desk.attention.welcome("")
    desk.live.begin({})
    with pytest.raises(UnusableInputError, match="not connected"):
        desk.move_live(first, "home")
    desk.live.heed(starter.SAID, state_line("ready"), False)
    with pytest.raises(UnusableInputError, match="pings"):
        desk.move_live("nobody", "jog turn 5")
    desk.move_live(first, "jog turn 5")
    assert line.sent[-1] == (starter.SAY, f"jog turn {np.radians(5.0):.9g}")
    for order, doing in (("jog turn 5", "homing"), ("jog turn 5", "closing brakes"), ("jog turn 5", "watching"), ("home", "holding")):
        desk.live.heed(starter.SAID, state_line(doing), False)
        with pytest.raises(UnusableInputError, match=f"not now; the machine is {doing}"):
            desk.move_live(first, order)
    desk.live.heed(starter.SAID, state_line("holding"), False)
    with pytest.raises(UnusableInputError, match="another browser"):
        desk.move_live(second, "jog turn -5")
    desk.move_live(second, "still")
    assert line.sent[-1] == (starter.SAY, "still")
    assert desk.live.owner == first


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Iterator[BenchPage]:
    with bench_page(tmp_path_factory.mktemp("live"), "turntable", "lockstep:", "--live") as bench:
        yield bench


def seen(client: Watcher, doing: str, seconds: float = CONNECTS_S) -> dict[str, Any]:
    """The live view's state, once it does something."""
    give_up = time.monotonic() + seconds
    while True:
        live = client.state()["live"]
        told: dict[str, Any] | None = live["told"]
        if told and told["doing"] == doing:
            return told
        assert time.monotonic() < give_up, live
        assert not live["trouble"], live


def turns(client: Watcher, seconds: float) -> list[dict[str, Any]]:
    """What is told of the axis while a button is held for some of the machine's seconds, after its brakes are open."""
    left, told = threading.Event(), list[dict[str, Any]]()

    def renew() -> None:
        while not left.wait(0.1):
            client.tell("move jog turn 5")

    button = threading.Thread(target=renew)
    button.start()
    try:
        while not told or told[-1]["time_s"] - told[0]["time_s"] < seconds:
            live = client.state()["live"]["told"]
            told += [live] if live["doing"] == "holding" else []
    finally:
        left.set()
        button.join()
    return told


@pytest.mark.slow
def test_a_held_button_moves_the_axis_and_whoever_leaves_it_stops_it(bench: BenchPage) -> None:
    """By letting go, by silence, as of a browser that was killed, and by STOP: at rest within the time that each may take."""
    client = Watcher(bench)
    assert seen(client, "watching")["axes"]["turn"]["position"] is not None
    client.tell("move home")
    seen(client, "ready")
    for leave in ("still", ""):
        told = turns(client, 1.5)
        assert max(each["axes"]["turn"]["speed"] or 0.0 for each in told) == pytest.approx(np.radians(5.0), rel=0.2)
        if leave:
            client.tell(f"move {leave}")
        began_s = told[-1]["time_s"]
        while (live := client.state()["live"]["told"])["time_s"] - began_s < 2.0:
            pass
        assert abs(live["axes"]["turn"]["speed"]) < np.radians(0.5)
        assert live["axes"]["turn"]["position"] - told[-1]["axes"]["turn"]["position"] < np.radians(5.0)
    turns(client, 0.5)
    client.tell("stop")
    give_up = time.monotonic() + CONNECTS_S
    while not (stop := client.state()["stop"]) or stop["seconds"] is None:
        assert time.monotonic() < give_up
    (line,) = stop["lines"]
    found = re.search(r"standstill ([\d.]+) s after the stop began", line)
    assert found, line
    assert float(found[1]) < 0.4
    client.close()


@pytest.mark.slow
def test_work_goes_before_the_live_view_which_comes_back(bench: BenchPage) -> None:
    client = Watcher(bench)
    seen(client, "watching")
    assert bench.post("/api/step", {"step": "check", "values": {}}, client.client) == (200, "{}")
    assert client.work(lambda work: work["state"] != "running", CONNECTS_S)["state"] == "passed"
    seen(client, "watching")
    client.close()
