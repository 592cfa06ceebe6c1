"""The polling process: the loop never waits for the I/O device, and brakes close when the loop dies or stands still."""

from __future__ import annotations

import contextlib
import itertools
import multiprocessing
import os
import signal
import subprocess
import sys
import textwrap
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from modbus_wiring import AXES, ServedTcp, emulated_io, eventually, io_map
from places import ROOT, SUPPORT

from drivers.errors import BusUnavailableError, ConfigurationRefusedError
from drivers.interface import Sample
from drivers.modbus.io_process import IoProcess
from virtual_bus.modbus.framing import TcpFraming
from virtual_bus.modbus.io_device import EmulatedIo

WRITE_COILS = 0x0F
FUNCTION_BYTE = 7  # of a Modbus/TCP message, behind the MBAP header


def writes_coils(data: bytes) -> bool:
    return data[FUNCTION_BYTE] == WRITE_COILS


def ticking(process: IoProcess, condition: Callable[..., object], sample: Sample | None = None) -> Callable[..., bool]:
    """The condition, for `eventually`, asked by a loop that ticks."""
    sample = sample or Sample(2)

    def ask() -> bool:
        process.update(sample)
        return condition()

    return ask


@pytest.fixture
def served() -> Iterator[tuple[EmulatedIo, ServedTcp]]:
    """A device on TCP."""
    device = emulated_io()
    server = ServedTcp(device)
    yield device, server
    server.close()


def test_state_and_brake_commands_pass_and_closing_closes_the_brakes(served: tuple[EmulatedIo, ServedTcp]) -> None:
    device, server = served
    device.set_temperature("roll", 36.6)
    device.set_door(False)
    process = IoProcess(io_map(server.url, poll_period_s=0.01, stale_after_s=60.0), AXES)
    process.start()
    sample = Sample(2)
    process.update(sample)
    assert sample.temperature_degC.tolist() == [0.0, 36.6]
    assert (sample.hold_to_run, sample.door_closed) == (True, False)
    assert 0.0 <= sample.io_age_s < 60.0

    process.command_brakes({"roll": True})
    assert eventually(ticking(process, lambda: device.coils == [False, False, True]))
    device.advance(0.0)
    device.advance(1.0)

    def roll_reads_open() -> bool:
        process.update(sample)
        return sample.brakes_open.tolist() == [False, True]

    assert eventually(roll_reads_open)
    process.close()
    assert device.coils == [False, False, False]
    assert process.trouble == ""
    process.close()  # any number of times


def test_a_device_that_cannot_be_reached_fails_the_start_with_its_reason() -> None:
    server = ServedTcp(emulated_io())
    server.close()
    process = IoProcess(io_map(server.url), AXES)
    with pytest.raises(BusUnavailableError, match=rf"^io on tcp:127.0.0.1:{server.port}: cannot connect: Connection refused"):
        process.start()


def test_a_device_that_refuses_fails_the_start_with_its_words(served: tuple[EmulatedIo, ServedTcp]) -> None:
    _, server = served
    with pytest.raises(ConfigurationRefusedError, match="illegal data address"):
        IoProcess(io_map(server.url, door_input=99), AXES).start()


def test_a_lost_device_goes_stale_and_comes_back_with_brakes_closed(served: tuple[EmulatedIo, ServedTcp]) -> None:
    device, server = served
    process = IoProcess(io_map(server.url, poll_period_s=0.01, stale_after_s=0.1), AXES)
    process.start()
    process.command_brakes({"roll": True})
    assert eventually(ticking(process, lambda: device.coils[2]))
    reachable = device.serve_tcp
    device.serve_tcp = lambda framing, data: b""  # the cable is pulled: requests vanish
    sample = Sample(2)

    def stale() -> bool:
        process.update(sample)
        return sample.io_age_s > 0.1

    assert eventually(stale)
    assert not sample.hold_to_run
    assert np.isnan(sample.temperature_degC).all()
    assert eventually(lambda: "no answer from unit 17" in process.error)
    device.serve_tcp = reachable
    assert eventually(lambda: device.coils == [False, False, False])  # open before, nobody knows what happened since: closed

    def fresh() -> bool:
        process.update(sample)
        return sample.io_age_s < 0.1 and sample.hold_to_run

    assert eventually(fresh)
    process.command_brakes({"roll": True})
    assert eventually(ticking(process, lambda: device.coils[2]))
    process.close()


