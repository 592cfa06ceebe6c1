"""What the loop hears of its supervisor: whose word counts, for how long silence is borne, and what is told."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from multiprocessing.shared_memory import SharedMemory
from types import SimpleNamespace

import can
import numpy as np
import pytest
from bench_machines import CARM

from drivers.errors import BusUnavailableError
from drivers.modbus.refresh import FIRST_WORD, following_word
from drivers.settings import Pdo
from drivers.shared_memory.block import Block
from drivers.shared_memory.io_state import IoState
from drivers.shared_memory.supervisor_blocks import ASKED, END, ORDERS, OWN, PERMITS, ROUNDS, SESSION, TICK_S, WANTED_SESSION, blocks_of
from drivers.supervisor_link import process
from drivers.supervisor_link.in_process import SupervisorInProcess
from drivers.supervisor_link.process import SILENT_S, SupervisorProcess
from drivers.supervisor_link.tapped_bus import TappedBus

assert CARM.bus is not None
SETTINGS = CARM.bus
PERIOD_S = SETTINGS.sync_period_s


class Both:
    """The loop's side, and a supervisor that writes what a test says; a clock to go with them."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now_s = 100.0
        monkeypatch.setattr(process.time, "monotonic", lambda: self.now_s)
        self.supervisor = SupervisorProcess(SETTINGS, "udp:")
        self.memory = SharedMemory(name=self.supervisor.memory_name)
        self.own, self.orders = blocks_of(self.memory)
        self.rounds = 0.0

    def writes(self, *, session: float, permits: bool = True, asked: bool = False, text: str = "", is_round: bool = True) -> None:
        self.rounds += is_round
        values = np.zeros(OWN)
        values[[ROUNDS, SESSION, PERMITS, ASKED]] = self.rounds, session, permits, asked
        self.own.write(values, text)

    @property
    def ordered(self) -> tuple[float, float]:
        """The session that the loop wants, and whether the supervisor is to end."""
        values = np.zeros(ORDERS)
        self.orders.read(values)
        return float(values[WANTED_SESSION]), float(values[END])

    def close(self) -> None:
        self.own.release()
        self.orders.release()
        self.memory.close()
        self.supervisor.close()


@pytest.fixture
def both(monkeypatch: pytest.MonkeyPatch) -> Iterator[Both]:
    with contextlib.closing(Both(monkeypatch)) as both:
        yield both


def test_when_ticks_begin_is_told_and_changes_no_session(both: Both) -> None:
    values = np.zeros(ORDERS)
    both.supervisor.begin()
    both.now_s = 123.25
    both.supervisor.ticks_begin()
    both.orders.read(values)
    assert (values[TICK_S], both.ordered) == (123.25, (1.0, 0.0))


def test_sessions_are_numbered_and_one_that_has_ended_is_not_wanted_any_more(both: Both) -> None:
    assert both.ordered == (0.0, 0.0)
    both.supervisor.begin()
    assert both.ordered == (1.0, 0.0)
    both.supervisor.end()
    assert both.ordered == (-1.0, 0.0)
    both.supervisor.begin()
    assert both.ordered == (2.0, 0.0)


def test_only_what_it_says_of_this_session_counts(both: Both) -> None:
    both.supervisor.begin()
    both.writes(session=0.0, permits=False, text="something of before")
    assert both.supervisor.trouble() == "", "it has yet to hear of this session"
    both.writes(session=1.0)
    assert both.supervisor.trouble() == ""
    both.writes(session=1.0, permits=False, text="the door was opened")
    assert both.supervisor.trouble() == "the supervisor took its permission back: the door was opened"
    both.writes(session=1.0, asked=True, permits=False, text="isocenter stop")
    assert both.supervisor.trouble() == "asked to stop by isocenter stop"
    both.writes(session=1.0, permits=False, text="")
    assert both.supervisor.trouble() == "", "hold-to-run and door are the loop's to see"
    both.supervisor.end()
    assert both.supervisor.trouble() == ""


