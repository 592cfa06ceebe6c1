"""Ticks by another device's SYNC, frame by frame: which sample belongs to which tick when SYNCs are late, early, many or missing."""

from __future__ import annotations

import can
import numpy as np
import pytest
from one_tick import ALL, PERIOD_S, SYNC, Machine, Ticks, answer

from drivers.errors import BusTimeoutError

PRODUCER = {"sync_producer": "plc", "overrun_ticks": 8}


class Following(Ticks):
    """The clock of the wire, for ticks that others give."""

    def start_ticks(self, period_s: float) -> None:
        self.missed = 0

    noticed_late_s = 0.0  # by which it wakes up late when nothing has come

    def await_tick(self, comes, due_s: float, patience_s: float, shortly_before=None) -> bool:  # noqa: ANN001
        came = comes(max(0.0, due_s + patience_s - self.now()))
        self.wire.time_s += 0.0 if came else self.noticed_late_s
        return came

    def lose(self, ticks: int) -> None:
        self.missed += ticks


class Bench:
    """Two axes on a wire on which `plc` sends SYNC k at k periods."""

    def __init__(self, until: int = 40) -> None:
        self.machine = Machine(**PRODUCER)
        self.clock = Following(self.machine.wire)
        self.machine.clock = self.machine.network.clock = self.machine.cyclic._clock = self.machine.cyclic._foreign._clock = self.clock
        self.machine.cyclic.start_ticks()
        for k in range(1, until + 1):
            self.sync(k)

    def sync(self, k: float, counts: int | None = None) -> None:
        """SYNC at k periods, and all answers 0.1 ms later; the first axis shows k counts."""
        wire, now_s = self.machine.wire, self.machine.wire.time_s
        wire.bring((k * PERIOD_S - now_s, SYNC, b""))
        for _, can_id, data in [answer(0x181, int(k) if counts is None else counts), *ALL[1:]]:
            wire.bring((k * PERIOD_S - now_s + 1e-4, can_id, data))

    def tick(self) -> int:
        """Make one tick and return the counts that its sample shows."""
        sample = self.machine.tick()
        return round(float(sample.position[0]) / self.machine.cyclic.inputs[0].scaling.position_resolution)

    def silence(self, first: int, last: int) -> None:
        """Take these SYNCs off the wire, and their answers."""
        wire = self.machine.wire
        wire._due = [due for due in wire._due if not first * PERIOD_S <= due[0] < (last + 1) * PERIOD_S]


def test_each_sample_is_of_the_sync_that_was_awaited_and_nothing_but_commands_is_sent() -> None:
    bench = Bench()
    assert [bench.tick() for _ in range(20)] == list(range(1, 21))
    assert {can_id for can_id, _ in bench.machine.wire.log} == {0x201, 0x202}
    assert bench.clock.missed == 0


def test_after_a_pause_of_the_bench_the_newest_sync_counts_and_the_others_are_lost() -> None:
    bench = Bench()
    assert [bench.tick() for _ in range(3)] == [1, 2, 3]
    bench.machine.wire.time_s = 7.5 * PERIOD_S
    assert bench.tick() == 7
    assert bench.clock.missed == 3
    assert bench.machine.cyclic.late_frames == 3 * len(ALL)
    assert [bench.tick() for _ in range(3)] == [8, 9, 10]
    assert bench.clock.missed == 3


def test_a_pause_of_the_producer_loses_its_ticks() -> None:
    bench = Bench()
    bench.silence(5, 9)
    assert [bench.tick() for _ in range(6)] == [1, 2, 3, 4, 10, 11]
    assert bench.clock.missed == 5
    assert bench.machine.cyclic.remarks == ["plc (bus.sync_producer): 5 SYNCs did not come"]


def test_a_longer_pause_is_the_producers_loss_and_then_the_bench_sends_sync_and_follows_again_when_it_may() -> None:
    bench = Bench()
    bench.silence(5, 20)
    assert [bench.tick() for _ in range(4)] == [1, 2, 3, 4]
    with pytest.raises(BusTimeoutError, match=r"plc \(bus.sync_producer\): no SYNC for 0.036 s; timing.overrun_ticks bridges 8 ticks"):
        bench.tick()
    sent = len(bench.machine.wire.log)
    for _ in range(3):
        bench.machine.tick()
    assert [can_id for can_id, _ in bench.machine.wire.log[sent:]].count(SYNC) == 3


