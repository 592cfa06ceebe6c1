"""The supervisor's process, run here: what it reads and writes in shared memory, and what it is asked over its socket."""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from multiprocessing.shared_memory import SharedMemory
from pathlib import Path
from typing import cast

import can
import numpy as np
import pytest
from bench_machines import CARM

from drivers.errors import BusUnavailableError
from drivers.modbus.refresh import FIRST_WORD, following_word
from drivers.shared_memory.block import Block
from drivers.shared_memory.io_state import IoState, published_block, state_values, values_of
from drivers.shared_memory.supervisor_blocks import (
    ANSWER,
    ASKED,
    END,
    FRAME,
    ORDERS,
    OWN,
    PERMITS,
    ROUNDS,
    SESSION,
    TICK_S,
    WORD,
    AnswerReader,
    blocks_of,
)
from drivers.supervisor import process, rounds
from drivers.supervisor.process import BusLine, StopSocket, Tap
from drivers.supervisor.rounds import Clock, Line, Rounds, Shared
from drivers.supervisor.supervisor import Supervisor

assert CARM.bus is not None
SETTINGS = CARM.bus
AXES = len(CARM.axes)
SYNC = SETTINGS.sync_cob_id
ROLL = next(node for node in SETTINGS.nodes if node.name == "roll_drive")
POWERED = bytes.fromhex("37 16") + bytes(6)


class Bench:
    """Both memories, and the bench's end of the tap; the supervisor's rounds run in this thread."""

    def __init__(self, stop_socket: Path | None = None) -> None:
        self.memory = SharedMemory(create=True, size=Block.bytes(OWN) + Block.bytes(ORDERS))
        self.own, self.orders = blocks_of(self.memory)
        self.io_memory = SharedMemory(create=True, size=Block.bytes(state_values(AXES)))
        self.io = published_block(self.io_memory, AXES)
        self.here, self.there = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
        self.stop_socket = stop_socket
        self.parent = os.getppid()
        self.priority = 1
        self.refuses = False
        self.order(1.0, end=False)
        self.seen = np.zeros(OWN)
        self.settings = SETTINGS
        self.signals: list[tuple[int, object]] = []
        self.scheduled: list[tuple[int, int, int]] = []

    def state(self, *, pressed: bool = True, closed: bool = True) -> None:
        state = IoState(AXES)
        state.hold_to_run, state.door_closed, state.word, state.time_s = pressed, closed, FIRST_WORD, time.monotonic()
        self.io.write(values_of(state))

    def order(self, session: float, *, end: bool) -> None:
        told = np.zeros(ORDERS)
        told[0], told[END] = session, end
        self.orders.write(told)

    def tell_tick(self, tick_s: float) -> None:
        told = np.zeros(ORDERS)
        self.orders.read(told)
        told[TICK_S] = tick_s
        self.orders.write(told)

    def run(
        self,
        *,
        during: Callable[[int], None] = lambda number: None,
        url: str = "",
        rounds: int = 3,
        io: bool = True,
        line: Line | None = None,
        supervisor: Told | None = None,
        clock: Clock = time,
    ) -> None:
        """Make so many rounds; `during` is called with the number of each."""
        judge = Supervisor(self.settings) if supervisor is None else cast(Supervisor, supervisor)
        with contextlib.ExitStack() as stack:
            line = line or (BusLine(stack, url, self.settings.bitrate_bit_s) if url else Tap(self.there))
            asked = StopSocket(stack, self.stop_socket).asked
            shared = Shared(self.own, self.orders, self.io if io else None)
            made = Rounds(self.settings, judge, line, shared, asked, lambda: os.getppid() == self.parent, clock)
            count = 0
            while not made.is_over:
                made.round()
                count += 1
                during(count)
                if count >= rounds:
                    told = np.zeros(ORDERS)
                    self.orders.read(told)
                    told[END] = 1.0
                    self.orders.write(told)
        self.own.read(self.seen)

    def supervise(self, url: str = "", io_memory: str | None = None) -> None:
        """Run the process's own function to an end that it is told from the beginning, but for what it would do to the tests' process."""
        io_memory = self.io_memory.name if io_memory is None else io_memory
        self.order(1.0, end=True)
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(process.signal, "signal", lambda *words: self.signals.append(words))
            patch.setattr(process.os, "sched_setscheduler", self.schedule)
            tap = None if url else self.there
            process.supervise(self.settings, url, self.memory.name, io_memory, self.parent, self.priority, self.stop_socket, tap)
        self.own.read(self.seen)

    def schedule(self, which: int, policy: int, parameters: os.sched_param) -> None:
        self.scheduled.append((which, policy, parameters.sched_priority))
        if self.refuses:
            raise PermissionError

    def close(self) -> None:
        for block in (self.own, self.orders, self.io):
            block.release()
        for memory in (self.memory, self.io_memory):
            memory.close()
            memory.unlink()
        self.here.close()
        self.there.close()


