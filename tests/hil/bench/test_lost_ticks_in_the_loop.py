"""Ticks that the loop loses: bridged up to a limit, never unseen, and time and plan go on meanwhile."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from bench_machines import CARM
from scripted_bench import PERIOD_S, Rows, ScriptedClock, ScriptedLink, column, proportional_loop, still

from drivers.interface import Sample
from hil.bench.open import open_bench
from hil.bench.options import BenchOptions
from hil.errors import LoopAbortedError


def _released(link: ScriptedLink) -> None:
    link.sample.hold_to_run = False


def _outside(link: ScriptedLink) -> None:
    link.sample.position[1] = 1.01


def test_lost_ticks_up_to_the_limit_are_counted_and_the_run_goes_on() -> None:
    def lose(link: ScriptedLink) -> None:
        link.clock.missed += 8

    clock = ScriptedClock()
    clock.missed = 100  # of a run before: not ours
    timing = proportional_loop(ScriptedLink(clock, {3: lose, 4: lose})).run(still(30))
    assert timing.missed == timing.summary()["missed"] == 16


def _stall(ticks: int, also: Callable[..., object] | None = None) -> Callable[..., object]:
    def script(link: ScriptedLink) -> None:
        link.clock.missed += ticks
        if also is not None:
            also(link)

    return script


@pytest.mark.parametrize(
    ("event", "says"),
    [
        (_stall(9), "lost 9 ticks in a row"),
        (_stall(3, _released), "hold-to-run was released"),
        (_stall(3, _outside), "position 1.0100 rad"),
    ],
    ids=["overrun", "hold-to-run", "limit"],
)
def test_what_happens_while_the_last_ticks_of_a_plan_are_lost_stops_the_motors(event: Callable[..., object], says: str) -> None:
    link, sink = ScriptedLink(ScriptedClock(), {18: event}), Rows()
    with pytest.raises(LoopAbortedError, match=says) as caught:
        proportional_loop(link).run(still(20), sink)
    assert "after row 17" in str(caught.value)
    assert "18 rows are kept" in str(caught.value)
    assert link.stops >= 1


@pytest.mark.parametrize("ticks", [2, 3])
def test_the_last_ticks_of_a_plan_may_be_lost(ticks: int) -> None:
    """The machine stands where the plan ends, far from where it was a tick before."""
    plan = still(20)
    plan.reference[-1] = 0.9

    def arrive(link: ScriptedLink) -> None:
        link.sample.position[:] = 0.9

    link, sink = ScriptedLink(ScriptedClock(), {18: _stall(ticks, arrive)}), Rows()
    timing = proportional_loop(link).run(plan, sink)
    assert timing.ticks == len(sink.rows) == 18
    assert link.stops == 0


def test_time_and_plan_go_on_while_ticks_are_lost() -> None:
    """Row of tick n: its time is n / f_s and its reference the plan's at n, so a period stays a period on the wall."""

    def lose(ticks: int) -> Callable[..., object]:
        def script(link: ScriptedLink) -> None:
            link.clock.missed += ticks

        return script

    clock = ScriptedClock()
    clock.missed = 100
    plan, sink = still(12), Rows()
    plan.reference[:, 0] = 1e-3 * np.arange(12)
    timing = proportional_loop(ScriptedLink(clock, {0: lose(5), 3: lose(2), 6: lose(1)})).run(plan, sink)
    rows = np.array(sink.rows)
    ticks = [0, 1, 2, 5, 6, 7, 9, 10, 11]
    assert rows[:, 0] == pytest.approx(np.array(ticks) * PERIOD_S)
    assert rows[:, column("reference_propeller")] == pytest.approx(1e-3 * np.array(ticks))
    assert timing.ticks == len(ticks)
    assert timing.missed == 8


def _nobody_answers(link: ScriptedLink) -> None:
    link.sample.unanswered = 1
    link.sample.position[:] = link.sample.link_position[:] = np.nan
    link.sample.statusword[:] = -1


def _roll_is_silent(link: ScriptedLink) -> None:
    link.sample.position[1] = np.nan


def test_a_tick_that_nobody_answers_is_no_axis_s_silence() -> None:
    """Eight in a row, twice as many as an axis may be silent: the run goes on, says how many, and its rows have no positions there."""
    link, sink = ScriptedLink(ScriptedClock(), dict.fromkeys(range(3, 11), _nobody_answers)), Rows()
    timing = proportional_loop(link).run(still(20), sink)
    assert link.stops == 0
    assert timing.ticks == 20
    assert timing.unanswered == timing.summary()["unanswered"] == 8
    position = np.array(sink.rows)[:, column("position_roll")]
    assert np.flatnonzero(np.isnan(position)).tolist() == list(range(3, 11))


