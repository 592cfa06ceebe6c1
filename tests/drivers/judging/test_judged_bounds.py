"""The judges at their bounds, with numbers that floating point holds exactly, and in the words in which they tell."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace

import numpy as np
import pytest

from drivers.interface import Sample
from drivers.judging.drive import DriveJudge
from drivers.judging.encoders import EncoderJudge
from drivers.judging.judge import MOST_FINDINGS, SensorJudge
from drivers.judging.motion_means import Expected
from drivers.judging.settings import DriveJudging, EncoderJudging, ImuJudging, JudgingSettings, TemperatureJudging
from drivers.judging.temperature import TemperatureJudge

PERIOD_S, COUNT = 2.0**-8, 2.0**-16
WINDOW = 128  # ticks of half a second
ENCODERS = EncoderJudging(
    "encoders_roll", 1, "rad", "mark", PERIOD_S, COUNT, 0.0, COUNT, 0.0, 3, 2.0**-7, 2.0**-9, 2.0**-12
)  # stale 3, tolerance 512, drift 128, growth 16 counts
IMU = ImuJudging("imu", "mark", PERIOD_S, 256.0, 0.0137, 0.125, (64.0,) * 3 + (8.0,) * 3, (4, 0, 4, 4, 4, 4), 2)
TEMPERATURE = TemperatureJudging("temperature_roll", 1, "stop", PERIOD_S, 128.0, 0.5, 0.125, 0.5)


class Axis:
    """Roll, the second of two axes, whose first is nobody's concern."""

    def __init__(self, settings: EncoderJudging = ENCODERS) -> None:
        self.judge, self.sample = EncoderJudge(settings), Sample(2)

    def step(self, motor: float, link: float | None = None, *, late_s: float = 0.0, ticks: int = 1) -> str:
        """Both positions in counts; the link as the motor side where it is not given."""
        self.sample.position[:] = (1e6, motor * COUNT)
        self.sample.link_position[:] = (-1e6, (motor if link is None else link) * COUNT)
        self.sample.lateness_s = late_s
        return self.judge.step(self.sample, ticks)


@pytest.mark.parametrize("way", [1, -1])
@pytest.mark.parametrize(("acceleration", "most"), [(0.0, 4), (3.0, 7)])
def test_a_second_difference_beyond_the_acceleration_and_four_counts_is_a_jump(way: int, acceleration: float, most: int) -> None:
    settings = replace(ENCODERS, motor_acceleration=acceleration, link_acceleration=acceleration)
    sound, motor, link = Axis(settings), Axis(settings), Axis(settings)
    for axis in (sound, motor, link):
        assert [axis.step(0), axis.step(0)] == ["", ""]
    assert sound.step(way * most) == ""
    assert motor.step(way * (most + 1), 0) == "jump"
    assert link.step(0, way * (most + 1)) == "jump"
    words = "its {} jumped by {:+d} counts between two samples; motion makes at most {}"
    assert motor.judge.says("jump") == words.format("motor side", way * (most + 1), most)
    assert link.judge.says("jump") == words.format("link encoder", way * (most + 1), most)
    assert (motor.judge.lag_ticks, motor.step(way * 100, 0)) == (0, "jump")
    assert motor.judge.says("jump") == words.format("motor side", way * (most + 1), most), "the first stands"


@pytest.mark.parametrize("way", [1, -1])
@pytest.mark.parametrize(("after", "most"), [(0, 5), (1, 6), (2, 5), (3, 4)])
def test_a_late_sync_latches_a_moving_axis_further_on(way: int, after: int, most: int) -> None:
    """At 64 counts a tick a sixty-fourth of a tick is a count: once in its tick, twice in the next, once in the one after."""
    for beyond, found in ((most, ""), (most + 1, "jump")):
        axis = Axis()
        for k in range(10):
            axis.step(way * 64 * k)
        for k in range(after + 1):
            at = way * (64 * (10 + k) + beyond * (k == after))
            check = axis.step(at, late_s=way * PERIOD_S / 64 if k == 0 else 0.0)
        assert check == found