@pytest.fixture
def bench() -> Iterator[Bench]:
    bench = Bench()
    yield bench
    bench.close()


def test_it_permits_and_answers_the_word_that_the_poller_has_read(bench: Bench) -> None:
    bench.state()
    bench.order(5.0, end=False)
    bench.run()
    assert bench.seen[ROUNDS] == 4  # it hears of the end in the round after
    assert (bench.seen[SESSION], bench.seen[PERMITS], bench.seen[ASKED]) == (5, 1, 0)
    assert (bench.seen[WORD], bench.seen[ANSWER]) == (FIRST_WORD, following_word(FIRST_WORD))
    assert bench.own.text == ""
    reader = AnswerReader(bench.memory.name)
    state = IoState(AXES)
    state.word = FIRST_WORD
    assert reader(state) == following_word(FIRST_WORD)
    state.word += 1
    assert reader(state) is None
    bench.own._sequence[0] += 1  # the supervisor died while it wrote
    state.word = FIRST_WORD
    assert reader(state) is None
    bench.own._sequence[0] += 1
    reader.close()


def test_a_drive_with_torque_whose_sync_stops_ends_the_permission_and_its_network(bench: Bench) -> None:
    bench.state()
    tpdo = next(pdo for pdo in ROLL.tpdos if any(index == 0x6041 for index, _, _ in pdo.entries))
    bench.here.send(FRAME.pack(SYNC, 0, bytes(8)))
    bench.here.send(FRAME.pack(tpdo.cob_id, 8, POWERED))
    bench.run(rounds=400)
    assert bench.seen[PERMITS] == 0
    assert bench.own.text.startswith("no SYNC for")
    sent = [FRAME.unpack(bench.here.recv(FRAME.size))]
    assert [(can_id, data[:length]) for can_id, length, data in sent] == [(0, b"\x02\x02")]
    reader = AnswerReader(bench.memory.name)
    state = IoState(AXES)
    state.word = FIRST_WORD
    assert reader(state) is None
    reader.close()


def test_a_bench_that_is_gone_ends_the_permission_and_then_the_process(bench: Bench) -> None:
    line = HeldUp(0.0)
    bench.parent += 1
    bench.run(rounds=5000, line=line, clock=line)
    assert bench.own.text == "the bench's process is gone"
    assert line.now_s == pytest.approx(rounds.LINGERS_S, rel=0.05)
    assert 1 < bench.seen[ROUNDS] < 5000


def test_a_bus_that_it_opens_itself(bench: Bench) -> None:
    other = can.Bus(interface="virtual", channel="supervised")
    for message in (
        can.Message(arbitration_id=SYNC, is_extended_id=True),
        can.Message(arbitration_id=SYNC, is_remote_frame=True, is_extended_id=False),
        can.Message(arbitration_id=SYNC, is_extended_id=False, data=b""),
    ):
        other.send(message)
    bench.run(url="virtual:supervised", io=False, rounds=2)
    other.shutdown()
    assert bench.seen[PERMITS] == 1
    assert bench.seen[WORD] == 0


