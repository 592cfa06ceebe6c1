"""The two clocks: absolute ticks that never come in a burst, and virtual time that passes only when it is told to."""

from __future__ import annotations

import pytest

from hil.bench.clock import MORE_S, LockstepClock, WallClock

PERIOD_S = 1 / 256
SPUN_s = 400e-6  # before a tick: five times the latest wake-up measured under SCHED_FIFO (84 us), a tenth of a period


class Watch:
    """Stands in for the module `time`: sleeping takes exactly as long as asked, plus what `oversleep_s` says; looking takes 1 us."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now_s, self.oversleep_s = 1000.0, 0.0
        self.slept: list[float] = []
        monkeypatch.setattr("hil.bench.clock.time", self)

    def perf_counter(self) -> float:
        self.now_s += 1e-6
        return self.now_s

    def sleep(self, seconds: float) -> None:
        assert seconds >= 0.0
        self.slept.append(seconds)
        self.now_s += seconds + self.oversleep_s
        self.oversleep_s = 0.0

    def work(self, seconds: float) -> None:
        self.now_s += seconds


@pytest.fixture
def watch(monkeypatch: pytest.MonkeyPatch) -> Watch:
    return Watch(monkeypatch)


def ticking(watch: Watch) -> tuple[WallClock, float]:
    clock = WallClock()
    clock.start_ticks(PERIOD_S)
    return clock, watch.now_s


def test_ticks_are_at_absolute_times_so_that_work_does_not_shift_them(watch: Watch) -> None:
    clock, start_s = ticking(watch)
    for k in range(1, 2001):
        assert clock.wait_tick() == pytest.approx(0.0, abs=2e-6)
        assert watch.now_s == pytest.approx(start_s + k * PERIOD_S, abs=2e-6)  # the last like the first: nothing adds up
        watch.work((k * 7 % 30) * 1e-4)  # up to 2.9 ms of 3.9
    assert clock.missed == 0


def test_it_sleeps_most_of_the_time_and_spins_the_last_stretch(watch: Watch) -> None:
    clock, _ = ticking(watch)
    clock.wait_tick()
    assert watch.slept == [pytest.approx(PERIOD_S - SPUN_s, abs=5e-6)]


def test_a_rehearsal_is_between_sleep_and_tick_and_none_is_held_when_the_tick_is_due(watch: Watch) -> None:
    clock, start_s = ticking(watch)
    held: list[float] = []
    clock.rehearsals.append(lambda: held.append((watch.now_s - start_s) / PERIOD_S))
    clock.wait_tick()
    assert held == [pytest.approx(1.0 - SPUN_s / PERIOD_S, abs=0.01)]
    watch.work(1.5 * PERIOD_S)
    clock.wait_tick()
    assert len(held) == 1


def test_it_wakes_sooner_where_more_is_to_be_rehearsed(watch: Watch) -> None:
    clock, _ = ticking(watch)
    clock.has_more_to_rehearse = lambda: len(watch.slept) == 1
    for _ in range(3):
        clock.wait_tick()
    assert watch.slept == [pytest.approx(PERIOD_S - SPUN_s - more_s, abs=5e-6) for more_s in (0.0, MORE_S, 0.0)]


def test_a_tick_that_is_a_little_late_is_served_at_once_says_so_and_the_next_is_on_time(watch: Watch) -> None:
    clock, start_s = ticking(watch)
    clock.wait_tick()
    watch.work(1.5 * PERIOD_S)
    assert clock.wait_tick() == pytest.approx(0.5 * PERIOD_S, abs=5e-6)
    assert clock.missed == 0
    assert clock.wait_tick() == pytest.approx(0.0, abs=2e-6)
    assert watch.now_s == pytest.approx(start_s + 3 * PERIOD_S, abs=5e-6)


@pytest.mark.parametrize("periods", [2.25, 3.5, 40.75])
def test_ticks_whose_time_has_gone_by_are_skipped_counted_and_never_come_in_a_burst(watch: Watch, periods: float) -> None:
    clock, start_s = ticking(watch)
    clock.wait_tick()
    watch.work(periods * PERIOD_S)
    moments, lateness = [], []
    for _ in range(5):
        lateness.append(clock.wait_tick())
        moments.append((watch.now_s - start_s) / PERIOD_S)
    assert clock.missed == int(periods) - 1
    assert lateness == pytest.approx([periods % 1 * PERIOD_S, 0, 0, 0, 0], abs=1e-5)  # against the tick that is served, not a skipped one
    assert moments[0] == pytest.approx(1 + periods, abs=0.01)  # at once
    assert moments[1:] == pytest.approx([int(periods) + 2 + n for n in range(4)], abs=0.01)  # one per period from then on


def test_a_tick_overslept_by_the_system_is_late_and_what_it_cost_is_counted(watch: Watch) -> None:
    clock, _ = ticking(watch)
    watch.oversleep_s = 4.5 * PERIOD_S
    assert clock.wait_tick() == pytest.approx(4.5 * PERIOD_S - SPUN_s, abs=1e-5)
    clock.wait_tick()
    assert clock.missed == 3  # ticks 2, 3 and 4; the fifth is served, late


def test_starting_anew_forgets_what_was_missed(watch: Watch) -> None:
    clock, _ = ticking(watch)
    watch.work(10.5 * PERIOD_S)
    clock.wait_tick()
    assert clock.missed == 9
    clock.start_ticks(PERIOD_S)
    assert clock.missed == 0
    assert clock.wait_tick() == pytest.approx(0.0, abs=2e-6)


def test_work_can_be_told_from_waiting_by_the_two_time_stamps(watch: Watch) -> None:
    clock, _ = ticking(watch)
    clock.wait_tick()
    watch.work(1e-3)
    clock.wait_tick()
    assert clock.tick_began_s - clock.idle_began_s == pytest.approx(PERIOD_S - 1e-3, abs=5e-6)


def test_waiting_is_sleeping(watch: Watch) -> None:
    WallClock().wait(0.125)
    assert watch.slept == [0.125]


def test_in_lockstep_time_is_the_machines_and_passes_only_when_somebody_waits() -> None:
    machine = {"time_s": 5.0}

    def advance(seconds: float) -> None:
        machine["time_s"] += seconds

    clock = LockstepClock(advance, lambda: machine["time_s"])
    clock.start_ticks(PERIOD_S)
    assert [clock.wait_tick() for _ in range(1000)] == [0.0] * 1000
    assert clock.now() == 5.0
    assert clock.missed == 0
    clock.wait(2.5)
    assert clock.now() == 7.5


def test_a_clock_that_waits_loses_no_tick_and_shifts_the_later_ones(watch: Watch) -> None:
    clock = WallClock(waits=True)
    clock.start_ticks(PERIOD_S)
    start_s = watch.now_s
    clock.wait_tick()
    watch.work(3.4 * PERIOD_S)  # ticks 2, 3 and 4 are past when the loop comes back
    before_s = clock.now()
    lateness_s = clock.wait_tick()
    assert lateness_s == pytest.approx(0.4 * PERIOD_S, abs=1e-5)
    assert clock.now() == pytest.approx(before_s - 2 * PERIOD_S, abs=1e-5), "what was waited for is nobody's silence"
    clock.wait_tick()
    assert watch.now_s == pytest.approx(start_s + 5 * PERIOD_S, abs=1e-5)
    assert clock.missed == 0


class Sender:
    """Gives a tick at its time; waiting for it takes until then, or the whole time-out."""

    def __init__(self, watch: Watch, at_s: float) -> None:
        self.watch, self.at_s, self.asleep_s = watch, at_s, 0.0

    def comes(self, timeout_s: float) -> bool:
        waits_s = min(timeout_s, max(0.0, self.at_s - self.watch.now_s))
        self.watch.now_s += waits_s
        self.asleep_s += waits_s
        return self.watch.now_s >= self.at_s


def test_a_tick_of_others_is_awaited_asleep_until_shortly_before_it_is_due_and_then_awake(watch: Watch) -> None:
    clock, start_s = ticking(watch)
    clock.awake_s = 1e-3
    held: list[float] = []
    clock.rehearsals.append(lambda: held.append(watch.now_s - start_s))
    sender = Sender(watch, start_s + PERIOD_S + 1e-4)
    assert clock.await_tick(sender.comes, start_s + PERIOD_S, 8 * PERIOD_S)
    assert clock.tick_began_s == pytest.approx(start_s + PERIOD_S + 1e-4, abs=5e-6)
    assert sender.asleep_s == pytest.approx(PERIOD_S - SPUN_s, abs=5e-6)
    assert held == [pytest.approx(PERIOD_S - SPUN_s, abs=5e-6)]


def test_a_tick_of_others_that_is_late_is_awaited_asleep_and_one_that_stays_away_is_told(watch: Watch) -> None:
    clock, start_s = ticking(watch)
    late = Sender(watch, start_s + 5 * PERIOD_S)
    assert clock.await_tick(late.comes, start_s + PERIOD_S, 8 * PERIOD_S)
    assert not clock.await_tick(Sender(watch, float("inf")).comes, watch.now_s + PERIOD_S, 8 * PERIOD_S)
    assert watch.now_s == pytest.approx(start_s + 14 * PERIOD_S, abs=5e-5)
    clock.lose(3)
    assert clock.missed == 3
