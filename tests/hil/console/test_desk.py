"""What a stop reaches, whatever goes wrong on its way, and what the desk refuses, apart from the web."""

from __future__ import annotations

import asyncio
import contextlib
import multiprocessing
import sys
import tempfile
from collections.abc import AsyncIterator, Callable, Iterator
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import pytest
from asked_supervisor import Supervisor

from hil.bench import asking
from hil.console import desk as desks
from hil.console import starter
from hil.console.commands import Command, Order
from hil.console.desk import Desk
from hil.console.facts import facts_of
from hil.errors import UnusableInputError
from hil.machine import load_machine

BUS = "udp:239.74.163.11"
PATIENCE_S = 20.0


@pytest.fixture(autouse=True)
def runtime_folder(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    with tempfile.TemporaryDirectory() as short:  # paths of sockets have 107 characters at most
        monkeypatch.setenv("XDG_RUNTIME_DIR", short)
        monkeypatch.setattr(asking, "AGAIN_S", 0.0)
        yield


def order(name: str, *, moves: bool = False, step: str = "", judge: Callable[[Any], tuple[bool, str]] | None = None) -> Order:
    command = Command(name, lambda answers: [name], moves=moves)
    return Order(name, (command,), step=step) if judge is None else Order(name, (command,), step=step, judge=judge)


def desk_of(folder: Path, bus: str = BUS) -> tuple[Desk, Connection]:
    ours, theirs = multiprocessing.Pipe()
    return Desk(facts_of("turntable", load_machine("turntable"), bus), folder, ours), theirs


@contextlib.asynccontextmanager
async def opened(desk: Desk) -> AsyncIterator[Desk]:
    await desk.open()
    try:
        yield desk
    finally:
        await desk.close()


def told(starter_line: Connection) -> list[str]:
    """What the starter was told, without the signs of life."""
    words = []
    while starter_line.poll():
        words.append(starter_line.recv()[0])
    return [each for each in words if each != starter.ALIVE]


async def until(is_so: Callable[[], object]) -> None:
    async def wait() -> None:
        while not is_so():
            await asyncio.sleep(0.005)

    await asyncio.wait_for(wait(), PATIENCE_S)


def stopped(desk: Desk) -> bool:
    stop = desk.state()["stop"]
    return stop is not None and (stop["seconds"] is not None or bool(stop["trouble"]))


def test_a_stop_reaches_the_supervisor_while_the_page_only_computes(tmp_path: Path) -> None:
    async def stop() -> None:
        desk, line = desk_of(tmp_path)
        supervisor = Supervisor(BUS, "torque on\n", "no torque\n")
        desk.begin(order("plot"), "me")
        desk.stop("STOP")
        await until(lambda: stopped(desk))
        supervisor.end()
        assert supervisor.heard
        assert f"{BUS}: no drive has torque" in desk.state()["stop"]["lines"]
        assert told(line)[:2] == [starter.RUN, starter.LET_GO]

    asyncio.run(stop())


@pytest.mark.parametrize("error", [OSError(28, "No space left on device"), KeyError("getpwuid(): uid not found: 1000")])
def test_a_stop_that_cannot_ask_is_trouble_and_lets_go_all_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: Exception
) -> None:
    def fail(*asked: object) -> None:
        raise error

    async def stop() -> None:
        desk, line = desk_of(tmp_path)
        monkeypatch.setattr(desks, "ask_to_stop", fail)
        desk.work.begin(order("run", moves=True), "nobody")
        desk.stop("STOP")
        await until(lambda: desk.state()["stop"]["trouble"])
        assert str(error.args[-1]) in desk.state()["stop"]["trouble"]
        await until(line.poll)
        assert told(line) == [starter.RUN, starter.LET_GO]

    asyncio.run(stop())


def test_a_stop_asked_again_asks_again_while_the_first_waits_for_the_end(tmp_path: Path) -> None:
    async def stop() -> None:
        desk, _ = desk_of(tmp_path)
        supervisor = Supervisor(BUS, "no torque\n", "no torque\n")
        desk.work.begin(order("run", moves=True), "nobody")
        for asked in (1, 2):
            desk.stop(f"STOP {asked}")
            await until(lambda asked=asked: len(supervisor.heard) == asked and stopped(desk))  # type: ignore[misc]
        assert desk.state()["work"]["state"] == "running"
        supervisor.end()

    asyncio.run(stop())


def test_a_browser_that_is_gone_is_noticed_after_a_judgement_that_failed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    async def judge() -> None:
        desk, line = desk_of(tmp_path, "lockstep:")
        failed = []

        def fail(client: str) -> bool:
            failed.append(client)
            raise RuntimeError("no judgement")

        async with opened(desk):
            with monkeypatch.context() as broken:
                broken.setattr(desk.attention, "is_here", fail)
                desk.work.begin(order("run", moves=True), "nobody")
                await until(lambda: len(failed) > 1)
            assert starter.LET_GO in told(line)  # what nobody judges must not move
            await until(lambda: desk.state()["stop"])
            assert "answered no ping" in desk.state()["stop"]["by"]

    asyncio.run(judge())


def test_an_order_that_is_refused_leaves_the_result_of_its_step(tmp_path: Path) -> None:
    desk, _ = desk_of(tmp_path)
    desk.begin(order("first", step="home"), "me")
    (tmp_path / "first.json").write_text("{}")
    desk.work.heed(starter.ENDED, 0)
    desk.begin(order("plot"), "me")
    with pytest.raises(UnusableInputError, match="plot is running"):
        desk.begin(order("again", step="home"), "me")
    assert desk.passed == {"home": True}
    assert desk.state()["steps"]["home"]["state"] == "passed"
    (tmp_path / "plot.json").write_text("{}")
    desk.work.heed(starter.ENDED, 0)
    desk.begin(order("again", step="home"), "me")
    assert desk.passed == {}


def test_one_plan_is_made_at_a_time_and_the_newest_of_a_card(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    script, log = tmp_path / "plan", tmp_path / "log"
    lines = (
        "#!/bin/sh",
        "while read line; do",
        f"echo begun >> {log}",
        "case $line in *36*) exec sleep 1000;; esac",
        "sleep 0.2",  # another that began meanwhile would tell so before this one ends
        f"echo ended >> {log}",
        "echo '{\"recordings\": []}'",
        "done",
    )
    script.write_text("\n".join(lines))
    script.chmod(0o700)
    monkeypatch.setattr(sys, "executable", str(script))

    async def plan() -> None:
        desk, _ = desk_of(tmp_path)
        older = asyncio.create_task(desk.preview("static", {"seconds": 36}, ("me", "card")))
        await until(log.is_file)
        newer = [asyncio.create_task(desk.preview("static", {"seconds": 5}, (who, "card"))) for who in ("you", "me")]
        answers = await asyncio.wait_for(asyncio.gather(older, *newer), PATIENCE_S)
        assert "changed" in answers[0]["refused"]
        assert [each["recordings"] for each in answers[1:]] == [[], []]
        assert log.read_text().split() == ["begun", *2 * ["begun", "ended"]]
        await desk.helper.close()

    asyncio.run(plan())
