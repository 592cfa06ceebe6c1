"""A drive that measures another effort than it was sent, or takes more than its axis's motion explains, is found; a sound one is not."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from bench_machines import CARM

from drivers.interface import Sample
from drivers.judging.drive import DriveJudge
from drivers.judging.judge import SensorJudge
from drivers.judging.motion_means import Expected, Means
from drivers.judging.motion_window import MotionWindow
from drivers.judging.settings import DriveJudging, JudgingSettings

PERIOD_S = 1 / 256
SETTINGS = DriveJudging("drive_roll", 0, "A", "mark", tolerance=0.3, settling_ticks=3, bridged_ticks=3)
INERTIA, GRAVITY = 2.0, 5.0  # of a pendulum: A per rad/s^2, A at the horizontal


def sent(k: int) -> float:
    return 3.0 * np.sin(2.0 * np.pi * 2.0 * k * PERIOD_S)


def checks_of(measured: Callable[[int], float], rows: int = 512, sound_until: int = 200) -> list[str]:
    """What the drive is found to do, row by row; it is sound until a row."""
    judge, sample, found = SensorJudge(JudgingSettings(drives=(SETTINGS,)), PERIOD_S), Sample(1), []
    for k in range(rows):
        sample.commanded[0] = sent(k)
        sample.effort[0] = measured(k) if k >= sound_until else sent(k)
        judge.step(sample, 1, k * PERIOD_S)
        found.append("; ".join(finding.says for finding in judge.findings) if judge.marks else "")
    return found


def test_a_drive_that_follows_within_its_settling_time_is_sound() -> None:
    for ticks in (0, 1, 3):
        assert not any(checks_of(lambda k, ticks=ticks: sent(k - ticks) + 0.25, sound_until=0))


def test_a_lost_or_false_effort_is_found_at_the_fourth_row_and_ends_with_the_first_that_is_right() -> None:
    found = checks_of(lambda k: sent(k) + 1.0 if k < 300 else sent(k))
    assert [k for k, says in enumerate(found) if says] == list(range(203, 300))
    nearest = max(sent(k) for k in range(200, 204))
    assert found[203] == f"its drive measures {sent(203) + 1.0:+.3g} A where it was sent {nearest:+.3g} A; they may differ by 0.3 A"
    assert not any(checks_of(lambda k: 0.0, rows=203))


def test_an_effort_that_comes_ten_samples_late_is_found_while_the_command_changes() -> None:
    assert any(checks_of(lambda k: sent(k - 10)))


def test_what_did_not_arrive_is_not_judged() -> None:
    assert not any(checks_of(lambda k: float("nan")))


def pendulum(means: Means) -> Expected:
    effort = INERTIA * means.acceleration[0] + GRAVITY * np.cos(means.position[0])
    return Expected(effort, np.zeros(1), np.array([0.0, 0.0, 9.81, 0.0, 0.0, means.speed[0, 0]]))


def window_after(position: Callable[[np.ndarray], np.ndarray], disturbance: float = 0.0, swing: float = 0.0) -> MotionWindow:
    """The window over half a second of a pendulum that is moved along a path; its derivatives are taken from a far finer path."""
    fine = np.arange(-50, 128 * 100 + 50) * PERIOD_S / 100
    path = position(fine)
    acceleration = np.gradient(np.gradient(path, fine), fine)
    rows = 50 + 100 * np.arange(128)
    window, sample = MotionWindow(pendulum, 1, PERIOD_S), Sample(1)
    for row in rows:
        sample.position[0] = sample.link_position[0] = path[row]
        vibration = swing * np.sin(2.0 * np.pi * 8.3 * fine[row])
        sample.effort[0] = INERTIA * acceleration[row] + GRAVITY * np.cos(path[row]) + disturbance + vibration
        sample.imu[:] = (0.0, 0.0, 9.81, 0.0, 0.0, np.gradient(path, fine)[row])
        window.step(sample, 1)
    assert window.over
    return window


@pytest.mark.parametrize(
    "path",
    [
        lambda t: np.full_like(t, 0.7),
        lambda t: 0.3 + 0.4 * t,
        lambda t: 0.3 + 0.8 * t**2,
        lambda t: 0.1 * np.sin(2.0 * np.pi * 1.3 * t),
    ],
)
def test_the_means_of_a_motion_obey_its_equation(path: Callable[[np.ndarray], np.ndarray]) -> None:
    window = window_after(path)
    assert abs(window.effort_off[0]) < 0.015
    assert np.abs(window.imu_off).max() < 2e-3


def test_a_load_that_the_file_does_not_know_is_told_by_its_size_and_a_vibration_is_none() -> None:
    assert window_after(lambda t: 0.3 + 0.4 * t, disturbance=0.8).effort_off[0] == pytest.approx(0.8, abs=0.015)
    assert abs(window_after(lambda t: 0.3 + 0.4 * t, swing=5.0).effort_off[0]) < 0.1


def test_a_lost_tick_begins_the_window_anew() -> None:
    window, sample = MotionWindow(pendulum, 1, PERIOD_S), Sample(1)
    sample.position[0] = sample.link_position[0] = sample.effort[0] = 0.0
    overs = []
    for k in range(300):
        window.step(sample, 2 if k == 100 else 1)
        overs.append(window.over)
    assert [k for k, over in enumerate(overs) if over] == [227]


class Roll:
    """The drive of the second of two axes; its machine file expects 1 Nm of standstill, 0.25 Nm unsure, of the other axis 100 Nm."""

    ROLL = DriveJudging("drive_roll", 1, "Nm", "stop", 0.25, settling_ticks=2, bridged_ticks=3, load_tolerance=0.25)

    def __init__(self, settings: DriveJudging = ROLL, *, expects: float | None = 1.0) -> None:
        expected = Expected(np.array([100.0, expects or 0.0]), np.array([0.0, 0.25]), np.empty(0))
        self.window = MotionWindow(lambda means: expected, 2, PERIOD_S) if expects is not None else None
        self.judge, self.sample = DriveJudge(settings, self.window), Sample(2)
        self.sample.position[:] = self.sample.link_position[:] = 0.0
        self.sample.statusword[:] = 0x1637

    def step(self, measured: float, commanded: float | None = None, ticks: int = 1) -> str:
        """Take an effort, and the command before it, the same where it is not given."""
        self.sample.effort[:] = (0.0, measured)
        self.sample.commanded[:] = (50.0, measured if commanded is None else commanded)
        if self.window is not None:
            self.window.step(self.sample, ticks)
        return self.judge.step(self.sample, ticks)


@pytest.mark.parametrize("way", [1.0, -1.0])
def test_an_effort_may_be_the_tolerance_beyond_what_was_sent_in_the_settling_time(way: float) -> None:
    roll = Roll(expects=None)
    roll.step(way * 4.0)
    roll.step(0.0)
    assert [roll.step(measured, 0.0) for measured in (way * 4.25, way * -0.25)] == ["", ""], "all that is needed to settle"
    for _ in range(10):
        assert roll.step(way * 0.25, 0.0) == ""
    assert [roll.step(way * 0.5, 0.0) for _ in range(6)] == ["", "", "", "effort", "effort", "effort"]
    assert roll.judge.lag_ticks == 5, "since the first of them"
    assert roll.judge.says("effort") == (f"its drive measures {way * 0.5:+.3g} Nm where it was sent +0 Nm; they may differ by 0.25 Nm")
    assert (roll.step(0.0), roll.judge.lag_ticks) == ("", 0)
    assert [roll.step(way, 0.0) for _ in range(4)] == ["", "", "", "effort"], "it is counted anew"


@pytest.mark.parametrize(("measured", "nearest"), [(2.0, "+1"), (-2.0, "-0.5")])
def test_an_effort_that_is_off_is_told_with_the_nearest_that_was_sent(measured: float, nearest: str) -> None:
    roll = Roll(expects=None)
    assert [roll.step(measured, k % 2 * 1.5 - 0.5) for k in range(5)][-1] == "effort"
    assert roll.judge.says("effort").startswith(f"its drive measures {measured:+.3g} Nm where it was sent {nearest} Nm")


def test_lost_ticks_count_towards_an_effort_that_is_off_and_a_new_session_forgets_it() -> None:
    roll = Roll(expects=None)
    assert [roll.step(9.0, 0.0), roll.step(9.0, 0.0, ticks=3)] == ["", "effort"]
    assert roll.judge.lag_ticks == 3
    roll.judge.begin()
    assert roll.judge.lag_ticks == 0
    assert [roll.step(9.0, 0.0) for _ in range(4)] == ["", "", "", "effort"]
    roll.judge.begin()
    assert [roll.step(0.0, 9.0) for _ in range(4)] == ["", "", "", "effort"], "what was sent in the session before is not known"


def test_an_effort_that_did_not_arrive_neither_ends_nor_adds_to_one_that_is_off() -> None:
    roll, nan = Roll(expects=None), float("nan")
    assert [roll.step(measured, 0.0) for measured in (9.0, 9.0, nan, nan, nan, 9.0, 9.0)] == [""] * 6 + ["effort"]
    unknown = Roll(expects=None)
    assert [unknown.step(9.0, nan) for _ in range(9)] == [""] * 9, "nobody knows what was sent"


def half_a_second(roll: Roll, effort: float) -> list[str]:
    return [roll.step(effort) for _ in range(128)]


@pytest.mark.parametrize("way", [1.0, -1.0])
def test_a_load_may_be_off_by_the_tolerance_and_three_deviations_of_an_unsure_friction(way: float) -> None:
    """None is measured where 1 Nm are expected: off by 0.25 Nm and three times 0.25 Nm."""
    assert not any(half_a_second(Roll(expects=way), 0.0))
    roll = Roll(replace(Roll.ROLL, load_tolerance=0.2499), expects=way)
    assert half_a_second(roll, 0.0) == [""] * 127 + ["load"]
    assert roll.judge.lag_ticks == 127, "over the whole window"
    assert roll.judge.says("load") == (
        f"its mean effort over 0.5 s is {-way:+.3g} Nm from what the machine file says of this motion, 1 Nm are allowed: "
        "brake, friction, load or motor differ from it"
    )
    assert half_a_second(roll, way) == ["load"] * 127 + [""], "until a window without it is over"
    assert roll.judge.lag_ticks == 0


def test_a_load_is_forgotten_by_a_new_session_and_not_judged_without_a_window() -> None:
    roll = Roll()
    assert half_a_second(roll, 9.0)[-1] == "load"
    roll.judge.begin()
    assert half_a_second(roll, 9.0) == [""] * 127 + ["load"]
    assert not any(half_a_second(Roll(expects=None), 9.0))


def test_a_false_effort_goes_before_a_warning_and_a_warning_before_a_load() -> None:
    roll = Roll()
    half_a_second(roll, 9.0)
    roll.sample.statusword[1] |= 0x80
    assert [roll.step(9.0, 5.0) for _ in range(6)] == ["warning"] * 5 + ["effort"]
    assert (roll.step(9.0), roll.judge.lag_ticks) == ("warning", 0)
    roll.sample.statusword[1] = 0x1637
    assert (roll.step(9.0), roll.judge.lag_ticks) == ("load", 0), "what something else had hidden is in doubt from now on"


def test_the_load_of_each_axis_is_judged_in_one_window_of_the_machine() -> None:
    expected = Expected(np.array([0.0, 1.0]), np.zeros(2), np.empty(0))
    drives = tuple(replace(Roll.ROLL, sensor=f"drive_{k}", axis=k, load_tolerance=0.5, follows="mark") for k in range(2))
    judge, sample = SensorJudge(JudgingSettings(drives=drives, expects=lambda means: expected), PERIOD_S), Sample(2)
    sample.position[:] = sample.link_position[:] = sample.commanded[:] = sample.effort[:] = 0.0
    marks = []
    for k in range(200):
        judge.step(sample, 1, k * PERIOD_S)
        marks.append(judge.marks)
    assert marks == [0] * 127 + [0b10] * 73
    (finding,) = judge.findings
    assert (finding.check, finding.since_s, finding.first_s, finding.rows) == ("load", 0.0, 127 * PERIOD_S, 73)
    judge.begin()
    judge.step(sample, 1, 0.0)
    assert judge.marks == 0


def stops_of(measured: Callable[[int], float], command: Callable[[int], float], stop_tolerance: float = 1.0) -> int:
    """The row in which the motors are stopped though a finding is otherwise marked; -1: never."""
    settings = replace(SETTINGS, stop_tolerance=stop_tolerance)
    judge, sample = SensorJudge(JudgingSettings(drives=(settings,)), PERIOD_S), Sample(1)
    for k in range(300):
        sample.commanded[0], sample.effort[0] = command(k), measured(k) if k >= 100 else command(k)
        if reason := judge.step(sample, 1, k * PERIOD_S):
            assert reason.startswith("drive_roll: its drive measures ")
            return k
    return -1


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_drive_that_is_far_off_or_has_lost_its_torque_stops_the_motors_at_the_fourth_row(sign: float) -> None:
    assert stops_of(lambda k: sign * 8.0, lambda k: sign * 5.5) == 103
    assert stops_of(lambda k: sign * 6.4, lambda k: sign * 5.5) == -1, "it is marked"
    assert stops_of(lambda k: 0.2, lambda k: sign * 0.7) == 103, "none of what it was sent"
    assert stops_of(lambda k: 0.2, lambda k: sign * 0.55) == -1
    assert stops_of(lambda k: sign * 1.0, lambda k: sign * 1.5) == -1
    assert stops_of(lambda k: sign * 8.0 if k % 4 else sign * 5.5, lambda k: sign * 5.5) == -1, "three in a row are bridged"
    assert stops_of(lambda k: 0.0, lambda k: sign * 5.5, float("inf")) == -1


def test_the_machine_file_stops_where_a_fifth_of_the_rated_effort_is_off() -> None:
    for each, scaling in zip(CARM.judging.drives, CARM.bus.scalings, strict=True):  # type: ignore[union-attr]
        assert each.follows == "mark"
        assert each.stop_tolerance == pytest.approx(0.2 * scaling.rated)
