"""The sample loop: what stops the motors, what is kept, and which value stands in which row."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Never

import numpy as np
import pytest
from scripted_bench import GAIN, PERIOD_S, Rows, ScriptedClock, ScriptedLink, column, layout, proportional_loop, still

from drivers.errors import DeviceFaultError, HeartbeatLostError
from hil.bench.loop import SampleLoop
from hil.errors import LoopAbortedError


def test_a_plan_is_walked_through_to_its_last_row() -> None:
    link, sink = ScriptedLink(ScriptedClock()), Rows()
    timing = proportional_loop(link).run(still(300), sink)
    assert timing.ticks == len(sink.rows) == len(link.commands) == 300
    assert link.stops == 0  # the bench closes the brakes under control; a stop would let the machine sag


def _outside(link: ScriptedLink) -> None:
    link.sample.position[1] = 1.01


def _behind(link: ScriptedLink) -> None:
    link.sample.position[0] = 0.51


def _released(link: ScriptedLink) -> None:
    link.sample.hold_to_run = False


def _door(link: ScriptedLink) -> None:
    link.sample.door_closed = False


def _io_gone(link: ScriptedLink) -> None:
    link.sample.io_age_s = 0.51


def _io_never_answered(link: ScriptedLink) -> None:
    link.sample.io_age_s = float("nan")


def _fault(link: ScriptedLink) -> None:
    link.sample.fault = "roll_drive (node 2): EMCY 2310h: continuous over current"


def _warning(link: ScriptedLink) -> None:
    link.sample.statusword[1] |= 0x80


def _overrun(link: ScriptedLink) -> None:
    link.clock.missed += 9


def _asked(loop: SampleLoop) -> Callable[..., object]:
    def ask(link: ScriptedLink) -> None:
        loop.stop_request.ask("asked to stop by SIGINT")

    return ask


REASONS = {
    "position": (_outside, "roll: position 1.0100 rad is outside -1.0000 to 1.0000 rad"),
    "tracking": (_behind, "propeller: tracking error 0.5100 rad exceeds 0.5000 rad"),
    "hold_to_run": (_released, "hold-to-run was released"),
    "door": (_door, "the door was opened"),
    "io_age": (_io_gone, "the I/O has given no valid state for 0.51 s, 0.50 s are allowed"),
    "io_never": (_io_never_answered, "the I/O has given no valid state"),
    "fault": (_fault, "EMCY 2310h"),
    "sensor": (_warning, "drive_roll: its drive warns (statusword 16B7h)"),
    "overrun": (_overrun, "the loop lost 9 ticks in a row; timing.overrun_ticks bridges 8"),
}


@pytest.mark.parametrize(("event", "says"), REASONS.values(), ids=REASONS.keys())
def test_each_reason_stops_the_motors_keeps_the_rows_and_says_why_in_one_line(event: Callable[..., object], says: str) -> None:
    link, sink = ScriptedLink(ScriptedClock(), {5: event}), Rows()
    with pytest.raises(LoopAbortedError) as caught:
        proportional_loop(link).run(still(100), sink)
    message = str(caught.value)
    assert says in message
    assert message.startswith("row 5: ")
    assert "6 rows are kept" in message
    assert "\n" not in message
    assert link.stops >= 1
    assert len(sink.rows) == 6  # the row in which it happened is the most wanted one
    assert len(link.commands) == 6  # no command after it


def test_a_stop_request_ends_the_run_at_the_next_tick_and_its_first_reason_stands() -> None:
    link, sink = ScriptedLink(ScriptedClock()), Rows()
    loop = proportional_loop(link)
    link.script = {7: _asked(loop), 8: lambda link: pytest.fail("one more tick")}
    with pytest.raises(LoopAbortedError, match=r"row 7: asked to stop by SIGINT; the motors were stopped: .*; 8 rows are kept"):
        loop.run(still(100), sink)
    loop.stop_request.ask("another reason")
    assert loop.stop_request.reason == "asked to stop by SIGINT"
    assert link.stops >= 1
    assert len(sink.rows) == 8


@pytest.mark.parametrize(
    "error", [DeviceFaultError("drive left operation enabled"), HeartbeatLostError("node 1 is silent"), KeyboardInterrupt()]
)
def test_whatever_the_link_raises_leaves_with_the_motors_stopped_and_the_rows_before_it_kept(
    error: DeviceFaultError | HeartbeatLostError | KeyboardInterrupt,
) -> None:
    def fail(link: ScriptedLink) -> Never:
        raise error

    link, sink = ScriptedLink(ScriptedClock(), {4: fail}), Rows()
    with pytest.raises(type(error)):
        proportional_loop(link).run(still(10), sink)
    assert link.stops >= 1
    assert len(sink.rows) == 4


def test_a_machine_without_io_is_not_asked_for_hold_to_run_and_door() -> None:
    def nothing_pressed(link: ScriptedLink) -> None:
        link.sample.hold_to_run = link.sample.door_closed = False
        link.sample.io_age_s = float("inf")

    link = ScriptedLink(ScriptedClock(), dict.fromkeys(range(10), nothing_pressed))
    assert proportional_loop(link, guard_io=False).run(still(10)).ticks == 10


def _no_position(link: ScriptedLink) -> None:
    link.sample.position[0] = np.nan


def test_missing_positions_are_bridged_as_long_as_the_machine_file_allows_and_recorded_as_missing() -> None:
    def at(link: ScriptedLink) -> None:
        link.sample.position[0] = 0.02

    link, sink = ScriptedLink(ScriptedClock(), {3: at, 4: _no_position, 5: _no_position, 6: _no_position}), Rows()
    proportional_loop(link).run(still(20), sink)
    position, command = (np.array(sink.rows)[:, column(name)] for name in ("position_propeller", "command_propeller"))
    assert np.flatnonzero(np.isnan(position)).tolist() == [4, 5, 6]  # never invented
    assert command[3:7] == pytest.approx(-GAIN * 0.02)  # the last good position goes on
    assert np.isfinite(np.array(link.commands)).all()


def test_one_missing_position_more_stops_the_motors() -> None:
    link, sink = ScriptedLink(ScriptedClock(), dict.fromkeys((4, 5, 6, 7), _no_position)), Rows()
    with pytest.raises(LoopAbortedError, match=re.escape("row 7: propeller: no position for 4 ticks, timing.stale_ticks bridges 3")):
        proportional_loop(link).run(still(20), sink)
    assert link.stops >= 1
    assert len(sink.rows) == 8
    assert np.isfinite(np.array(link.commands)).all()


def test_positions_missing_now_and_then_never_add_up() -> None:
    link = ScriptedLink(ScriptedClock(), dict.fromkeys(range(1, 60, 2), _no_position))
    assert proportional_loop(link).run(still(60)).ticks == 60


def test_a_position_missing_in_the_very_first_row_is_bridged_too() -> None:
    """The machine stands at 0.9 rad; taking nothing for zero would be a tracking error of 0.9 rad and full current."""
    plan = still(10)
    plan.reference[:] = 0.9

    def far(link: ScriptedLink) -> None:
        link.sample.position[:] = 0.9

    def far_and_unseen(link: ScriptedLink) -> None:
        far(link)
        _no_position(link)

    link = ScriptedLink(ScriptedClock(), {k: far for k in range(10)} | {0: far_and_unseen})
    loop = proportional_loop(link)
    assert loop.run(plan).ticks == 10
    assert np.abs(link.commands[1:]).max() < 1e-12


def test_row_k_holds_reference_k_and_command_k_and_a_current_that_answers_to_the_command_before() -> None:
    rows = 50
    plan = still(rows)
    generator = np.random.default_rng(1)
    plan.reference[:] = 0.01 * generator.standard_normal((rows, 2))
    plan.reference_raw = plan.reference + 1.0
    plan.excitation[:] = generator.standard_normal((rows, 2))
    plan.feedforward = 0.1 * generator.standard_normal((rows, 2))
    positions = 0.01 * generator.standard_normal((rows, 2))

    def at(k: int) -> Callable[..., object]:
        def place(link: ScriptedLink) -> None:
            link.sample.position[:] = positions[k]

        return place

    link, sink = ScriptedLink(ScriptedClock(), {k: at(k) for k in range(rows)}), Rows()
    proportional_loop(link).run(plan, sink)
    table = np.array(sink.rows)
    expected = GAIN * (plan.reference - positions) + plan.excitation + plan.feedforward  # docs/explanation/notation.md, by hand
    for axis, name in enumerate(("propeller", "roll")):
        assert np.array_equal(table[:, column(f"reference_{name}")], plan.reference[:, axis])
        assert np.array_equal(table[:, column(f"reference_raw_{name}")], plan.reference_raw[:, axis])
        assert np.array_equal(table[:, column(f"excitation_{name}")], plan.excitation[:, axis])
        assert np.array_equal(table[:, column(f"feedforward_{name}")], plan.feedforward[:, axis])
        assert np.array_equal(table[:, column(f"position_{name}")], positions[:, axis])
        assert table[:, column(f"command_{name}")] == pytest.approx(expected[:, axis], abs=1e-12)
        assert table[1:, column(f"current_{name}")] == pytest.approx(expected[:-1, axis], abs=1e-12)
    assert table[:, 0] == pytest.approx(np.arange(rows) * PERIOD_S, abs=1e-12)


def test_the_recorded_command_is_saturated_and_no_excitation_drives_past_the_limit() -> None:
    plan = still(10)
    plan.excitation[4] = 100.0, -100.0
    link, sink = ScriptedLink(ScriptedClock()), Rows()
    proportional_loop(link).run(plan, sink)
    assert [sink.rows[4][column(f"command_{axis}")] for axis in ("propeller", "roll")] == [8.0, -8.0]
    assert link.commands[5].tolist() == [8.0, -8.0]


def test_what_did_not_arrive_is_missing_in_the_row() -> None:
    def silent(link: ScriptedLink) -> None:
        sample = link.sample
        for values in (sample.position, sample.link_position, sample.effort, sample.imu, sample.temperature_degC):
            values[:] = np.nan
        sample.statusword[:] = -1
        sample.imu_counter, sample.imu_time_s = -1, float("nan")

    link, sink = ScriptedLink(ScriptedClock(), {2: silent}), Rows()
    proportional_loop(link).run(still(4), sink)
    missing = {name for name, _ in layout().channels if np.isnan(sink.rows[2][column(name)])}
    measured = ("position", "link_position", "current", "temperature", "statusword")
    assert missing == {f"{name}_{axis}" for name in measured for axis in ("propeller", "roll")} | {
        *("imu_x", "imu_y", "imu_z", "gyro_x", "gyro_y", "gyro_z"),
        *("imu_time", "imu_counter"),
    }


def test_lateness_work_time_and_answer_time_of_every_tick_are_recorded(monkeypatch: pytest.MonkeyPatch) -> None:
    """A tick by the watch: SYNC at 10 ms, answers at 11 ms, hand-over at 12 ms, waiting again at 12.5 ms, and so on every 10 ms."""
    now_s = [0.0]
    monkeypatch.setattr("hil.bench.loop.time.perf_counter", lambda: now_s[0])
    clock = ScriptedClock()

    def tick(link: ScriptedLink) -> None:
        began_s = now_s[0] - 2e-3 + 10e-3  # the last hand-over was at +2 ms
        clock.idle_began_s = now_s[0] + 0.5e-3
        clock.tick_began_s = began_s
        link.sample.lateness_s = 30e-6
        link.sample.arrived_s = began_s + 1e-3
        now_s[0] = began_s + 2e-3

    link, sink = ScriptedLink(clock, dict.fromkeys(range(20), tick)), Rows()
    timing = proportional_loop(link).run(still(20), sink)
    table = np.array(sink.rows)
    assert table[:, column("sync_lateness")] == pytest.approx(30e-6)
    assert table[:, column("answer_time")] == pytest.approx(1e-3)
    assert table[0, column("work_time")] == pytest.approx(2e-3)  # nothing came before
    assert table[1:, column("work_time")] == pytest.approx(2.5e-3)  # hand-over and what came after it in the tick before
    assert timing.summary()["work_time_p99_us"] == pytest.approx(2500.0)
    assert timing.summary()["lateness_max_us"] == pytest.approx(30.0)


def test_progress_is_told_twice_a_second() -> None:
    told = []
    proportional_loop(ScriptedLink(ScriptedClock())).run(still(300), None, told.append)
    assert told == [0, 128, 256]


def test_what_stops_the_motors_on_the_way_to_a_recording_does_not_speak_of_rows() -> None:
    link = ScriptedLink(ScriptedClock(), {5: _released})
    with pytest.raises(LoopAbortedError, match=r"^hold-to-run was released; the motors were stopped: .*; nothing was recorded$"):
        proportional_loop(link).run(still(100))
    assert link.stops >= 1
