"""The sample loop at its bounds, who goes first where several things are wrong, and what is told of a run that ended."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from scripted_bench import AXES, PERIOD_S, Rows, ScriptedClock, ScriptedLink, Signals, column, proportional_loop, still

from drivers.events import Events
from drivers.interface import Sample
from drivers.judging.judge import SensorJudge
from drivers.judging.settings import DriveJudging, JudgingSettings
from hil.bench import loop as loop_module
from hil.bench.loop import SampleLoop
from hil.bench.row_layout import AxisColumns, RowLayout
from hil.errors import LoopAbortedError

Script = Callable[[ScriptedLink], object]


def sets(**values: object) -> Script:
    """A script that sets values of the sample; a pair `(axis, value)` sets an axis's."""

    def script(link: ScriptedLink) -> None:
        for name, value in values.items():
            if isinstance(value, tuple):
                getattr(link.sample, name)[value[0]] = value[1]
            else:
                setattr(link.sample, name, value)

    return script


def both(*scripts: Script) -> Script:
    return lambda link: [script(link) for script in scripts]


def lost(ticks: int) -> Script:
    return lambda link: setattr(link.clock, "missed", link.clock.missed + ticks)


def ended_by(script: dict[int, Script], change: Callable[[SampleLoop], object] = lambda loop: None, rows: int = 20) -> str:
    """Why a run ends; '' when it does not."""
    link = ScriptedLink(ScriptedClock(), script)
    link.sample.brakes_open[:] = True
    loop = proportional_loop(link)
    loop.braked = (True, True)
    change(loop)
    try:
        loop.run(still(rows), Rows())
    except LoopAbortedError as error:
        assert link.stops == 1
        return str(error).partition("; the motors")[0]
    assert link.stops == 0
    return ""


# ---- bounds


@pytest.mark.parametrize("way", [1.0, -1.0])
def test_an_axis_may_stand_at_its_limit_and_be_as_far_behind_as_is_allowed(way: float) -> None:
    def no_tracking(loop: SampleLoop) -> None:
        loop.limits = [type(limit)(limit.axis, -1.0, 1.0, 1.0, 1.0, 1.0, 9.0) for limit in loop.limits]
        loop.__post_init__()

    assert ended_by({5: sets(position=(1, way))}, no_tracking) == ""
    beyond = math.nextafter(way, 2.0 * way)
    assert ended_by({5: sets(position=(1, beyond))}, no_tracking) == f"row 5: roll: position {way:.4f} rad is outside -1.0000 to 1.0000 rad"
    assert ended_by({5: sets(position=(0, way * 0.5))}) == ""
    assert ended_by({5: sets(position=(0, math.nextafter(way * 0.5, way)))}) == (
        "row 5: propeller: tracking error 0.5000 rad exceeds 0.5000 rad"
    )


def test_an_infinite_position_is_outside_and_an_io_state_may_be_as_old_as_is_allowed() -> None:
    assert ended_by({5: sets(position=(1, math.inf))}).startswith("row 5: roll: position inf rad is outside")
    assert ended_by({5: sets(io_age_s=0.5)}) == ""


def test_a_brake_that_reports_closed_ends_the_run_where_the_axis_has_one() -> None:
    closed = sets(brakes_open=(1, False))
    assert ended_by({5: closed}) == "row 5: roll: its brake reports closed during the run"
    assert ended_by({5: closed}, lambda loop: setattr(loop, "braked", (True, False))) == ""
    assert ended_by({5: closed}, lambda loop: setattr(loop, "braked", ())) == ""
    assert ended_by({5: closed}, lambda loop: setattr(loop, "guard_io", False)) == ""


def test_the_links_own_watch_ends_the_run_with_its_words() -> None:
    def watched(loop: SampleLoop) -> None:
        loop.watch = lambda sample: "roll: moves with its brake closed" if sample.link_position[1] > 0.1 else ""

    assert ended_by({}, watched) == ""
    assert ended_by({5: sets(link_position=(1, 0.2))}, watched) == "row 5: roll: moves with its brake closed"


def test_the_last_position_is_not_judged_while_nobody_answers() -> None:
    """The reference goes on meanwhile, away from where the axis was seen last; the first answer after it is judged."""
    plan = still(20)
    plan.reference[6:9] = 0.6
    link = ScriptedLink(ScriptedClock(), dict.fromkeys((6, 7, 8), both(sets(unanswered=1), sets(position=(0, np.nan)))))
    assert proportional_loop(link).run(plan).ticks == 20
    link = ScriptedLink(ScriptedClock(), dict.fromkeys((6, 7), both(sets(unanswered=1), sets(position=(0, np.nan)))))
    with pytest.raises(LoopAbortedError, match="propeller: tracking error"):
        proportional_loop(link).run(plan)
    assert len(link.commands) == 9