def test_two_late_syncs_add_up() -> None:
    for beyond, found in ((7, ""), (8, "jump")):
        axis = Axis()
        for k in range(10):
            axis.step(64 * k)
        assert [axis.step(64 * k, late_s=PERIOD_S / 64) for k in (10,)] == [""]
        assert axis.step(64 * 11 + beyond, late_s=PERIOD_S / 64) == found


@pytest.mark.parametrize("gap", ["lost ticks", "no position"])
def test_after_a_gap_three_positions_are_needed(gap: str) -> None:
    axis = Axis()
    for _ in range(5):
        axis.step(0)
    if gap == "lost ticks":
        assert axis.step(100, ticks=2) == ""
    else:
        assert axis.step(math.nan, math.nan) == ""
        assert axis.step(100) == ""
    assert [axis.step(300), axis.step(500), axis.step(705)] == ["", "", "jump"]


def test_a_link_that_is_silent_is_told_with_how_long() -> None:
    axis = Axis()
    axis.step(0)
    assert [axis.step(0, math.nan) for _ in range(3)] == [""] * 3
    assert (axis.step(0, math.nan), axis.judge.lag_ticks) == ("silent", 3)
    assert axis.judge.says("silent") == "its link encoder has sent nothing for more than 3 ticks"
    assert (axis.step(0), axis.judge.lag_ticks) == ("", 0)
    assert axis.step(0, math.nan, ticks=4) == "silent"


def test_a_link_that_is_silent_from_the_first_sample_on_is_told_as_soon_as_any_other() -> None:
    axis = Axis()
    assert [axis.step(0, math.nan) for _ in range(4)] == ["", "", "", "silent"]


def test_an_axis_without_a_link_encoder_is_not_silent() -> None:
    axis = Axis(replace(ENCODERS, link_resolution=0.0))
    assert not any(axis.step(0, math.nan) for _ in range(2 * WINDOW))


@pytest.mark.parametrize("way", [1, -1])
def test_encoders_may_be_the_tolerance_apart(way: int) -> None:
    sound, wrong = Axis(), Axis()
    assert [sound.step(0, way * 512) for _ in range(3 * WINDOW)] == [""] * 3 * WINDOW
    checks = [wrong.step(0, way * 513) for _ in range(WINDOW)]
    assert checks == [""] * (WINDOW - 1) + ["apart"]
    assert wrong.judge.lag_ticks == WINDOW
    assert wrong.judge.says("apart") == (
        f"its link encoder stands {way * 513 * COUNT:+.2e} rad from where motor side and load put it; 7.81e-03 are allowed"
    )
    wrong.judge.begin()
    assert wrong.judge.lag_ticks == 0, "nothing is in doubt"
    assert [wrong.step(0) for _ in range(WINDOW)] == [""] * WINDOW