def test_it_sends_on_a_bus_that_it_opened(bench: Bench) -> None:
    other = can.Bus(interface="virtual", channel="supervised")

    def say(number: int) -> None:
        if number == 1:
            tpdo = next(pdo for pdo in ROLL.tpdos if any(index == 0x6041 for index, _, _ in pdo.entries))
            for cob_id, data in ((SYNC, b""), (tpdo.cob_id, POWERED)):
                other.send(can.Message(arbitration_id=cob_id, is_extended_id=False, data=data))

    bench.run(url="virtual:supervised", rounds=400, during=say)
    heard = other.recv(0.0)
    other.shutdown()
    assert heard is not None
    assert (heard.arbitration_id, heard.is_extended_id, bytes(heard.data)) == (0, False, b"\x02\x02")


def test_what_is_no_data_frame_is_not_heard() -> None:
    other = can.Bus(interface="virtual", channel="heard")
    with contextlib.ExitStack() as stack:
        line = BusLine(stack, "virtual:heard", 1_000_000)
        others = ({"is_extended_id": True}, {"is_remote_frame": True}, {"is_error_frame": True}, {"is_fd": True}, {})
        for kind in others:
            other.send(can.Message(arbitration_id=SYNC, **{"is_extended_id": False, **kind}))  # type: ignore[arg-type]
        assert [line.receive(), line.receive()] == [(SYNC, b""), None], "what others send keeps no frame from being heard"
    other.shutdown()


class Told:
    """A supervisor that keeps what it is told, and the clock of one whose frames take long."""

    def __init__(self) -> None:
        self.states: list[tuple[bool, bool]] = []
        self.asks: list[tuple[bool, str]] = []
        self.reason, self.asked_by, self.torque = "", "", "torque on"
        self.held, self.later_s = 0, 0.0
        self.orders: list[tuple[int, int]] = []

    def monotonic(self) -> float:
        return time.monotonic() + self.later_s

    def sleep(self, seconds: float) -> None:
        self.later_s += seconds

    def begin(self) -> None: ...

    def end(self) -> None: ...

    def frame(self, time_s: float, can_id: int, data: bytes) -> None:
        self.later_s += 1.5 * rounds.HELD_UP_ROUNDS * 0.5 * SETTINGS.sync_period_s

    def held_up(self) -> None:
        self.held += 1

    def io(self, time_s: float, hold_to_run: bool, door_closed: bool, brakes_open: np.ndarray) -> None:
        self.states.append((hold_to_run, door_closed))

    def ask_to_stop(self, time_s: float, who: str) -> None:
        self.asks.append((isinstance(time_s, float), who))

    def answer(self, time_s: float, word: int) -> int | None:
        return None

    def commands(self, time_s: float) -> list[tuple[int, int]]:
        return self.orders


@pytest.mark.parametrize(("pressed", "closed"), [(True, False), (False, True)])
def test_the_state_of_the_io_and_who_asks_reach_the_supervisor(tmp_path: Path, pressed: bool, closed: bool) -> None:
    told, bench = Told(), Bench(tmp_path / "stop.socket")
    answers: list[bytes] = []
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as line:
        line.bind(str(tmp_path / "me"))
        line.settimeout(10.0)

        def during(number: int) -> None:
            if number == 1:
                bench.state(pressed=pressed, closed=closed)
                line.sendto(b"\xffsomebody", str(tmp_path / "stop.socket"))
            if number == 3:
                answers.append(line.recv(1000))
                line.sendto(b"again", str(tmp_path / "stop.socket"))
            if number == 5:
                answers.append(line.recv(1000))

        bench.run(during=during, rounds=5, supervisor=told)
    assert answers == [b"torque on\n", b"torque on\n"]
    assert told.states[-1] == (pressed, closed)
    assert set(told.asks) == {(True, "\ufffdsomebody")}
    assert (bench.seen[PERMITS], bench.seen[ANSWER]) == (0, 0)
    bench.close()


def test_a_bus_that_cannot_be_opened_is_said(bench: Bench) -> None:
    bench.supervise("slcan:/dev/none@1000000")
    assert bench.own.text.startswith("the supervisor cannot open the bus: slcan:/dev/none")
    assert bench.seen[ROUNDS] == 0