def test_a_position_that_is_missing_from_the_first_row_on_is_bridged_as_long_as_any_other() -> None:
    gone = sets(position=(0, np.nan))
    assert ended_by(dict.fromkeys(range(3), gone)) == ""
    assert ended_by(dict.fromkeys(range(4), gone)) == "row 3: propeller: no position for 4 ticks, timing.stale_ticks bridges 3"


def test_an_axis_whose_position_is_not_known_yet_hides_none_behind_it() -> None:
    assert ended_by({0: both(sets(position=(0, np.nan)), sets(position=(1, 1.01)))}).startswith("row 0: roll: position 1.0100")


def test_a_plan_of_other_axes_is_refused() -> None:
    plan = still(4)
    plan.reference = np.zeros((4, 3))
    with pytest.raises(ValueError, match="longer"):
        proportional_loop(ScriptedLink(ScriptedClock())).run(plan)


@pytest.mark.parametrize("signal", ["reference_raw", "excitation", "feedforward"])
def test_a_plan_whose_signals_end_at_different_rows_is_refused(signal: str) -> None:
    plan = still(4)
    setattr(plan, signal, np.zeros((3, 2)))
    with pytest.raises(ValueError, match="a plan of 4 rows with a signal of 3"):
        proportional_loop(ScriptedLink(ScriptedClock())).run(plan)


# ---- order


def test_what_is_told_first_where_several_things_are_wrong() -> None:
    """Each is the reason as soon as all before it are left out."""

    def warns(link: ScriptedLink) -> None:
        link.sample.statusword[1] |= 0x80

    reasons: list[tuple[Script, str]] = [
        (sets(fault="roll_drive (node 2): EMCY 2310h"), "roll_drive (node 2): EMCY 2310h"),
        (sets(position=(0, 1.01)), "propeller: position"),
        (sets(position=(1, 0.6)), "roll: tracking error"),
        (sets(link_position=(1, 0.2)), "the watch"),
        (sets(io_age_s=0.6), "the I/O has given no valid state"),
        (sets(hold_to_run=False), "hold-to-run was released"),
        (sets(brakes_open=(1, False)), "roll: its brake reports closed"),
        (sets(door_closed=False), "the door was opened"),
        (warns, "drive_roll: its drive warns"),
        (lost(9), "the loop lost 9 ticks in a row"),
    ]

    def watched(loop: SampleLoop) -> None:
        loop.watch = lambda sample: "the watch" if sample.link_position[1] > 0.1 else ""

    for first, (_, says) in enumerate(reasons):
        ended = ended_by({5: both(*(script for script, _ in reasons[first:]))}, watched)
        assert ended.startswith(f"row 5: {says}")
        asked = ended_by(
            {5: both(*(script for script, _ in reasons[first:]))},
            lambda loop: (watched(loop), loop.stop_request.ask("asked to stop by SIGINT")),
        )
        assert asked == "row 0: asked to stop by SIGINT"


def test_after_a_plans_end_a_stop_request_goes_first_too() -> None:
    def ask(loop: SampleLoop) -> None:
        loop.link.script[18] = both(lost(12), sets(hold_to_run=False), lambda link: loop.stop_request.ask("asked"))

    assert ended_by({}, ask) == "after row 17: asked"
    assert ended_by({18: both(lost(12), sets(hold_to_run=False))}) == "after row 17: hold-to-run was released"
    assert ended_by({18: lost(8)}) == ""


# ---- what is told


def test_the_audit_trail_says_who_asked_for_a_stop_and_why() -> None:
    for reason, who in (("asked to stop by SIGINT", "operator"), ("the door was opened", "loop")):
        link = ScriptedLink(ScriptedClock(), {5: sets(door_closed=False)} if who == "loop" else {})
        loop = proportional_loop(link)
        loop.events = Events(lambda: 0.0)
        if who == "operator":
            loop.stop_request.ask(reason)
        with pytest.raises(LoopAbortedError):
            loop.run(still(20))
        assert [(event.who, event.what, dict(event.details)) for event in loop.events.all()] == [(who, "stop asked", {"reason": reason})]


def marking(loop: SampleLoop, *, follows: str = "mark") -> None:
    drives = [DriveJudging(f"drive_{axis}", k, "A", follows, 0.5, 2, 3) for k, axis in enumerate(AXES)]
    loop.judge = SensorJudge(JudgingSettings(drives=tuple(drives)), PERIOD_S)


