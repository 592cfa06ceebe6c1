"""The bench's server as a process: whom it stops, what it refuses, and where it ends."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import socket
import subprocess
import sys
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import urlsplit

import pytest
from bench_machines import patient_text
from bench_page import BenchPage, Watcher, bench_page, until
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

from hil.console.attention import SILENT_S
from hil.console.guard import MOST_BYTES

LONG = {"kind": "static", "values": {"seconds": 36000}}
BUSY_S = 240.0
"""Longest time in which a run begins, on a computer with much else to do."""

STOP_BUDGET_S = 5.0
"""From the button to no torque: closing, swinging and letting go take one second of the machine, the rest is a busy computer."""


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Iterator[BenchPage]:
    with bench_page(tmp_path_factory.mktemp("bench"), "turntable", "lockstep:") as bench:
        yield bench


def started(bench: BenchPage) -> Watcher:
    """The client of a run that records and would go on for hours."""
    client = Watcher(bench)
    assert bench.post("/api/run", LONG, client.client) == (200, "{}")
    give_up = time.monotonic() + BUSY_S
    while not ((state := client.state())["recording"] and state["recording"]["live"] and state["recording"]["rows"]):
        assert state["work"]["state"] not in ("bad", "failed"), state["work"]
        assert time.monotonic() < give_up, state["work"]
    return client


def test_who_started_a_run_and_answers_no_more_stops_it_in_two_seconds(bench: BenchPage) -> None:
    client, watcher = started(bench), Watcher(bench)
    silent_since = time.monotonic()
    while not watcher.state()["stop"]:
        assert time.monotonic() - silent_since < SILENT_S + 1.0
    assert time.monotonic() - silent_since > SILENT_S - 0.5
    work = watcher.work(lambda work: work["state"] != "running", 30.0)
    assert (work["state"], "answered no ping" in work["why"]) == ("stopped", True)
    client.close()
    watcher.close()


def test_who_only_watches_stops_nothing(bench: BenchPage) -> None:
    watcher = Watcher(bench)
    client = started(bench)
    until_s = time.monotonic() + SILENT_S + 1.0
    while time.monotonic() < until_s:
        assert client.state()["work"]["state"] == "running"
        watcher.state(answers=False)
    watcher.close()
    bench.post("/api/stop", {})
    assert client.work(lambda work: work["state"] != "running", 30.0)["state"] == "stopped"
    client.close()


def test_the_page_is_there_for_as_long_as_the_starter_whatever_key_is_pressed(bench: BenchPage) -> None:
    watcher = Watcher(bench)
    for number in (signal.SIGINT, signal.SIGINT, signal.SIGHUP):
        os.kill(bench.server, number)  # a terminal tells all of its processes
        for _ in range(4):
            watcher.state()
    watcher.close()


def test_a_stop_needs_no_free_connection(bench: BenchPage) -> None:
    client = started(bench)
    place = urlsplit(bench.address)
    assert place.hostname
    assert place.port
    with contextlib.ExitStack() as idle:
        for _ in range(70):  # more than the server takes
            idle.enter_context(socket.create_connection((place.hostname, place.port)))
        assert bench.post("/api/stop", {})[0] == 503
        assert client.state()["work"]["state"] == "running"
        client.tell("stop")
        assert client.work(lambda work: work["state"] != "running", 30.0)["state"] == "stopped"
    client.close()


def test_who_answers_no_ping_starts_nothing(bench: BenchPage) -> None:
    assert "pings" in json.loads(bench.post("/api/run", LONG, "nobody")[1])["error"]


def test_messages_that_are_too_long_close_the_line(bench: BenchPage) -> None:
    for path in ("/control", "/rows"):
        with connect(bench.sockets + path, origin=bench.address, additional_headers={"Cookie": bench.cookie}) as socket:  # type: ignore[arg-type]
            socket.send("x" * (MOST_BYTES + 1))
            with pytest.raises(ConnectionClosed) as closed:
                list(socket)
            assert closed.value.rcvd is not None
            assert closed.value.rcvd.code == 1009


def test_another_user_of_this_computer_sees_nothing_and_changes_nothing(bench: BenchPage) -> None:
    """Who reaches the port, knows the page, and has no token."""
    cookie, bench.cookie = bench.cookie, ""
    try:
        for path in ("/api/run", "/api/stop", "/api/invite", "/api/release", "/api/step"):
            assert bench.post(path, {})[0] == 401
    finally:
        bench.cookie = cookie
    for path in ("/", "/api/bench", "/api/files", "/static/bench.js"):
        with pytest.raises(urllib.error.HTTPError) as refused:
            urllib.request.urlopen(bench.address + path)
        assert refused.value.code == 401
    for path in ("/control", "/rows"):
        with pytest.raises(InvalidStatus):
            connect(bench.sockets + path, origin=bench.address)  # type: ignore[arg-type]
    assert bench.post("/api/invite", {})[0] == 200


def test_lines_of_other_origins_are_refused(bench: BenchPage) -> None:
    for origin in ("http://evil.example", None):
        with pytest.raises(InvalidStatus) as refused:
            connect(bench.sockets + "/control", origin=origin)  # type: ignore[arg-type]
        assert refused.value.response.status_code == 403


def test_ctrl_c_stops_the_motors_before_it_ends(tmp_path_factory: pytest.TempPathFactory) -> None:
    with bench_page(tmp_path_factory.mktemp("ended"), "turntable", "lockstep:") as bench:
        client = started(bench)
        bench.process.send_signal(signal.SIGINT)
        assert bench.process.wait(60.0) == 0
        (events,) = bench.folder.glob("*.events.jsonl")
        assert "the motors were stopped" in events.read_text()
        assert [json.loads(line)["what"] for line in events.read_text().splitlines()][-1] == "session ended"
        client.close()


@pytest.mark.slow
def test_stop_on_a_bus_goes_through_the_supervisor(tmp_path: Path) -> None:
    bus, machine = "udp:239.74.163.78", tmp_path / "patient.toml"
    machine.write_text(patient_text())
    options = ["--bus", bus, "--no-real-time", "--json", str(tmp_path / "card.json")]
    emulator = subprocess.Popen([sys.executable, "-m", "hil", "emulate", str(machine), *options])
    try:
        until((tmp_path / "card.json").is_file, BUSY_S)
        with bench_page(tmp_path, str(machine), bus, "--no-real-time") as bench:
            client = started(bench)
            states = []

            def is_heard() -> bool:  # on a busy computer a frame comes late
                states.append(client.state())
                return "state" in states[-1]["wire"]["nodes"][0]

            until(is_heard, BUSY_S)
            state = states[-1]
            assert state["emulated"] is True
            assert state["wire"]["nodes"][0]["state"].startswith("operation enabled")
            assert state["wire"]["sync_Hz"] > 0.0
            assert state["io"]["brakes_open"] == {"propeller": True, "roll": True}
            assert state["io"]["hold_to_run"] is True
            bench.post("/api/stop", {})
            work = client.work(lambda work: work["state"] != "running", BUSY_S)
            stop = client.state()["stop"]
            client.close()
            assert work["state"] == "stopped"
            assert f"{bus}: no drive has torque" in stop["lines"]
            assert stop["seconds"] < STOP_BUDGET_S
            (events,) = bench.folder.glob("*.events.jsonl")
            asked = [each for each in map(json.loads, events.read_text().splitlines()) if each["what"] == "stop asked"]
            assert [(each["who"], "STOP in a browser" in each["reason"]) for each in asked] == [("supervisor", True)]
    finally:
        emulator.terminate()
        emulator.wait(60.0)