def test_a_bus_that_fails_ends_the_permission(bench: Bench) -> None:
    bench.run(during=lambda number: bench.there.close() if number == 1 else None)
    assert bench.own.text.startswith("the bus cannot be read: ")
    assert bench.seen[PERMITS] == 0


def test_who_asks_for_a_stop_is_heard_answered_and_remembered_over_sessions(tmp_path: Path) -> None:
    bench = Bench(tmp_path / "stop.socket")
    answers: list[bytes] = []
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as line:
        line.bind(str(tmp_path / "me"))
        line.settimeout(10.0)

        def ask(number: int) -> None:
            if number == 1:
                line.sendto(b"somebody", str(tmp_path / "stop.socket"))
            if number == 2:
                answers.append(line.recv(1000))
                bench.order(2.0, end=False)

        bench.run(during=ask, rounds=5)
    assert answers == [b"unknown\n"]
    assert (bench.seen[ASKED], bench.own.text, bench.seen[PERMITS], bench.seen[SESSION]) == (1, "somebody", 0, 2)
    assert not (tmp_path / "stop.socket").exists()
    bench.close()


def test_nobody_can_ask_without_unix_sockets(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr(process.socket, "AF_UNIX")
    monkeypatch.delattr(process.signal, "SIGHUP")
    bench.stop_socket, bench.priority = Path("never.socket"), 0
    bench.supervise()
    assert bench.seen[ROUNDS] == 1
    assert not Path("never.socket").exists()


def test_a_machine_without_io_is_judged_by_its_bus_alone(bench: Bench) -> None:
    bench.settings, bench.stop_socket = replace(SETTINGS, io=None), None
    bench.supervise(io_memory="")
    assert (bench.seen[ROUNDS], bench.seen[PERMITS], bench.seen[ANSWER], bench.own.text) == (1, 1, 0, "")


def test_a_socket_that_cannot_be_made_keeps_nothing_from_running(bench: Bench, tmp_path: Path) -> None:
    bench.stop_socket = tmp_path / ("long" * 30) / "stop.socket"
    bench.run(rounds=1)
    assert bench.seen[PERMITS] == 1


def test_a_session_that_has_ended_permits_nothing(bench: Bench) -> None:
    bench.order(-1.0, end=False)
    bench.run()
    assert (bench.seen[PERMITS], bench.own.text) == (0, "no bench runs")


def test_a_state_of_the_io_that_is_old_is_none(bench: Bench) -> None:
    told = Told()
    bench.state()
    told.later_s = 1e6
    bench.run(rounds=1, supervisor=told, clock=told)
    assert told.states[-1] == (False, False)


def test_frames_come_from_another_thread(bench: Bench) -> None:
    """A round takes what has come by its end."""
    flood = threading.Event()

    def send() -> None:
        while not flood.is_set():
            bench.here.send(FRAME.pack(0x7FF, 1, bytes(8)))

    sender = threading.Thread(target=send)
    sender.start()
    bench.run(rounds=3, during=lambda number: flood.set() if number == 3 else None)
    bench.there.setblocking(False)
    while sender.is_alive():  # it may wait for room
        with contextlib.suppress(BlockingIOError):
            bench.there.recv(FRAME.size)
    assert bench.seen[ROUNDS] == 4


class HeldUp:
    """A clock, and a bus on which everything goes on while the process that reads it is held up for a while."""

    def __init__(self, held_up_s: float) -> None:
        self.now_s, self._sent_s, self._held_up_s = 0.0, 0.0, held_up_s
        self.frames: list[tuple[int, bytes]] = []
        self.tpdo = next(pdo for pdo in ROLL.tpdos if any(index == 0x6041 for index, _, _ in pdo.entries)).cob_id

    def monotonic(self) -> float:
        return self.now_s

    def sleep(self, seconds: float) -> None:
        self.now_s += seconds

    def send(self, can_id: int, data: bytes) -> None: ...

    def receive(self) -> tuple[int, bytes] | None:
        if self.now_s > 1.0:
            self.now_s, self._held_up_s = self.now_s + self._held_up_s, 0.0
        while self._sent_s <= self.now_s:
            self.frames += [(self.tpdo, POWERED), (SYNC, b"")]
            self._sent_s += SETTINGS.sync_period_s
        self.now_s += 1e-5
        return self.frames.pop(0) if self.frames else None


@pytest.mark.parametrize("held_up_s", [0.0, 0.06, 0.1, 0.4, 1.5])
def test_a_supervisor_that_was_held_up_reads_what_lies_there_before_it_judges(bench: Bench, held_up_s: float) -> None:
    """Else the SYNCs of a loop that works are missed, or come faster than they may."""
    line = HeldUp(held_up_s)
    bench.run(rounds=1000, io=False, line=line, clock=line)
    assert line.now_s > 1.9
    assert bench.own.text == ""
    assert bench.seen[PERMITS] == 1


class Measured(HeldUp):
    """A bus that keeps how long is slept before it is read, and how often it is read."""

    def __init__(self) -> None:
        super().__init__(0.0)
        self.slept_s: list[float] = []
        self.read = 0

    def sleep(self, seconds: float) -> None:
        self.slept_s.append(seconds)
        super().sleep(seconds)

    def receive(self) -> tuple[int, bytes] | None:
        self.read += 1
        return super().receive()


def test_what_a_round_has_left_is_taken_at_once(bench: Bench) -> None:
    line = Measured()
    line.frames = [(0x7FF, b"")] * (3 * rounds.MOST_FRAMES)
    bench.run(rounds=4, io=False, line=line, clock=line)
    assert not line.frames
    assert len(line.slept_s) == 2, "before the first round, and after the last that left any"


def test_a_flood_does_not_keep_it_from_judging(bench: Bench) -> None:
    line = HeldUp(0.0)
    line.frames = [(0x7FF, b"")] * (3 * rounds.MOST_FRAMES)
    bench.run(rounds=1, io=False, line=line, clock=line)
    assert len(line.frames) >= rounds.MOST_FRAMES, "it hears of the end in its second round"


def test_the_bus_is_opened_at_the_machines_bit_rate(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    opened: list[tuple[str, int]] = []

    def refuse(url: str, bitrate: int) -> can.BusABC:
        opened.append((url, bitrate))
        raise BusUnavailableError("no bus here")

    monkeypatch.setattr(process, "open_bus", refuse)
    bench.settings = replace(SETTINGS, bitrate_bit_s=250_000)
    bench.supervise("virtual:told")
    assert opened == [("virtual:told", 250_000)]
    assert bench.own.text == "the supervisor cannot open the bus: no bus here"


def test_frames_that_it_sends_keep_their_identifiers() -> None:
    other = can.Bus(interface="virtual", channel="told")
    with contextlib.ExitStack() as stack:
        BusLine(stack, "virtual:told", 1_000_000).send(0x123, b"\x01")
    heard = other.recv(0.0)
    other.shutdown()
    assert heard is not None
    assert (heard.arbitration_id, heard.is_extended_id, bytes(heard.data)) == (0x123, False, b"\x01")


def test_memory_that_was_closed_is_told(bench: Bench) -> None:
    memory = SharedMemory(name=bench.memory.name)
    memory.close()
    with pytest.raises(AssertionError, match=r"^shared memory was closed$"):
        blocks_of(memory)


def test_a_tap_that_is_full_is_not_waited_for() -> None:
    here, there = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
    with here, there:
        tap = Tap(there)
        with contextlib.suppress(BlockingIOError):  # and no time-out
            while True:
                tap.send(0, b"\x02\x01")
        with pytest.raises(BlockingIOError):
            tap.send(0, b"\x02\x01")


@pytest.mark.parametrize(("status", "said"), [(0x1633, "no torque"), (0x1637, "torque on")])
def test_who_asks_is_told_whether_a_drive_has_torque(tmp_path: Path, status: int, said: str) -> None:
    bench = Bench(tmp_path / "stop.socket")
    for node in SETTINGS.nodes:
        for pdo in node.tpdos:
            if any(index == 0x6041 for index, _, _ in pdo.entries):
                bench.here.send(FRAME.pack(pdo.cob_id, 8, status.to_bytes(2, "little") + bytes(6)))
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as line:
        line.bind(str(tmp_path / "me"))
        line.settimeout(10.0)
        bench.run(during=lambda number: line.sendto(b"who", str(tmp_path / "stop.socket")) if number == 2 else None, rounds=4)
        assert line.recv(1000).decode() == f"{said}\n"
    bench.close()


def test_one_who_has_no_address_is_heard_and_gets_no_answer(tmp_path: Path) -> None:
    """Of what is asked 200 bytes are kept; the socket's name may be gone by the end."""
    path = tmp_path / "stop.socket"
    bench = Bench(path)

    def during(number: int) -> None:
        if number == 1:
            with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as line:
                line.sendto(b"x" * 300, str(path))
            path.unlink()

    bench.run(during=during, rounds=3)
    assert (bench.seen[ASKED], bench.own.text) == (1, "x" * 200)
    bench.close()


def test_signals_of_the_terminal_end_nothing_and_the_priority_is_asked_for(bench: Bench) -> None:
    bench.priority = 7
    bench.supervise()
    assert bench.signals == [(number, signal.SIG_IGN) for number in (signal.SIGINT, signal.SIGHUP, signal.SIGQUIT)]
    assert bench.scheduled == [(0, os.SCHED_FIFO, 7)]
    bench.priority = 0
    bench.supervise()
    assert len(bench.scheduled) == 1


def test_a_priority_that_is_refused_keeps_nothing_from_running(bench: Bench) -> None:
    bench.refuses = True
    bench.supervise()
    assert bench.scheduled
    assert bench.seen[PERMITS] == 1


def test_a_round_sleeps_for_half_a_period_and_takes_what_has_come(bench: Bench) -> None:
    """A process that waits for frames is woken by each, and takes the processor from whoever exchanges them."""
    line = Measured()
    bench.run(rounds=20, io=False, line=line, clock=line)
    assert line.slept_s == [pytest.approx(0.5 * SETTINGS.sync_period_s, abs=1e-6)] * 21  # one a round; it hears of the end in the last
    assert 2 * 10 <= line.read - 21 <= 2 * 12, "SYNC and TPDO of ten or eleven periods"
    assert line.read - 21 + len(line.frames) >= 20


class Beside(Measured):
    """A bus on which nothing comes, and that keeps when it is first read in each round."""

    def __init__(self) -> None:
        super().__init__()
        self.read_at_s: list[float] = []

    def receive(self) -> tuple[int, bytes] | None:
        self.read_at_s.append(self.now_s)
        self.now_s += 1e-5
        return None


@pytest.mark.parametrize("tick_s", [1e-3, 0.2, 0.5003, 1.0 - 1e-9])
def test_rounds_end_between_the_ticks_that_the_loop_tells(bench: Bench, tick_s: float) -> None:
    line, period_s = Beside(), SETTINGS.sync_period_s
    line.now_s = 1.0
    bench.run(rounds=41, io=False, line=line, clock=line, during=lambda number: bench.tell_tick(tick_s))
    places = (np.array(line.read_at_s[2:]) - tick_s) / period_s % 1.0
    assert np.minimum(abs(places - 0.35), abs(places - 0.85)).max() < 1e-3
    assert max(line.slept_s) <= 0.5 * period_s + 1e-9
    assert line.read_at_s[-1] - line.read_at_s[2] == pytest.approx(0.5 * period_s * (len(line.read_at_s) - 3), abs=1e-5), "none left out"


@pytest.mark.parametrize("tick_s", [-1.0, 1e9, np.inf, np.nan])
def test_a_tick_that_cannot_have_been_changes_no_round(bench: Bench, tick_s: float) -> None:
    line = Beside()
    bench.run(rounds=10, io=False, line=line, clock=line, during=lambda number: bench.tell_tick(tick_s))
    assert line.slept_s == [pytest.approx(0.5 * SETTINGS.sync_period_s, abs=1e-6)] * 11


def test_a_round_that_took_long_was_held_up(bench: Bench) -> None:
    told = Told()
    bench.here.send(FRAME.pack(SYNC, 0, bytes(8)))
    bench.run(rounds=3, supervisor=told, clock=told)
    assert told.held >= 1


def test_a_machine_without_io_is_supervised_too(bench: Bench) -> None:
    bench.settings = replace(SETTINGS, io=None)
    bench.run(rounds=1, io=False)
    assert bench.seen[PERMITS] == 1


def test_an_io_that_nobody_has_read_yet_permits_nothing_to_move(bench: Bench) -> None:
    told = Told()
    bench.run(rounds=1, supervisor=told)
    assert told.states[-1] == (False, False)


def test_there_is_no_session_of_the_number_zero(bench: Bench) -> None:
    bench.run(rounds=3, during=lambda number: bench.order(0.0, end=False) if number == 1 else None)
    assert (bench.seen[PERMITS], bench.own.text) == (0, "no bench runs")


class Full(HeldUp):
    """A bus that takes no frame."""

    def __init__(self, error: Exception) -> None:
        super().__init__(0.0)
        self.sent: list[tuple[int, bytes]] = []
        self._error = error

    def send(self, can_id: int, data: bytes) -> None:
        self.sent.append((can_id, data))
        raise self._error


@pytest.mark.parametrize("error", [can.CanError("no buffer"), OSError("no buffer")])
def test_a_command_that_cannot_be_sent_ends_nothing(bench: Bench, error: Exception) -> None:
    line, told = Full(error), Told()
    told.orders = [(2, 2), (0x81, 5)]
    bench.run(rounds=3, line=line, supervisor=told, clock=line)
    assert line.sent[:2] == [(0, b"\x02\x02"), (0, b"\x81\x05")]
    assert bench.seen[ROUNDS] == 4


def test_one_who_is_gone_before_the_answer_ends_nothing(tmp_path: Path) -> None:
    bench = Bench(tmp_path / "stop.socket")

    def during(number: int) -> None:
        if number == 1:
            with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as line:
                line.bind(str(tmp_path / "me"))
                line.sendto(b"somebody", str(tmp_path / "stop.socket"))

    bench.run(during=during, rounds=3)
    assert (bench.seen[ASKED], bench.own.text) == (1, "somebody")
    bench.close()


class StalledLine:
    """A bench that sends SYNC on time, and a supervisor's process that once stands still; both by a clock of this test's."""

    def __init__(self, stalls_s: float, share_of_period: float = 1.0) -> None:
        self.now_s, self._stall_at_s, self._stalls_s = 100.0, 101.0, stalls_s
        self._share, self._sent = share_of_period, 0

    def monotonic(self) -> float:
        self.now_s += 1e-6
        return self.now_s

    def sleep(self, seconds: float) -> None:
        self.now_s += seconds

    def send(self, can_id: int, data: bytes) -> None: ...

    def receive(self) -> tuple[int, bytes] | None:
        if 100.0 + self._sent // 2 * self._share * SETTINGS.sync_period_s > self.now_s:
            return None
        self.now_s += 1e-5
        if self.now_s > self._stall_at_s:
            self.now_s, self._stall_at_s = self.now_s + self._stalls_s, np.inf
        self._sent += 1
        return (SYNC, b"") if self._sent % 2 else (ROLL.tpdos[0].cob_id, POWERED)


@pytest.mark.parametrize(("stalls_s", "share", "permits"), [(0.03, 1.0, 1.0), (0.15, 1.0, 1.0), (0.15, 0.5, 0.0)])
def test_a_backlog_of_syncs_after_a_stall_is_no_second_producer_and_a_second_producer_is_one(
    bench: Bench, stalls_s: float, share: float, permits: float
) -> None:
    line = StalledLine(stalls_s, share)
    bench.run(rounds=1100, io=False, line=line, clock=line)
    assert line.now_s > 102.0
    assert bench.seen[PERMITS] == permits