def _roll_warns(link: ScriptedLink) -> None:
    link.sample.statusword[1] |= 0x80


def test_sensors_that_were_not_to_be_believed_are_marked_in_their_rows_and_told_at_the_end() -> None:
    link, sink = ScriptedLink(ScriptedClock(), dict.fromkeys((5, 6, 9), _roll_warns)), Rows()
    loop = proportional_loop(link)
    marking(loop)
    timing = loop.run(still(20), sink)
    marks = np.array(sink.rows)[:, column("sensor_marks")]
    assert {k: mark for k, mark in enumerate(marks.tolist()) if mark} == {5: 2.0, 6: 2.0, 9: 2.0}
    assert timing.judged == (f"drive_roll: its drive warns (statusword 16B7h) (from {5 * PERIOD_S:.3f} s on; 3 of 20 rows are marked)",)
    link.script, link.commands = {}, []
    assert loop.run(still(20)).judged == (), "what was found in the run before is not this one's"


def test_a_run_without_a_judge_has_no_marks_and_tells_of_no_sensor() -> None:
    link, sink = ScriptedLink(ScriptedClock(), {5: _roll_warns}), Rows()
    loop = proportional_loop(link)
    loop.judge = None
    assert loop.run(still(20), sink).judged == ()
    assert not np.array(sink.rows)[:, column("sensor_marks")].any()
    link.script, link.commands = {5: sets(door_closed=False)}, []
    with pytest.raises(LoopAbortedError, match="the door was opened") as caught:
        loop.run(still(20))
    assert not hasattr(caught.value, "__notes__")


def test_an_end_names_what_else_was_found_of_the_sensors() -> None:
    link = ScriptedLink(ScriptedClock(), {5: _roll_warns, 7: sets(door_closed=False)})
    loop = proportional_loop(link)
    marking(loop)
    with pytest.raises(LoopAbortedError, match=r"^row 7: the door was opened") as caught:
        loop.run(still(20), Rows())
    assert caught.value.__notes__ == [f"from {5 * PERIOD_S:.3f} s on, drive_roll: its drive warns (statusword 16B7h)"]
    marking(loop, follows="stop")
    link.script, link.commands, link.sample.door_closed = {5: _roll_warns}, [], True
    with pytest.raises(LoopAbortedError, match=r"^row 5: drive_roll: its drive warns") as caught:
        loop.run(still(20), Rows())
    assert not hasattr(caught.value, "__notes__"), "the reason itself is not told twice"


def test_sensors_are_judged_at_the_time_of_their_row_over_all_ticks_since_they_answered(monkeypatch: pytest.MonkeyPatch) -> None:
    loop = proportional_loop(ScriptedLink(ScriptedClock(), {3: sets(unanswered=1), 4: both(sets(unanswered=1), lost(2)), 6: lost(1)}))
    assert loop.judge is not None
    judged: list[tuple[int, float]] = []
    monkeypatch.setattr(loop.judge, "step", lambda sample, ticks, time_s: (judged.append((ticks, time_s / PERIOD_S)), "")[1])
    loop.run(still(12))
    assert judged == [(1, 0.0), (1, 1.0), (1, 2.0), (5, 7.0), (2, 9.0), (1, 10.0), (1, 11.0)]
    judged.clear()
    loop.link.script, loop.link.commands = {9: sets(unanswered=1)}, []
    loop.run(still(10))
    loop.link.script, loop.link.commands = {}, []
    loop.run(still(2))
    assert judged[-2:] == [(1, 0.0), (1, 1.0)], "ticks of a run before do not count"
    loop.link.script, loop.link.commands = {8: lost(4)}, []
    loop.run(still(10))
    assert judged[-1] == (5, 10.0), "nor does the end of a plan within lost ticks hide any"


def test_in_lockstep_the_hosts_times_stay_out_of_the_rows_and_in_the_summary() -> None:
    link, sink = ScriptedLink(ScriptedClock(), dict.fromkeys(range(5), sets(lateness_s=3e-5, arrived_s=1e-3))), Rows()
    loop = proportional_loop(link)
    loop.timed = False
    timing = loop.run(still(5), sink)
    rows = np.array(sink.rows)
    assert not rows[:, column("sync_lateness")].any()
    assert np.isnan(rows[:, [column("work_time"), column("answer_time")]]).all()
    assert timing.lateness_s.tolist() == [3e-5] * 5
    assert timing.answer_time_s.tolist() == [1e-3] * 5