@pytest.mark.parametrize("what", ["no round", "a round of another session"])
def test_silence_is_borne_for_a_quarter_of_a_second_from_its_last_round(both: Both, what: str) -> None:
    both.supervisor.begin()
    for _ in range(100):
        both.now_s += 2.0 * PERIOD_S
        both.writes(session=1.0)
        assert both.supervisor.trouble() == ""
    looks = 0
    while not (says := both.supervisor.trouble()):
        both.now_s += PERIOD_S
        both.writes(session=1.0 if what == "no round" else 2.0, is_round=what != "no round")
        looks += 1
        assert looks < 100
    assert looks == round(SILENT_S / PERIOD_S) + 1
    assert says == f"the supervisor does not answer for {looks * PERIOD_S:.2f} s"
    both.writes(session=1.0)
    assert both.supervisor.trouble() == ""
    both.now_s += PERIOD_S
    both.supervisor.begin()
    assert both.supervisor.trouble() == ""


def test_a_loop_that_was_halted_hears_of_two_periods_of_silence_at_most(both: Both) -> None:
    both.supervisor.begin()
    both.writes(session=1.0)
    both.supervisor.trouble()
    looks = 0
    while not both.supervisor.trouble():
        both.now_s += 5.0
        looks += 1
    assert looks == int(SILENT_S / (2.0 * PERIOD_S)) + 1


def test_closing_tells_it_to_end_and_is_done_once(monkeypatch: pytest.MonkeyPatch) -> None:
    both = Both(monkeypatch)
    both.supervisor.begin()
    both.supervisor.close()
    assert both.ordered == (1.0, 1.0)
    both.close()
    with pytest.raises(FileNotFoundError):
        SharedMemory(name=both.supervisor.memory_name)


@pytest.mark.parametrize(("url", "is_tapped"), [("socketcan:vcan0", False), ("udp:", False), ("virtual:oversight", True)])
def test_the_frames_of_a_bus_with_one_owner_are_passed_on(url: str, is_tapped: bool) -> None:
    with can.Bus("oversight", interface="virtual") as bus, contextlib.closing(SupervisorProcess(SETTINGS, url)) as supervisor:
        tapped = supervisor.tapped(bus)
        assert (tapped is not bus) is is_tapped
        if is_tapped:
            assert isinstance(tapped, TappedBus)
            assert tapped.channel_info == bus.channel_info
            for k in range(10_000):  # nobody reads them; the loop goes on
                tapped.send(can.Message(arbitration_id=0x100, is_extended_id=False, data=k.to_bytes(2, "little")))


def test_both_blocks_fit_into_its_memory() -> None:
    with contextlib.closing(SupervisorProcess(SETTINGS, "udp:")) as supervisor:
        memory = SharedMemory(name=supervisor.memory_name)
        assert memory.size >= Block.bytes(OWN) + Block.bytes(ORDERS)
        memory.close()


class Started:
    """A process that was started; it lives until a test says, and writes what a test says."""

    def __init__(self, **told: object) -> None:
        self.told, self.exitcode, self.log = told, None, []

    def start(self) -> None:
        self.log.append("start")

    def is_alive(self) -> bool:
        return self.exitcode is None

    def join(self, timeout: float | None = None) -> None:
        self.log.append("join")

    def kill(self) -> None:
        self.log.append("kill")


@pytest.mark.parametrize(
    ("happens", "says"),
    [
        ("rounds", ""),
        ("ends", "udp:: the supervisor ended at its start with status 3"),
        ("nothing", "udp:: the supervisor did not start within 60 s"),
        ("cannot", "udp:: there is no such interface"),
        ("rounds and words", ""),
    ],
)
def test_a_supervisor_is_started_in_a_new_process_and_waited_for(monkeypatch: pytest.MonkeyPatch, happens: str, says: str) -> None:
    both = Both(monkeypatch)
    made: list[Started] = []

    def context(method: str) -> SimpleNamespace:
        assert method == "spawn"
        return SimpleNamespace(Process=lambda **told: (made.append(Started(**told)), made[0])[1])

    def sleep(seconds: float) -> None:
        both.now_s += seconds
        if both.now_s > 105.0:
            made[0].exitcode = 3 if happens == "ends" else None
            if happens in ("cannot", "rounds", "rounds and words"):
                words = "" if happens == "rounds" else "udp:: there is no such interface"
                both.writes(session=0.0, text=words, is_round=happens != "cannot")

    monkeypatch.setattr(process.multiprocessing, "get_context", context)
    monkeypatch.setattr(process.time, "sleep", sleep)
    if says:
        with pytest.raises(BusUnavailableError) as refused:
            both.supervisor.start("io memory")
        assert str(refused.value) == says
    else:
        both.supervisor.start("io memory")
    waited_s = both.now_s - 100.0
    assert waited_s == pytest.approx(60.0 if happens == "nothing" else 5.0, abs=0.03)
    told = made[0].told
    assert (told["target"], told["daemon"], told["name"]) == (process.supervise, True, "isocenter-supervisor")
    assert told["args"] == (SETTINGS, "udp:", both.supervisor.memory_name, "io memory", os.getpid(), 0, None, None)
    both.close()
    assert made[0].log == ["start", "join", "kill", "join"]


