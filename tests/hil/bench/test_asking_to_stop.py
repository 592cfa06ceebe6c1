"""`isocenter stop`: what it says of what a supervisor sees."""

from __future__ import annotations

import json
import socket
import tempfile
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest
from asked_supervisor import Supervisor
from command_line import Isocenter, runner

from hil.bench import asking

pytestmark = pytest.mark.skipif(not hasattr(socket, "AF_UNIX"), reason="no Unix sockets here")
BUS = "udp:239.74.163.9"


@pytest.fixture
def isocenter(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Iterator[Isocenter]:
    with tempfile.TemporaryDirectory() as short:  # paths of sockets have 107 characters at most
        monkeypatch.setenv("XDG_RUNTIME_DIR", short)
        monkeypatch.setattr(asking, "AGAIN_S", 0.0)
        monkeypatch.setattr(asking, "ANSWER_S", 0.05)
        yield runner(capsys)


@pytest.fixture
def ended() -> Iterator[list[Supervisor]]:
    supervisors: list[Supervisor] = []
    yield supervisors
    for supervisor in supervisors:
        supervisor.end()


def test_it_stays_until_no_drive_has_torque(isocenter: Isocenter, ended: list[Supervisor]) -> None:
    ended.append(Supervisor(BUS, "torque on\n", "torque on\n", "no torque\n"))
    outcome = isocenter("stop", "--bus", BUS)
    assert outcome.status == 0
    assert outcome.out.splitlines() == [f"{BUS}: the supervisor was told", f"{BUS}: no drive has torque"]
    assert all(words.startswith("`isocenter stop` (user ") for words in ended[0].heard)


def test_a_bench_that_ends_meanwhile_is_told(isocenter: Isocenter, ended: list[Supervisor], monkeypatch: pytest.MonkeyPatch) -> None:
    ended.append(Supervisor(BUS, "torque on\n"))
    monkeypatch.setattr(asking.time, "sleep", lambda seconds: ended[0].end())
    outcome = isocenter("stop", "--bus", BUS)
    assert outcome.status == 0
    assert outcome.out.splitlines()[-1] == f"{BUS}: the bench has ended"


def test_a_supervisor_that_says_no_more_is_no_machine_at_rest(isocenter: Isocenter) -> None:
    path = asking.stop_socket(BUS, make=True)
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as silent:
        silent.bind(str(path))
        outcome = isocenter("stop", "--bus", BUS)
        assert outcome.status == 1
        assert "the supervisor does not answer" in outcome.line
    outcome = isocenter("stop", "--bus", BUS)  # it was killed, its socket is left
    assert outcome.status == 1
    assert "the supervisor does not answer" in outcome.line


def test_a_supervisor_that_falls_silent_leaves_the_motors_unknown(isocenter: Isocenter) -> None:
    path = asking.stop_socket(BUS, make=True)
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as line:
        line.bind(str(path))
        answered = threading.Thread(target=lambda: line.sendto(b"torque on\n", line.recvfrom(1000)[1]))
        answered.start()
        outcome = isocenter("stop", "--bus", BUS)
        answered.join(10.0)
    assert outcome.status == 1
    assert "nobody knows whether the motors stand" in outcome.line


def test_a_drive_that_keeps_its_torque_is_a_bad_answer(
    isocenter: Isocenter, ended: list[Supervisor], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(asking, "STOP_S", -1.0)
    ended.append(Supervisor(BUS, "torque on\n"))
    outcome = isocenter("stop", "--bus", BUS)
    assert outcome.status == 1
    assert "a drive has torque and does not hold, or tells nothing, after" in outcome.line


def test_a_drive_that_holds_has_stopped_once_every_proof_should_be_over(
    isocenter: Isocenter, ended: list[Supervisor], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(asking, "STOP_S", -1.0)
    ended.append(Supervisor(BUS, "held\n"))
    outcome = isocenter("stop", "--json", "-", "--bus", BUS)
    assert outcome.status == 0
    assert "a drive holds its axis, whose brake is not proven" in outcome.err.splitlines()[-1]
    assert json.loads(outcome.out) == {"bus": BUS, "ended": "held", "seen": outcome.err.splitlines()}


def test_a_drive_that_holds_may_yet_prove_its_brake(isocenter: Isocenter, ended: list[Supervisor], tmp_path: Path) -> None:
    ended.append(Supervisor(BUS, "held\n", "no torque\n"))
    outcome = isocenter("stop", f"--bus={BUS}", "--json", tmp_path / "stop.json")
    assert (outcome.status, outcome.out.splitlines()[-1]) == (0, f"{BUS}: no drive has torque")
    assert json.loads((tmp_path / "stop.json").read_text())["ended"] == "no torque"


def test_a_file_that_cannot_be_written_keeps_nobody_from_stopping(isocenter: Isocenter, ended: list[Supervisor], tmp_path: Path) -> None:
    ended.append(Supervisor(BUS, "no torque\n"))
    outcome = isocenter("stop", "--bus", BUS, "--json", tmp_path / "none" / "stop.json")
    assert outcome.status == 2
    assert "stop.json: No such file" in outcome.line
    assert ended[0].heard


@pytest.mark.parametrize("words", [(), ("--bus",), ("--bus", BUS, "--hurry"), ("--bus", BUS, BUS), ("--bus", BUS, "-b", BUS), ("here",)])
def test_an_order_that_is_not_understood_is_explained(isocenter: Isocenter, words: tuple[str, ...]) -> None:
    outcome = isocenter("stop", *words)
    if words == ("--bus", BUS, "-b", BUS):
        assert outcome.status == 3  # the last one counts, as of every command
    else:
        assert outcome.status == 2
        assert "--help)" in outcome.line


def test_a_bus_without_a_bench_is_told(isocenter: Isocenter) -> None:
    outcome = isocenter("stop", "--bus", BUS)
    assert outcome.status == 3
    assert "no bench of yours runs on this bus" in outcome.line
    outcome = isocenter("stop", "--bus", "sockercan:vcan0")
    assert outcome.status == 2
    assert "did you mean socketcan" in outcome.line


def test_without_a_temporary_folder_it_tells_the_supervisor_all_the_same(isocenter: Isocenter, monkeypatch: pytest.MonkeyPatch) -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as supervisor, monkeypatch.context() as full:
        supervisor.bind(str(asking.stop_socket(BUS, make=True)))
        full.setattr(asking.tempfile, "tempdir", "/nowhere")
        outcome = isocenter("stop", "--bus", BUS)
        assert supervisor.recv(1000).startswith(b"`isocenter stop`")
    assert outcome.status == 1
    assert "needs a socket in a temporary folder ([Errno 2]" in outcome.line
    assert "emergency stop" in outcome.line


def test_a_user_without_a_name_stops_as_well(isocenter: Isocenter, ended: list[Supervisor], monkeypatch: pytest.MonkeyPatch) -> None:
    def nameless() -> str:
        raise KeyError("getpwuid(): uid not found: 1000")

    monkeypatch.setattr(asking.getpass, "getuser", nameless)
    ended.append(Supervisor(BUS, "no torque\n"))
    assert isocenter("stop", "--bus", BUS).status == 0