def test_brakes_of_a_loop_that_stands_still_close_and_stay_closed_until_they_are_commanded_anew(
    served: tuple[EmulatedIo, ServedTcp],
) -> None:
    device, server = served
    process = IoProcess(io_map(server.url, poll_period_s=0.01, stale_after_s=60.0), AXES)
    process.start()
    process.command_brakes({"propeller": True, "roll": True})
    assert eventually(ticking(process, lambda: device.coils == [False, True, True]))
    last_tick_s = time.monotonic()
    process.update(Sample(2))
    assert eventually(lambda: device.coils == [False, False, False])
    assert time.monotonic() - last_tick_s > 0.5  # over a hundred ticks, which no busy processor explains

    polls = []
    serve = device.serve_tcp
    device.serve_tcp = lambda framing, data: polls.append(data) or serve(framing, data)
    assert eventually(ticking(process, lambda: len(polls) > 10))
    assert not any(map(writes_coils, polls)), "ticks alone open nothing"
    process.command_brakes({"roll": True})
    assert eventually(ticking(process, lambda: device.coils == [False, False, True])), "the propeller's order is as old as the standstill"
    process.close()


def test_a_process_that_never_opened_a_brake_leaves_the_brakes_as_they_are(served: tuple[EmulatedIo, ServedTcp]) -> None:
    device, server = served
    device.coils[:] = [True, True, True]  # another bench's
    process = IoProcess(io_map(server.url, poll_period_s=0.01), AXES)
    process.start()
    process.update(Sample(2))
    process.close()
    assert device.coils == [True, True, True]
    assert process.trouble == ""


def test_closing_is_tried_five_times_with_a_pause_in_which_a_device_restarts_its_server(served: tuple[EmulatedIo, ServedTcp]) -> None:
    device, server = served
    process = IoProcess(io_map(server.url, poll_period_s=0.01, stale_after_s=60.0), AXES)
    process.start()
    process.command_brakes({"roll": True})
    assert eventually(ticking(process, lambda: device.coils[2]))
    serve, refused_s = device.serve_tcp, []

    def hang_up(framing: TcpFraming, data: bytes) -> bytes:
        if writes_coils(data) and len(refused_s) < 4:
            refused_s.append(time.monotonic())
            raise ConnectionResetError
        return serve(framing, data)

    device.serve_tcp = hang_up
    process.close()
    assert device.coils == [False, False, False]
    assert process.trouble == ""
    assert all(later - earlier > 0.15 for earlier, later in itertools.pairwise(refused_s))


@pytest.mark.slow
def test_a_device_that_is_silent_to_the_end_leaves_its_trouble_to_the_caller(served: tuple[EmulatedIo, ServedTcp]) -> None:
    device, server = served
    process = IoProcess(io_map(server.url, poll_period_s=0.01, stale_after_s=60.0), AXES)
    process.start()
    process.command_brakes({"roll": True})
    assert eventually(ticking(process, lambda: device.coils[2]))
    device.serve_tcp = lambda framing, data: b""
    process.close()
    assert process.trouble == (
        f"io on {server.url}: no answer from unit 17 in 0.2 s; check unit_id; the brakes could not be closed in 5 attempts and may be open"
    )


def test_a_second_sigterm_does_not_break_the_closing_of_the_brakes(served: tuple[EmulatedIo, ServedTcp]) -> None:
    device, server = served
    process = IoProcess(io_map(server.url, poll_period_s=0.01, stale_after_s=60.0), AXES)
    process.start()
    (child,) = (child for child in multiprocessing.active_children() if child.name == "isocenter-io")
    process.command_brakes({"roll": True})
    assert eventually(ticking(process, lambda: device.coils[2]))
    serve, closing = device.serve_tcp, threading.Event()

    def mute(framing: TcpFraming, data: bytes) -> bytes:
        if writes_coils(data):
            closing.set()
        return b""

    device.serve_tcp = mute
    os.kill(child.pid, signal.SIGTERM)
    assert eventually(ticking(process, closing.is_set))
    os.kill(child.pid, signal.SIGTERM)
    device.serve_tcp = serve
    assert eventually(lambda: device.coils == [False, False, False])
    process.close()