@pytest.mark.parametrize("late_s", [0.0, 2e-5, 1e-3])
@pytest.mark.parametrize("phase", [0.0, -0.01, -0.24, -0.5, 0.2, 0.4, 0.8])
def test_a_producer_that_comes_back_is_followed_at_once_and_accused_of_nothing(phase: float, late_s: float) -> None:
    bench = Bench(until=4)
    bench.clock.noticed_late_s = late_s
    for k in range(20, 60):
        bench.sync(k + phase, k)
    assert [bench.tick() for _ in range(4)] == [1, 2, 3, 4]
    with pytest.raises(BusTimeoutError, match="no SYNC"):
        bench.tick()
    while bench.machine.wire.time_s < (21 + phase) * PERIOD_S:
        bench.machine.tick()
    sent = len(bench.machine.wire.log)
    for _ in range(20):
        bench.machine.tick()
    assert SYNC not in [can_id for can_id, _ in bench.machine.wire.log[sent:]]
    assert bench.machine.wire.time_s == pytest.approx((41 + phase) * PERIOD_S, abs=2.0 * PERIOD_S)
    assert not bench.machine.network.intruder


def test_a_sync_of_the_bench_that_its_adapter_hands_back_is_nobody_elses() -> None:
    bench = Bench(until=4)
    wire, network = bench.machine.wire, bench.machine.network
    network._requests, network._echoes = 1, 1  # an adapter that echoes
    wire.usual = [can.Message(arbitration_id=SYNC, is_extended_id=False), *ALL]
    assert [bench.tick() for _ in range(4)] == [1, 2, 3, 4]
    with pytest.raises(BusTimeoutError, match="no SYNC"):
        bench.tick()
    before_s, sent = wire.time_s, len(wire.log)
    for _ in range(10):
        assert np.isfinite(bench.machine.tick().position).all()
    assert [can_id for can_id, _ in wire.log[sent:]].count(SYNC) == 10
    assert wire.time_s - before_s == pytest.approx(10 * PERIOD_S, abs=PERIOD_S)


def test_answers_to_the_next_sync_are_not_taken_for_answers_to_the_last() -> None:
    bench = Bench()
    assert [bench.tick() for _ in range(5)] == [1, 2, 3, 4, 5]
    wire = bench.machine.wire
    wire._due = [due for due in wire._due if due[1].arbitration_id != 0x182 or not 6 * PERIOD_S <= due[0] < 7 * PERIOD_S]
    bench.machine.cyclic._answer_timeout_s = 1.5 * PERIOD_S  # until after the next SYNC
    sample = bench.machine.tick()
    assert round(float(sample.position[0]) / bench.machine.cyclic.inputs[0].scaling.position_resolution) == 6
    assert not np.isfinite(sample.position[1])
    assert bench.tick() == 7


def test_syncs_between_those_of_the_producer_are_a_second_one_and_one_alone_is_not() -> None:
    bench = Bench()
    bench.sync(3.5, 100)
    for _ in range(8):
        bench.machine.tick()
    assert not bench.machine.network.intruder
    for k in (10.4, 14.4, 18.4):
        bench.sync(k, 100)
    for _ in range(20):
        bench.machine.tick()
    assert bench.machine.network.intruder.startswith("SYNC comes between those of plc: a second producer sends it on wire")


@pytest.mark.parametrize("drift", [-4e-3, 4e-3])
def test_a_producer_whose_clock_drifts_is_followed(drift: float) -> None:
    bench = Bench(until=0)
    for k in range(1, 401):
        bench.sync(k * (1.0 + drift), k)
    assert [bench.tick() for _ in range(400)] == list(range(1, 401))
    assert bench.clock.missed == 0
    assert not bench.machine.network.intruder


@pytest.mark.parametrize(("period", "words"), [(0.0, "nobody sends SYNC"), (1.024, "SYNC comes every 4.000 ms"), (0.5, "every 1.953 ms")])
def test_before_a_start_a_silent_producer_and_a_wrong_rate_are_refused(period: float, words: str) -> None:
    bench = Bench(until=0)
    for k in range(1, 300 if period else 1):
        bench.machine.wire.bring((k * period * PERIOD_S, SYNC, b""))
    with pytest.raises(BusTimeoutError, match=words):
        bench.machine.cyclic.check_sync()


def test_a_remote_frame_with_its_identifier_is_no_sync() -> None:
    bench = Bench()
    remote = can.Message(arbitration_id=SYNC, is_extended_id=False, is_remote_frame=True)
    bench.machine.wire.bring(remote)
    bench.machine.wire._due.insert(6, (PERIOD_S + 2e-4, remote))  # right behind the answers to the first SYNC, all of them read at once
    bench.machine.wire.time_s = 1.5 * PERIOD_S
    assert [bench.tick() for _ in range(3)] == [1, 2, 3]
    assert bench.machine.network.passed_over == {"remote frames": 2}
