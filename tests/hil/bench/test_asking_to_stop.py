"""`isocenter stop`: what it says of what a supervisor sees."""

from __future__ import annotations

import socket
import tempfile
import threading
from collections.abc import Iterator

import pytest
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


class Supervisor:
    """Answers each question with the next of some texts."""

    def __init__(self, *texts: str) -> None:
        self.heard: list[str] = []
        self._texts = texts
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.bind(str(asking.stop_socket(BUS, make=True)))
        self._thread = threading.Thread(target=self._serve)
        self._thread.start()

    def _serve(self) -> None:
        for text in self._texts:
            words, sender = self._socket.recvfrom(1000)
            self.heard.append(words.decode())
            self._socket.sendto(text.encode(), sender)
        self._socket.close()
        asking.stop_socket(BUS).unlink()

    def end(self) -> None:
        self._thread.join(10.0)


@pytest.fixture
def ended() -> Iterator[list[Supervisor]]:
    supervisors: list[Supervisor] = []
    yield supervisors
    for supervisor in supervisors:
        supervisor.end()


def test_it_stays_until_no_drive_has_torque(isocenter: Isocenter, ended: list[Supervisor]) -> None:
    ended.append(Supervisor("torque on\n", "torque on\n", "no torque\n"))
    outcome = isocenter("stop", "--bus", BUS)
    assert outcome.status == 0
    assert outcome.out.splitlines() == [f"{BUS}: the supervisor was told", f"{BUS}: no drive has torque"]
    assert all(words.startswith("`isocenter stop` (user ") for words in ended[0].heard)


def test_a_bench_that_ends_meanwhile_is_told(isocenter: Isocenter, ended: list[Supervisor], monkeypatch: pytest.MonkeyPatch) -> None:
    ended.append(Supervisor("torque on\n"))
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
    ended.append(Supervisor("torque on\n"))
    outcome = isocenter("stop", "--bus", BUS)
    assert outcome.status == 1
    assert "a drive has torque or tells nothing after" in outcome.line


def test_a_bus_without_a_bench_is_told(isocenter: Isocenter) -> None:
    outcome = isocenter("stop", "--bus", BUS)
    assert outcome.status == 2
    assert "no bench of yours runs on this bus" in outcome.line