@pytest.mark.parametrize("end", [signal.SIGKILL, signal.SIGSTOP], ids=["killed", "hangs"])
def test_a_polling_process_that_is_gone_or_hangs_is_replaced_to_close_the_brakes(
    served: tuple[EmulatedIo, ServedTcp], end: signal.Signals, monkeypatch: pytest.MonkeyPatch
) -> None:
    device, server = served
    monkeypatch.setattr("drivers.modbus.io_process.POLLER_HANGS_S", 0.2)
    process = IoProcess(io_map(server.url, poll_period_s=0.01, stale_after_s=60.0), AXES)
    process.start()
    (child,) = (child for child in multiprocessing.active_children() if child.name == "isocenter-io")
    process.command_brakes({"roll": True})
    assert eventually(ticking(process, lambda: device.coils[2]))
    os.kill(child.pid, end)

    def closes() -> bool:
        process.command_brakes({"propeller": False, "roll": False})
        return not device.coils[2]

    assert eventually(ticking(process, closes))
    assert child.pid not in {other.pid for other in multiprocessing.active_children()}
    process.close()
    assert process.trouble == ""


LOOP = """
    import select
    import signal
    import sys
    sys.path.insert(0, {folder!r})
    from modbus_wiring import AXES, io_map
    from drivers.interface import Sample
    from drivers.modbus.io_process import IoProcess

    if __name__ == "__main__":
        for number in (signal.SIGHUP, signal.SIGQUIT):  # as on a terminal, whatever started the tests
            signal.signal(number, signal.SIG_DFL)
        process = IoProcess(io_map({url!r}, poll_period_s=0.01, stale_after_s=60.0), AXES)
        process.start()
        process.command_brakes({{"propeller": True, "roll": True}})
        print("running", flush=True)
        sample = Sample(2)
        while not select.select([sys.stdin], [], [], 0.005)[0]:
            process.update(sample)
"""


@contextlib.contextmanager
def loop_with_open_brakes(served: tuple[EmulatedIo, ServedTcp], tmp_path: Path) -> Iterator[subprocess.Popen[bytes]]:
    """A loop in a process group of its own, as a shell starts one, that ticks with both brakes open."""
    device, server = served
    script = tmp_path / "loop.py"
    script.write_text(textwrap.dedent(LOOP.format(folder=str(SUPPORT), url=server.url)))
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.DEVNULL}
    with subprocess.Popen([sys.executable, str(script)], cwd=ROOT, text=True, start_new_session=True, **pipes) as loop:
        try:
            assert loop.stdout.readline() == "running\n"
            assert eventually(lambda: device.coils == [False, True, True])
            yield loop
        finally:
            loop.kill()


@pytest.mark.slow
@pytest.mark.parametrize("end", ["exit", "SIGTERM", "SIGKILL", "SIGHUP to all", "SIGQUIT to all", "SIGKILL to all"])
def test_when_the_loops_process_dies_the_brakes_close(served: tuple[EmulatedIo, ServedTcp], tmp_path: Path, end: str) -> None:
    device, _ = served
    with loop_with_open_brakes(served, tmp_path) as loop:
        if end == "exit":
            loop.stdin.close()
        elif end.endswith("to all"):  # in front of the terminal: the terminal is gone, or Ctrl-\ was pressed
            os.killpg(loop.pid, getattr(signal, end.split()[0]))
        else:
            os.kill(loop.pid, getattr(signal, end))
        loop.wait()
        assert eventually(lambda: device.coils == [False, False, False])


def test_when_the_loops_process_hangs_the_brakes_close(served: tuple[EmulatedIo, ServedTcp], tmp_path: Path) -> None:
    device, _ = served
    with loop_with_open_brakes(served, tmp_path) as loop:
        os.kill(loop.pid, signal.SIGSTOP)
        assert eventually(lambda: device.coils == [False, False, False])