def test_a_ticks_time_is_that_of_answers_of_computing_and_of_writing(monkeypatch: pytest.MonkeyPatch) -> None:
    """The command is ready 3 ms after a tick began; writing the row and the command before took 2 ms, the answers 1 ms."""
    clock = ScriptedClock()
    clock.idle_began_s = 5e-3
    monkeypatch.setattr(loop_module.time, "perf_counter", lambda: 3e-3)
    timing = proportional_loop(ScriptedLink(clock, dict.fromkeys(range(4), sets(arrived_s=1e-3)))).run(still(4))
    assert timing.write_time_s.tolist() == pytest.approx([0.0, 2e-3, 2e-3, 2e-3]), "nothing was written before the first"
    assert timing.compute_time_s.tolist() == pytest.approx([2e-3] * 4)
    assert timing.work_time_s.tolist() == pytest.approx([3e-3, 5e-3, 5e-3, 5e-3])


# ---- an observer


class ScriptedObserver:
    """Estimates the tick of the plan, and adds an effort to roll."""

    def __init__(self) -> None:
        self.estimate, self.effort = np.zeros(1), np.zeros(2)
        self.rows: list[int] = []
        self.steps: list[tuple[int, list[float], float]] = []

    def restart(self, rows: int) -> None:
        self.rows.append(rows)

    def step(self, sample: Sample, command: np.ndarray, tick: int) -> None:
        self.estimate[0] = 1000.0 + tick
        self.effort[1] = 0.25
        self.steps.append((tick, command.tolist(), float(sample.position[0])))


def observed_loop(link: ScriptedLink, observer: ScriptedObserver) -> SampleLoop:
    loop = proportional_loop(link)
    loop.layout = RowLayout(
        [AxisColumns(axis, "rad", "A", "A") for axis in AXES],
        PERIOD_S,
        imu="imu",
        link=True,
        temperature=True,
        observed=[("estimate_x", "m")],
    )
    loop.observer = observer
    loop.__post_init__()
    return loop


def excited(rows: int) -> Signals:
    plan = still(rows)
    plan.excitation[:, 1] = 0.5 * np.arange(rows)
    return plan


def test_an_observer_sees_each_row_with_the_command_before_it_and_adds_to_the_command() -> None:
    observer, sink = ScriptedObserver(), Rows()
    link = ScriptedLink(ScriptedClock(), {k: sets(position=(0, 0.01 * k)) for k in range(6)} | {3: both(lost(2), sets(position=(0, 0.03)))})
    observed_loop(link, observer).run(excited(8), sink)
    ticks = [0, 1, 2, 5, 6, 7]
    assert observer.rows == [8]
    rows = np.array(sink.rows)
    assert rows[:, -1].tolist() == [1000.0 + tick for tick in ticks], "its estimate goes into the row"
    commands = [[-0.1 * k, 0.5 * tick + 0.25] for k, tick in enumerate(ticks)]
    assert rows[:, column("command_roll")] == pytest.approx([command[1] for command in commands])
    assert rows[:, column("excitation_roll")] == pytest.approx([0.5 * tick for tick in ticks]), "what was added is no excitation"
    for k, (tick, before, seen) in enumerate(observer.steps):
        assert (tick, seen) == (ticks[k], 0.01 * k)
        assert before == pytest.approx(commands[k - 1] if k else [0.0, 0.0])


def test_what_an_observer_adds_is_saturated() -> None:
    observer, sink = ScriptedObserver(), Rows()
    plan = still(4)
    plan.excitation[:, 1] = 7.9
    observed_loop(ScriptedLink(ScriptedClock()), observer).run(plan, sink)
    assert {row[column("command_roll")] for row in sink.rows} == {8.0}


def test_a_run_that_is_not_recorded_is_not_observed() -> None:
    observer = ScriptedObserver()
    observed_loop(ScriptedLink(ScriptedClock()), observer).run(still(4))
    assert (observer.rows, observer.steps) == ([], [])


def test_a_run_goes_on_from_the_command_before_it() -> None:
    link = ScriptedLink(ScriptedClock())
    loop = proportional_loop(link)
    assert loop.control.effort.tolist() == [0.0, 0.0]
    plan = still(3)
    plan.excitation[:] = 0.5
    loop.run(plan)
    loop.run(still(2))
    assert [command.tolist() for command in link.commands] == [[0.0, 0.0], [0.5, 0.5], [0.5, 0.5], [0.5, 0.5], [0.0, 0.0]]