def test_a_window_of_which_half_was_not_heard_judges_nothing() -> None:
    for heard, found in ((WINDOW // 2, "apart"), (WINDOW // 2 - 1, "")):
        axis = Axis(replace(ENCODERS, stale_ticks=WINDOW))
        assert [axis.step(0, 600 if k < heard else math.nan) for k in range(WINDOW)][-1] == found


def test_lost_ticks_count_towards_a_window() -> None:
    axis = Axis(replace(ENCODERS, link_acceleration=1e9))
    assert [axis.step(0, 600) for _ in range(WINDOW - 40)][-1] == ""
    assert axis.step(0, 600, ticks=40) == "apart"


def test_at_a_sample_each_two_seconds_every_sample_is_a_window() -> None:
    axis = Axis(replace(ENCODERS, period_s=2.0))
    assert axis.step(0, 600) == "apart"
    assert Axis(replace(ENCODERS, period_s=2.0)).step(0, math.nan) == ""


def windows(axis: Axis, apart: Iterable[float]) -> list[str]:
    """The check after each window of half a second with these counts between both."""
    return [[axis.step(0, counts) for _ in range(WINDOW)][-1] for counts in apart]


@pytest.mark.parametrize("way", [1, -1])
def test_a_drift_grows_over_four_windows_and_beyond_what_is_allowed(way: int) -> None:
    settings = replace(ENCODERS, link_acceleration=1e9)
    axis = Axis(settings)
    assert windows(axis, [way * counts for counts in (10, 43, 76, 109, 142)]) == ["", "", "", "", "drift"]
    assert axis.judge.lag_ticks == 4 * WINDOW
    assert axis.judge.says("drift") == (
        f"its link encoder has departed from the motor side by {way * 132 * COUNT:+.2e} rad and goes on at "
        f"{way * 33 * COUNT / 0.5:+.1e} rad/s; 1.95e-03 are allowed: one of them drifts"
    )
    assert windows(Axis(settings), [way * counts for counts in (0, 32, 64, 96, 128, 144)]) == [""] * 6, "as much as is allowed"
    assert windows(Axis(settings), [way * counts for counts in (0, 50, 100, 150, 166, 199, 232, 265)]) == [""] * 8, "it stopped growing"
    assert windows(Axis(settings), [way * counts for counts in (0, 50, 100, 150, 167)]) == [""] * 4 + ["drift"]
    assert windows(Axis(settings), [way * counts for counts in (300, 260, 220, 180, 140)]) == [""] * 4 + ["drift"]
    assert windows(Axis(settings), [way * counts for counts in (0, 300, 280, 260, 240, 220)]) == [""] * 6, "it comes back"
    through = [way * counts for counts in (0, 200, 0, -50, -100, -150)]
    assert windows(Axis(settings), through) == [""] * 6, "three windows since it was where it began"


def thermometer(judge: TemperatureJudge, degC: float, ticks: int = 1, age_s: float = 0.0) -> str:
    sample = Sample(2)
    sample.temperature_degC[:] = (500.0, degC)
    sample.io_age_s = age_s
    return judge.step(sample, ticks)


def test_a_winding_may_be_as_hot_as_its_limit() -> None:
    assert thermometer(TemperatureJudge(TEMPERATURE), 128.0) == ""
    judge = TemperatureJudge(TEMPERATURE)
    assert thermometer(judge, 128.25) == "limit"
    assert judge.says("limit") == "128.2 degC, 128.0 are allowed"
    assert thermometer(judge, math.nan) == "broken"
    assert judge.says("broken") == "reads no temperature: its wire is broken, or it is not connected"
    assert [thermometer(judge, 200.0, age_s=0.5), thermometer(judge, 200.0, age_s=0.51)] == ["limit", ""]


@pytest.mark.parametrize("way", [1.0, -1.0])
def test_a_winding_changes_no_faster_than_it_can(way: float) -> None:
    """Half a kelvin a second over the time since the reference, and three steps of an eighth."""
    judge = TemperatureJudge(TEMPERATURE)
    assert thermometer(judge, 20.0, ticks=7) == ""
    assert thermometer(judge, 20.0 + way * 0.875, ticks=256) == ""
    assert thermometer(judge, 20.0 + way * 1.5, ticks=256) == "rate"
    assert judge.says("rate") == f"{way * 1.5:+.1f} K within 10 s; a winding changes by at most 0.5 K/s"
    assert thermometer(judge, 20.0 + way * 2.0, ticks=2047) == ""
    assert thermometer(judge, 20.0 + way * 2.0, ticks=1) == ""  # ten seconds are over: this is the reference
    assert thermometer(judge, 20.0 + way * 2.375) == ""
    assert thermometer(judge, 20.0 + way * 2.5) == "rate"
    next_one = TemperatureJudge(TEMPERATURE)
    thermometer(next_one, 20.0)
    assert thermometer(next_one, 20.0 + way * (0.375 + 1.5 / 512)) == "rate", "half a kelvin a second for one tick, and three steps"
    judge.begin()
    assert thermometer(judge, 90.0) == ""


def test_a_drive_that_warns() -> None:
    judge, sample = DriveJudge(DriveJudging("drive_roll", 1, "A", "mark", 0.3, 3, 3)), Sample(2)
    sample.statusword[:] = (0x80, 0x1637)
    assert judge.step(sample, 1) == ""
    sample.statusword[:] = (0, 0x80)
    assert (judge.step(sample, 1), judge.says("warning")) == ("warning", "its drive warns (statusword 0080h)")
    sample.statusword[:] = (0x80, -1)
    assert judge.step(sample, 1) == ""
    sample.statusword[:] = 0
    assert judge.step(sample, 1) == ""


def test_all_judges_together_say_what_they_found_and_from_when_on() -> None:
    noticed: list[tuple[float, str, str, str]] = []
    drive = DriveJudging("drive_roll", 1, "A", "stop", 0.3, 3, 3)
    whole = JudgingSettings(IMU, (ENCODERS,), (TEMPERATURE, replace(TEMPERATURE, sensor="t2")), (drive,))
    judge, sample = SensorJudge(whole, PERIOD_S, lambda *what: noticed.append(what)), Sample(2)
    assert judge.sensors == ("imu", "encoders_roll", "temperature_roll", "t2", "drive_roll")
    sample.imu_counter, sample.temperature_degC[:], sample.io_age_s = -1, math.nan, 0.0
    sample.position[:] = sample.link_position[:] = 0.0
    sample.statusword[:] = 0x80
    stop = "temperature_roll: reads no temperature: its wire is broken, or it is not connected"
    assert [judge.step(sample, 1, k) for k in (0.25, 0.5, 0.75, 1.0)] == [stop] * 4
    assert judge.marks == 0b11101
    imu = judge.findings[-1]
    assert (imu.sensor, imu.check, imu.follows, imu.since_s, imu.first_s, imu.last_s, imu.rows) == (
        *("imu", "age", "mark"),
        *(1.0 - 3 * PERIOD_S, 1.0, 1.0, 1),
    )
    assert [(each.sensor, each.says, each.follows, each.rows) for each in judge.findings[2:3]] == [
        ("drive_roll", "its drive warns (statusword 0080h)", "stop", 4)
    ]
    assert noticed == [
        (0.25, "temperature_roll", "broken", stop.partition(": ")[2]),
        (0.25, "t2", "broken", stop.partition(": ")[2]),
        (0.25, "drive_roll", "warning", "its drive warns (statusword 0080h)"),
        (1.0, "imu", "age", "no packet for more than 0.014 s"),
    ]
    sample.statusword[:] = 0
    sample.imu_counter, sample.imu[:] = 1, 0.0
    noticed.clear()
    judge.step(sample, 1, 2.0)
    assert noticed == [(2.0, "imu", "age", ""), (2.0, "drive_roll", "warning", "")]
    judge.restart()
    assert (judge.marks, judge.findings) == (0, ())
    judge.step(sample, 1, 3.0)
    assert [each.sensor for each in judge.findings] == ["temperature_roll", "t2"], "what is still wrong is found again"
    early = SensorJudge(JudgingSettings(IMU), PERIOD_S)
    sample.imu_counter = -1
    assert [early.step(sample, 4, 0.0), early.findings[0].since_s] == ["", 0.0]


def test_the_imu_is_judged_against_the_motion_that_the_machine_file_makes() -> None:
    expected = Expected(np.zeros(0), np.zeros(0), np.array([0.0, 0.0, 9.81, 0.0, 0.0, 0.0]))
    imu = replace(IMU, frozen_packets=(0,) * 6, force_tolerance=0.2)
    judge, sample = SensorJudge(JudgingSettings(imu, expects=lambda means: expected), PERIOD_S), Sample(0)
    sample.imu[:] = (0.0, 0.0, 9.0, 0.0, 0.0, 0.0)
    for k in range(WINDOW):
        sample.imu_counter, sample.imu_time_s = k, k * PERIOD_S
        assert not judge.marks
        judge.step(sample, 1, k * PERIOD_S)
    assert [(finding.check, finding.since_s, finding.first_s) for finding in judge.findings] == [("specific force", 0.0, 127 * PERIOD_S)]


def test_no_more_findings_are_kept_than_a_machine_can_have() -> None:
    many = JudgingSettings(temperatures=tuple(replace(TEMPERATURE, sensor=f"t{k}") for k in range(MOST_FINDINGS + 2)))
    judge, sample = SensorJudge(many, PERIOD_S), Sample(2)
    sample.temperature_degC[:], sample.io_age_s = math.nan, 0.0
    judge.step(sample, 1, 0.0)
    assert len(judge.findings) == MOST_FINDINGS == 64