# ---- in lockstep


class InProcess:
    """The supervisor that is stepped by the frames, and what it sends."""

    def __init__(self) -> None:
        self.now_s, self.sent = 0.0, []
        self.supervisor = SupervisorInProcess(SETTINGS, lambda: self.now_s, lambda can_id, data: self.sent.append((can_id, data)))
        self.supervisor.begin()
        self.state = IoState(len(CARM.axes))
        self.state.hold_to_run = self.state.door_closed = True
        self.state.word = FIRST_WORD

    def tick(self, counts: int = 0, torque: int = 0) -> str:
        """Let the commands pass, a SYNC, and the answers: of drives that are enabled, and of encoders that agree with them."""
        self.now_s += PERIOD_S
        for node in SETTINGS.nodes:
            for pdo in node.rpdos:
                self._frame(pdo, {0x6071: torque})
        self.supervisor.heard += SETTINGS.sync_cob_id, b"", self.now_s
        self.supervisor.take()
        for node in SETTINGS.nodes:
            scaling = SETTINGS.scalings[CARM.axis_index(node.axis)]
            link = scaling.link_zero_counts + round(scaling.sign * counts * scaling.position_resolution / scaling.link_resolution)
            for pdo in node.tpdos:
                self._frame(pdo, {0x6041: 0x1637, 0x6064: counts, 0x6004: link})
        return self.supervisor.trouble()

    def _frame(self, pdo: Pdo, values: dict[int, int]) -> None:
        data = b"".join(values.get(index, 0).to_bytes(bits // 8, "little") for index, _, bits in pdo.entries)
        self.supervisor.heard += pdo.cob_id, data, self.now_s

    def refresh(self) -> int | None:
        return self.supervisor.refresh(self.state)


def test_in_lockstep_it_answers_the_io_until_it_takes_its_permission_back_and_then_stops_drives_that_move_on() -> None:
    machine = InProcess()
    for _ in range(50):
        assert machine.refresh() == following_word(FIRST_WORD)
        assert machine.tick() == ""
    trouble = machine.tick(torque=0x7FFF)
    assert trouble.startswith("the supervisor took its permission back: ")
    assert "a torque of 32767 per mille was asked for" in trouble
    assert machine.refresh() is None
    assert machine.sent == [], "the loop stops them"
    for k in range(round(3.0 / PERIOD_S)):
        machine.tick(counts=100 * k)
    drives = [node.node_id for node in SETTINGS.nodes if node.role == "drive"]
    assert machine.sent[: len(drives)] == [(0x000, bytes((0x02, node))) for node in drives]


def test_in_lockstep_what_was_heard_since_the_sync_counts_at_once() -> None:
    node = next(node for node in SETTINGS.nodes if node.rpdos)
    for ask in ("trouble", "refresh"):
        machine = InProcess()
        machine.tick()
        machine._frame(node.rpdos[0], {0x6071: 0x7FFF})
        assert "was asked for" in machine.supervisor.trouble() if ask == "trouble" else machine.refresh() is None


def test_in_lockstep_what_the_io_reports_counts() -> None:
    for pressed, closed in ((True, True), (True, False), (False, True)):
        machine = InProcess()
        machine.state.hold_to_run, machine.state.door_closed = pressed, closed
        for k in range(round(3.0 / PERIOD_S)):
            machine.refresh()
            trouble = machine.tick(counts=100 * k)
        assert ("after hold-to-run or the door asked for a stop" in trouble) is not (pressed and closed)


def test_in_lockstep_nothing_is_permitted_between_two_sessions_and_a_new_one_forgets() -> None:
    machine = InProcess()
    machine.refresh()
    machine.tick()
    machine.supervisor.end()
    assert machine.refresh() is None
    machine.supervisor.begin()
    assert machine.refresh() == following_word(FIRST_WORD)
    assert machine.tick() == ""
