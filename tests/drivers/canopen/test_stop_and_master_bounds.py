"""Several stops together, the service of a hold, and the count of frames that only one may send, step by step."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import pytest
from scripted_nodes import machine_settings

from drivers.canopen.axis_rest import AxisRest
from drivers.canopen.one_master import LATE_TICKS, OneMaster
from drivers.canopen.stopping import SAY_EVERY_S, Attempts, Stops, Unattended, in_words
from drivers.interface import Sample

HELD = AxisRest("roll", False, True, "held by its drive")
SAFE = AxisRest("roll", True, False, "at rest")


@dataclass
class Axis:
    """The stop of an axis that comes to an end after some steps."""

    axis: int = 1
    name: str = "roll"
    steps: int = 3
    end: AxisRest = SAFE
    orders_brake: bool = True
    orders_node: int = 0
    alarm: str = ""
    asks_for_torque: bool = False
    rest: AxisRest | None = None
    log: list[object] = field(default_factory=list)
    passed: list[int] = field(default_factory=list)

    def step(self, sample: Sample, *, io_is_fresh: bool, ticks: int) -> None:
        assert isinstance(sample, Sample)
        self.passed.append(ticks)
        self.log.append(io_is_fresh)
        self.steps -= 1
        if self.steps <= 0:
            self.rest = self.end

    def torque_mode(self, reached: bool) -> None:
        self.asks_for_torque = False
        self.log.append(("torque", reached))

    def close_again(self) -> None:
        self.log.append("close")
        self.orders_brake = True

    def release(self) -> None:
        self.log.append("release")
        self.end = replace(SAFE, axis=self.name)


class Served:
    """Stops, their clock of a second a tick, and an attendant."""

    def __init__(self, *axes: Axis) -> None:
        self.now_s, self.told, self.said, self.held_s = 100.0, [], [], []
        self.leaves_after_s, self.confirms_after_s = 1e9, 1e9
        self.fresh = True
        self.missed = 5
        self.commanded: list[tuple[int, int]] = []
        drives = lambda: self.fresh, lambda axis: axis == 1, lambda *command: self.commanded.append(command)
        self.stops = Stops(axes, self, Sample(2), self.tick, self.told.append, *drives)  # type: ignore[arg-type]

    def now(self) -> float:
        return self.now_s

    def tick(self) -> None:
        self.now_s += 1.0

    def say(self, text: str) -> None:
        self.said.append((self.now_s, text))

    def stays(self, held_s: float) -> bool:
        self.held_s.append(held_s)
        return held_s < self.leaves_after_s

    def released(self) -> list[str]:
        if self.now_s - 100.0 < self.confirms_after_s:
            return []
        self.confirms_after_s = 1e9  # a line is typed once
        return ["roll"]


def test_stops_go_on_until_the_last_has_ended_and_once_more_for_its_controlword() -> None:
    quick, slow = Axis(0, "propeller", 1), Axis(1, "roll", 4)
    served = Served(quick, slow)
    served.fresh = False
    served.stops.run()
    assert served.now_s == 100.0 + 4 + 1
    assert served.told == [["propeller", "roll"]], "once, and before the first tick"
    assert quick.log == slow.log == [False] * 4
    assert [rest.axis for rest in served.stops.rests] == ["roll", "roll"]
    assert served.stops.held == []


def test_a_brake_that_is_ordered_again_is_told_again_and_torque_is_asked_for() -> None:
    axis, other = Axis(1), Axis(0, "propeller", orders_brake=False)
    served = Served(axis, other)
    axis.orders_brake = False
    served.stops.step()
    assert served.told == []
    axis.orders_brake = axis.asks_for_torque = True
    other.asks_for_torque = True
    served.stops.step()
    assert served.told == [["roll"]]
    assert (axis.log[-1], other.log[-1]) == (("torque", True), ("torque", False))
    assert served.stops.rests == []


def test_a_drive_is_sent_once_what_its_stop_orders() -> None:
    axis, other = Axis(orders_node=0x81), Axis(axis=0, name="propeller")
    served = Served(axis, other)
    served.stops.run()
    assert served.commanded == [(1, 0x81)]
    assert axis.orders_node == 0


def test_lost_ticks_count_as_time_that_has_passed() -> None:
    axis = Axis(steps=9)
    served = Served(axis)
    served.stops.step()
    served.missed += 3
    served.stops.step()
    served.stops.step()
    assert axis.passed == [1, 4, 1]


def test_a_hold_is_reported_and_tried_again_every_five_seconds() -> None:
    axis = Axis(steps=1, end=HELD, orders_brake=False)
    served = Served(axis)
    served.stops.serve_hold(served)
    assert served.said == []
    served.stops.step()
    served.leaves_after_s = 12.0
    served.stops.serve_hold(served)
    assert served.said == [(101.0, "roll held by its drive"), (107.0, "roll held by its drive"), (112.0, "roll held by its drive")]
    assert axis.log.count("close") == 2
    assert served.held_s == [float(second) for second in range(13)]
    assert served.told == [["roll"], ["roll"]]
    assert SAY_EVERY_S == 5.0


def test_a_hold_ends_with_the_proof_or_by_an_operator_and_that_is_said_at_once() -> None:
    for how in ("released", "proven"):
        axis = Axis(steps=1, end=HELD)
        served = Served(axis, Axis(0, "propeller", 1, replace(SAFE, axis="propeller")))
        served.stops.step()
        served.confirms_after_s = 3.0 if how == "released" else 1e9
        if how == "proven":
            axis.end, axis.steps = SAFE, 3
        served.stops.serve_hold(served)
        assert [text for _, text in served.said] == ["roll held by its drive", "roll, propeller at rest"]
        assert ("release" in axis.log) is (how == "released")
        assert "close" not in axis.log


def test_what_was_confirmed_before_a_hold_releases_nothing() -> None:
    axis = Axis(steps=1, end=HELD)
    served = Served(axis)
    served.stops.step()
    confirmations = [["roll"]]  # as typed during another stop
    served.released = lambda: confirmations.pop() if confirmations else []  # type: ignore[method-assign]
    served.leaves_after_s = 3.0
    served.stops.serve_hold(served)
    assert "release" not in axis.log
    assert confirmations == []


def test_axes_with_the_same_end_are_told_together() -> None:
    assert in_words([SAFE, HELD, replace(SAFE, axis="propeller")]) == "roll, propeller at rest; roll held by its drive"
    assert in_words([]) == ""


def test_attempts_go_on_after_an_error_and_keep_it() -> None:
    attempts, made = Attempts(), []

    def fail(*_: object) -> None:
        raise ValueError("no")

    attempts.make("first", fail, 1)
    attempts.make("second", made.append, 2)
    assert (attempts.trouble, made) == (["first: no"], [2])


def test_without_an_attendant_a_hold_is_served_without_end() -> None:
    nobody = Unattended()
    nobody.say("a word")
    assert (nobody.stays(1e9), nobody.released()) == (True, ())


class Network:
    """What is accused, in words."""

    def __init__(self) -> None:
        self.can_bus = self
        self.channel_info = "a bus"
        self.echoes, self.heartbeats_sent = False, 0
        self.hears: dict[int, Callable[[int, bytearray, float], None]] = {}
        self.accused: list[str] = []

    def subscribe(self, can_id: int, callback: Callable[[int, bytearray, float], None]) -> None:
        self.hears[can_id] = callback

    def accuse(self, words: str) -> None:
        self.accused.append(words)

    def hear(self, can_id: int) -> int:
        self.hears[can_id](can_id, bytearray(), 0.0)
        return len(self.accused)


@pytest.fixture
def network() -> Network:
    return Network()


def master_of(network: Network, **changes: object) -> OneMaster:
    return OneMaster(network, replace(machine_settings(), **changes), ("a drive: TPDO 1", None))  # type: ignore[arg-type]


def test_without_an_echo_every_frame_of_the_benchs_own_is_somebody_elses(network: Network) -> None:
    master_of(network)
    assert sorted(network.hears) == [0x080, 0x201, 0x202, 0x77F]
    assert [network.hear(can_id) for can_id in sorted(network.hears)] == [1, 2, 3, 4]
    assert network.accused == [
        "a second SYNC producer sends 080h on a bus; switch it off",
        "somebody else sends 201h, the commands to propeller_drive, on a bus; switch it off",
        "somebody else sends 202h, the commands to roll_drive, on a bus; switch it off",
        "a second master sends the bench's own heartbeat, 77Fh, on a bus; switch it off",
    ]


def test_with_an_echo_as_many_are_heard_as_were_sent(network: Network) -> None:
    master = master_of(network)
    network.echoes, network.heartbeats_sent, master.tick = True, 1, 3
    assert [network.hear(0x080) for _ in range(4)] == [0, 0, 0, 1]
    assert [network.hear(0x77F) for _ in range(2)] == [1, 2]


def test_with_an_echo_what_is_heard_before_anything_was_sent_is_somebody_elses(network: Network) -> None:
    master_of(network)
    network.echoes = True
    assert [network.hear(0x080), network.hear(0x77F)] == [1, 2]


def extras(master: OneMaster, network: Network, ticks: list[int], bit: int = 0) -> list[int]:
    """How many were accused after a frame too many in each of these ticks."""
    found = []
    for master.tick in ticks:
        master.extra(bit)
        found.append(len(network.accused))
    return found


def test_four_ticks_with_a_frame_too_many_name_a_second_sender(network: Network) -> None:
    master = master_of(network)
    assert extras(master, network, [5, 6, 7, 8]) == [0, 0, 0, 1]
    assert network.accused == ["a drive: TPDO 1 comes more than once per SYNC: a second device sends it on a bus; switch it off"]
    assert extras(master, network, list(range(10, 20)), bit=1) == [1] * 10, "what does not answer every SYNC"


def test_frames_of_one_tick_count_once_and_far_apart_not_together() -> None:
    for ticks, last in (
        ([5, 5, 5, 5, 6, 7], 0),
        ([5, 5, 6, 7, 8], 1),
        ([0, LATE_TICKS, 2 * LATE_TICKS, 3 * LATE_TICKS], 1),
        ([LATE_TICKS, LATE_TICKS + 1, LATE_TICKS + 2, LATE_TICKS + 3], 1),
        ([5, 6, 7, 8 + LATE_TICKS], 0),
        ([5, 6, 7, 8 + LATE_TICKS, 9 + LATE_TICKS, 10 + LATE_TICKS], 0),
        ([5, 6, 7, 8 + LATE_TICKS, 9 + LATE_TICKS, 10 + LATE_TICKS, 11 + LATE_TICKS], 1),
    ):
        network = Network()
        assert extras(master_of(network), network, ticks)[-1] == last, ticks


def test_a_frame_that_answers_what_was_missed_is_none_too_many() -> None:
    for late, first in ((1, 0), (LATE_TICKS, 0), (LATE_TICKS + 1, 1)):
        network = Network()
        master = master_of(network)
        master.tick = 10
        master.missed(0)
        begin = 10 + late
        assert extras(master, network, [begin, begin + 1, begin + 2, begin + 3])[-1] == first, late
        assert extras(master, network, [begin + 4])[-1] == first + 1
    network = Network()
    master = master_of(network)
    assert extras(master, network, [5, 6, 7]) == [0, 0, 0]
    master.tick = 8
    master.missed(0)
    assert extras(master, network, [9, 10]) == [0, 1], "the first was owed"


def test_a_flood_is_one_of_four_ticks_in_a_row(network: Network) -> None:
    master = master_of(network)
    assert master.flood_frames == 17  # half of 1 Mbit/s over 111 bits, 256 times a second
    assert master_of(network, bitrate_bit_s=125_000).flood_frames == 8
    for tick in (1, 2, 3, 5, 6, 7, 9):
        master.tick = tick
        master.flooded(30, 0x3A5)
    assert network.accused == []
    for master.tick in (10, 11):
        master.flooded(30, 0x3A5)
    assert network.accused == []
    begins = Network()
    early = master_of(begins)
    for early.tick in (2, 3, 4):
        early.flooded(30, 0x3A5)
    assert begins.accused == [], "nor is one at the very beginning taken for longer than it is"
    master.tick = 12
    master.flooded(31, 0x3A6)
    assert network.accused == [
        "31 frames in one period that nobody here asked for, the last with the identifier 3A6h, 17 are bearable: "
        "somebody floods the bus on a bus; switch it off"
    ]


def test_an_operator_releases_the_axes_that_are_named_and_no_other() -> None:
    roll, propeller = Axis(steps=1, end=HELD), Axis(0, "propeller", 1, replace(HELD, axis="propeller"))
    served = Served(roll, propeller)
    served.stops.step()
    served.confirms_after_s, served.leaves_after_s = 3.0, 6.0
    served.stops.serve_hold(served)
    assert "release" in roll.log
    assert "release" not in propeller.log


def test_what_must_be_told_at_once_is_told_once_and_no_terminal_that_is_gone_keeps_a_stop_from_going_on() -> None:
    axis = Axis(steps=5, alarm="its drive does not hold it")
    served, told = Served(axis), []
    served.stops.alarm = told.append
    served.stops.run()
    assert told == ["KEEP AWAY, PRESS THE EMERGENCY STOP: roll: its drive does not hold it"]
    gone = Axis(steps=5, alarm="its drive does not hold it")
    silent = Served(gone)

    def fail(text: str) -> None:
        raise OSError("no terminal")

    silent.stops.alarm = fail
    silent.stops.run()
    assert (gone.rest, gone.alarm) == (SAFE, "")


def test_keep_away_stands_first_where_an_axis_may_move() -> None:
    moves = replace(SAFE, axis="propeller", safe=False, words="not proven at rest: IT MOVES", may_move=True)
    assert in_words([SAFE, moves]) == "KEEP AWAY, PRESS THE EMERGENCY STOP: roll at rest; propeller not proven at rest: IT MOVES"
    assert in_words([SAFE]) == "roll at rest"