def _roll_is_late(link: ScriptedLink) -> None:
    _roll_is_silent(link)
    link.sample.position_late[1] = True


def test_an_axis_whose_answers_come_late_is_not_silent_and_the_command_stays_meanwhile() -> None:
    def away(link: ScriptedLink) -> None:
        link.sample.position[0] = 1e-3 * len(link.commands)

    def away_and_late(link: ScriptedLink) -> None:
        away(link)
        _roll_is_late(link)

    script = {2: away, 3: away} | dict.fromkeys(range(4, 12), away_and_late) | {12: away}
    link, sink = ScriptedLink(ScriptedClock(), script), Rows()
    timing = proportional_loop(link).run(still(20), sink)
    assert (timing.ticks, timing.unanswered, link.stops) == (20, 8, 0)
    command = np.array(sink.rows)[:, column("command_propeller")]
    assert command[4:12] == pytest.approx(command[3])
    assert command[12] != pytest.approx(command[3])


def test_one_that_falls_silent_after_it_was_late_is_found() -> None:
    script = dict.fromkeys((4, 5), _roll_is_late) | dict.fromkeys((6, 7, 8), _roll_is_silent)
    with pytest.raises(LoopAbortedError, match="row 8: roll: no position for 4 ticks"):
        proportional_loop(ScriptedLink(ScriptedClock(), script)).run(still(20), Rows())


def test_an_axis_that_is_silent_while_others_answer_is_found_between_ticks_that_nobody_answers() -> None:
    silent, nobody = dict.fromkeys((4, 6, 7, 9), _roll_is_silent), dict.fromkeys((5, 8), _nobody_answers)
    link, sink = ScriptedLink(ScriptedClock(), silent | nobody), Rows()
    with pytest.raises(LoopAbortedError, match="row 9: roll: no position for 4 ticks"):
        proportional_loop(link).run(still(20), sink)
    assert link.stops >= 1


def test_sensors_are_judged_when_they_answer_and_over_all_the_time_since(monkeypatch: pytest.MonkeyPatch) -> None:
    loop = proportional_loop(ScriptedLink(ScriptedClock(), dict.fromkeys((3, 4), _nobody_answers)))
    assert loop.judge is not None
    judged: list[int] = []
    monkeypatch.setattr(loop.judge, "step", lambda sample, ticks, time_s: (judged.append(ticks), "")[1])
    loop.run(still(8))
    assert judged == [1, 1, 1, 3, 1, 1]


def test_judges_are_told_no_less_than_a_tick_where_the_clock_begins_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    """In ticks that the link makes by itself; after SDO traffic the clock starts again, and has lost nothing since."""
    told: list[int] = []

    def step(sample: Sample, ticks: int, time_s: float, *, led: bool) -> str:
        told.append(ticks)
        return ""

    with open_bench(CARM, BenchOptions("lockstep:"), np.zeros(2)) as bench:
        link, clock = bench.wiring.link, bench.wiring.clock
        assert bench.loop.judge is not None
        monkeypatch.setattr(bench.loop.judge, "step", step)
        for missed in (5, 5, 0, 2):
            monkeypatch.setattr(clock, "missed", missed)
            assert link.judged(link.sample) == ""
    assert told == [6, 1, 1, 3]


@pytest.mark.parametrize(("lateness_s", "lost", "says"), [(0.21, 0, "0.21"), (0.003, 50, "0.20")], ids=["asleep", "within a tick"])
@pytest.mark.parametrize("row", [3, 18], ids=["amid", "last"])
def test_a_loop_that_stood_still_before_a_limit_was_passed_says_so_first(lateness_s: float, lost: int, says: str, row: int) -> None:
    def late(link: ScriptedLink) -> None:
        link.sample.lateness_s, link.clock.missed = lateness_s, link.clock.missed + lost
        _outside(link)

    with pytest.raises(LoopAbortedError, match=rf"this program stood still for {says} s; roll: position 1\.0100 rad"):
        proportional_loop(ScriptedLink(ScriptedClock(), {row: late})).run(still(20))


def test_one_that_was_late_by_less_is_not_accused() -> None:
    def late(link: ScriptedLink) -> None:
        link.sample.lateness_s = 0.004
        _outside(link)

    loop = proportional_loop(ScriptedLink(ScriptedClock(), {3: late}))
    loop.overrun_ticks = 0
    with pytest.raises(LoopAbortedError) as caught:
        loop.run(still(20))
    assert "stood still" not in str(caught.value)
