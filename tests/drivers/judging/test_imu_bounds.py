"""The IMU's judge at its bounds, with numbers that floating point holds exactly, and in the words in which it tells."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from drivers.interface import Sample
from drivers.judging.imu import ImuJudge
from drivers.judging.motion_means import Expected
from drivers.judging.motion_window import MotionWindow
from drivers.judging.settings import ImuJudging

PERIOD_S = 2.0**-8
IMU = ImuJudging("imu", "mark", PERIOD_S, 256.0, 0.0137, 0.125, (64.0,) * 3 + (8.0,) * 3, (4, 0, 4, 4, 4, 4), 2)


class Still:
    """An IMU whose numbers change at every packet."""

    def __init__(self, settings: ImuJudging = IMU) -> None:
        self.judge, self.sample, self.k = ImuJudge(settings), Sample(1), 0

    def step(self, change: Callable[[Sample], None] = lambda sample: None, ticks: int = 1) -> str:
        self.k += 1
        self.sample.imu[:] = self.k % 7
        self.sample.imu_counter, self.sample.imu_fault = self.k, ""
        change(self.sample)
        return self.judge.step(self.sample, ticks)


def lost(sample: Sample) -> None:
    sample.imu_counter = -1


def test_an_imu_that_is_silent() -> None:
    imu = Still()
    imu.step()
    assert [imu.step(lost) for _ in range(4)] == ["", "", "", "age"]
    assert imu.judge.lag_ticks == 3
    assert imu.judge.says("age") == "no packet for more than 0.014 s"
    assert (imu.step(), imu.judge.lag_ticks) == ("", 0)
    exact = Still(replace(IMU, age_s=4.0 * PERIOD_S))
    assert [exact.step(lost) for _ in range(5)] == ["", "", "", "", "age"]
    assert [exact.step(), exact.step(lost, ticks=5)] == ["", "age"]


def test_an_imu_that_is_slow_is_judged_by_the_second() -> None:
    patient = replace(IMU, age_s=10.0)
    for few, found in ((33, ""), (34, "rate")):  # an eighth of 256 packets is 32, and one is the phase
        imu = Still(patient)
        checks = [imu.step(lost if k < few else lambda sample: None) for k in range(256)]
        assert checks == [""] * 255 + [found]
    assert imu.judge.lag_ticks == 256
    assert imu.judge.says("rate") == "222 packets within 1 s, 256 are its rate and 12% the tolerance"
    assert [imu.step() for _ in range(256)] == ["rate"] * 255 + [""]
    fast = Still(replace(patient, rate_Hz=128.0))
    assert [fast.step() for _ in range(256)][-1] == "rate"
    assert fast.judge.says("rate") == "256 packets within 1 s, 128 are its rate and 12% the tolerance"


def test_an_imu_whose_line_is_garbled() -> None:
    imu = Still()

    def damaged(number: int) -> Callable[[Sample], None]:
        return lambda sample: setattr(sample, "imu_damaged", number)

    assert [imu.step(damaged(5)), imu.step(damaged(7)), imu.step(damaged(8))] == ["", "", "garbage"]
    assert imu.judge.says("garbage") == "3 damaged messages within 1 s, 2 are allowed"
    assert imu.judge.lag_ticks == 3
    assert [imu.step(damaged(8)) for _ in range(509)] == ["garbage"] * 508 + [""], "in this second, and for a second from its end"
    imu.judge.begin()
    assert [imu.step(damaged(0)), imu.step(damaged(2)), imu.step(damaged(3))] == ["", "", "garbage"]
    again = Still()
    assert [again.step(damaged(9)), again.step(damaged(0)), again.step(damaged(3))] == ["", "", "garbage"], "a line that was opened again"


@pytest.mark.parametrize("at", [1, 127, 255, 256, 257])
def test_messages_that_are_damaged_at_once_are_counted_whenever_in_a_second_they_come(at: int) -> None:
    imu = Still()
    checks = [imu.step(lambda sample, k=k: setattr(sample, "imu_damaged", 3 * (k >= at))) for k in range(300)]
    assert checks[:at] == [""] * at
    assert checks[at] == "garbage"


def test_at_a_sample_each_two_seconds_every_sample_is_a_window() -> None:
    imu = Still(replace(IMU, period_s=2.0, rate_Hz=0.5, age_s=10.0))
    checks = [imu.step(lambda sample, number=number: setattr(sample, "imu_damaged", number)) for number in (0, 3, 3, 5, 8)]
    assert checks == ["", "garbage", "", "", "garbage"]
    assert imu.judge.lag_ticks == 1


@pytest.mark.parametrize(
    ("channel", "value", "check", "words"),
    [
        (1, math.nan, "number", "y is nan, no number"),
        (0, -math.inf, "number", "x is -inf, no number"),
        (2, 64.0, "range", "z reads 64, its full scale is 64"),
        (5, -8.0, "range", "rate z reads -8, its full scale is 8"),
        (3, math.nextafter(8.0, 0.0), "", ""),
    ],
)
def test_an_imu_that_gives_no_sound_number(channel: int, value: float, check: str, words: str) -> None:
    imu = Still()
    imu.step()

    def spoil(sample: Sample) -> None:
        sample.imu[channel] = value

    assert (imu.step(spoil), imu.judge.lag_ticks) == (check, 0)
    if check:
        assert imu.judge.says(check) == words
    assert imu.step() == ""


def test_an_imu_that_is_frozen() -> None:
    imu = Still()

    def freeze(*channels: int) -> Callable[[Sample], None]:
        return lambda sample: [sample.imu.__setitem__(channel, 0.25) for channel in channels] and None

    assert [imu.step(freeze(4)) for _ in range(4)] == ["", "", "", "frozen"]
    assert imu.judge.says("frozen") == "rate y has not changed for 4 packets; noise makes that impossible"
    assert imu.judge.lag_ticks == 3
    assert [imu.step(freeze(1)) for _ in range(20)] == [""] * 20, "a channel that is not judged"
    assert [imu.step(freeze(0, 4)) for _ in range(4)][-1] == "frozen"
    assert imu.judge.says("frozen").startswith("x has not"), "the first of them is named"
    assert [imu.step(freeze(0)), imu.step(lost), imu.step(freeze(0))] == ["frozen", "", "frozen"]


@pytest.mark.parametrize(
    ("fault", "words"), [("imu: reports: a failed self-test", "reports: a failed self-test"), ("it is broken", "it is broken")]
)
def test_what_an_imu_says_of_itself_goes_before_all_else(fault: str, words: str) -> None:
    imu = Still()

    def spoil(sample: Sample) -> None:
        sample.imu_fault = fault
        sample.imu[0] = math.nan

    assert (imu.step(spoil), imu.judge.says("fault")) == ("fault", words)


@pytest.mark.parametrize("triggered", [False, True])
def test_lost_ticks_lack_a_packet_where_the_sensor_runs_by_itself_and_none_where_each_sync_triggers_it(triggered: bool) -> None:
    imu = Still(replace(IMU, triggered=triggered))
    assert imu.step(lost, ticks=4) == ("" if triggered else "age")
    patient = Still(replace(IMU, triggered=triggered, age_s=10.0))
    assert [patient.step(ticks=4) for _ in range(256)][-1] == ("" if triggered else "rate")


def test_a_sensor_faster_than_the_ticks_gives_one_reading_a_row() -> None:
    fast = Still(replace(IMU, rate_Hz=1000.0))
    assert {fast.step() for _ in range(1024)} == {""}


def test_the_first_packet_of_a_device_counts_from_zero() -> None:
    imu = Still(replace(IMU, age_s=0.0))
    assert imu.step(lambda sample: setattr(sample, "imu_counter", 0)) == ""


def test_a_channel_is_found_frozen_though_another_is_out_of_range_meanwhile() -> None:
    imu = Still()

    def spoil(sample: Sample) -> None:
        sample.imu[:] = (64.0, *sample.imu[1:5], 0.25)

    assert [imu.step(spoil) for _ in range(3)] == ["range"] * 3
    assert imu.step(lambda sample: sample.imu.__setitem__(5, 0.25)) == "frozen"
    assert imu.judge.says("frozen").startswith("rate z ")


def test_a_new_session_knows_of_nothing_before_it() -> None:
    imu = Still()

    def damaged(sample: Sample) -> None:
        lost(sample)
        sample.imu_damaged = 2

    def frozen(sample: Sample) -> None:
        sample.imu[:] = (0.25, *sample.imu[1:])

    for _ in range(3):
        imu.step(damaged)
        imu.judge.begin()
    assert [imu.step(frozen) for _ in range(3)] == [""] * 3
    imu.judge.begin()
    imu.step(frozen)
    assert [imu.step(lost) for _ in range(4)] == ["", "", "", "age"]
    imu.judge.begin()
    assert imu.judge.lag_ticks == 0
    assert [imu.step(lost) for _ in range(4)] == ["", "", "", "age"]
    slow = Still(replace(IMU, age_s=10.0))
    assert [slow.step(lost) for _ in range(256)][-1] == "rate"
    slow.judge.begin()
    assert [slow.step() for _ in range(256)] == [""] * 256
    slow.judge.begin()
    assert [slow.step(lost) for _ in range(256)] == [""] * 255 + ["rate"]


class Stamped:
    """An IMU whose readings bear a time: so many periods late."""

    def __init__(self, settings: ImuJudging = IMU) -> None:
        self.imu = Still(settings)

    def step(self, periods: float = 0.0, *, ticks: int = 1, sync_late_s: float = 0.0, came: bool = True) -> str:
        def stamp(sample: Sample) -> None:
            sample.imu_counter = self.imu.k if came else -1
            sample.imu_time_s = 17.0 + (self.imu.k - periods) * PERIOD_S + sync_late_s
            sample.lateness_s = sync_late_s

        return self.imu.step(stamp, ticks)


@pytest.mark.parametrize(("rate_Hz", "sound", "late"), [(256.0, 1.49, 1.52), (64.0, 5.99, 6.02), (1000.0, 1.49, 1.52), (256.0, 1.0, 150.0)])
def test_readings_may_be_a_period_and_a_half_late_of_ticks_or_of_packets_and_longer_for_as_long_as_they_may_be_missing(
    rate_Hz: float, sound: float, late: float
) -> None:
    imu = Stamped(replace(IMU, rate_Hz=rate_Hz, rate_tolerance=10.0))
    for _ in range(10):
        imu.step()
    assert not any(imu.step(sound) for _ in range(20))
    assert [imu.step(late) for _ in range(5)] == ["", "", "", "late", "late"]
    assert imu.imu.judge.says("late") == (
        f"its readings are {late * PERIOD_S * 1e3:.1f} ms older than at first, {1.5e3 * max(1 / 256, 1 / rate_Hz):.1f} ms are allowed"
    )
    assert imu.step() == ""
    assert [imu.step(late), imu.step(late), imu.step(came=False), imu.step(late), imu.step(late)] == ["", "", "", "", "late"]


def test_readings_may_be_late_for_exactly_as_long_as_they_may_be_missing() -> None:
    imu = Stamped(replace(IMU, age_s=4.0 * PERIOD_S))
    imu.step()
    assert [imu.step(2.0) for _ in range(5)] == ["", "", "", "", "late"]


def test_a_late_sync_is_no_lateness_of_the_imu() -> None:
    imu = Stamped()
    assert not any(imu.step(sync_late_s=0.02 * (k % 50 < 10)) for k in range(200))


def test_lost_ticks_and_a_new_session_begin_the_comparison_of_times_anew() -> None:
    for again in ("lost ticks", "session"):
        imu = Stamped()
        for _ in range(10):
            imu.step()
        assert [imu.step(3.0) for _ in range(4)][-1] == "late"
        if again == "session":
            imu.imu.judge.begin()
        assert not any(imu.step(3.0, ticks=2 if k == 0 and again == "lost ticks" else 1) for k in range(20))


class Moving:
    """An IMU that reads nothing where a force of 7 m/s^2 and a turn of 2.5 rad/s are expected."""

    EXPECTED = np.array([2.0, -3.0, 6.0, 1.5, 0.0, 2.0])
    EXACT = replace(IMU, frozen_packets=(0,) * 6, force_tolerance=7.0, turn_tolerance=2.5)

    def __init__(self, *, force: bool = True, turn: bool = True) -> None:
        below = math.nextafter(1.0, 0.0)
        settings = replace(self.EXACT, force_tolerance=7.0 * (1.0 if force else below), turn_tolerance=2.5 * (1.0 if turn else below))
        expected = Expected(np.zeros(1), np.zeros(1), self.EXPECTED)
        self.window = MotionWindow(lambda means: expected, 1, PERIOD_S)
        self.judge, self.sample, self.k = ImuJudge(settings, self.window), Sample(1), 0
        self.sample.position[:] = self.sample.effort[:] = 0.0

    def step(self, *, sound: bool = False, came: bool = True) -> str:
        self.sample.imu[:] = self.EXPECTED if sound else 0.0
        self.sample.imu_counter, self.sample.imu_time_s = self.k if came else -1, self.k * PERIOD_S
        self.window.step(self.sample, 1)
        self.k += 1
        return self.judge.step(self.sample, 1)

    def half_a_second(self, *, sound: bool = False) -> list[str]:
        return [self.step(sound=sound) for _ in range(128)]


@pytest.mark.parametrize(
    ("force", "turn", "check", "words"),
    [
        (False, True, "specific force", "specific force over 0.5 s is 7 m/s^2 from what the motion of the axes makes of it, 7 m/s^2 are"),
        (True, False, "angular rate", "angular rate over 0.5 s is 2.5 rad/s from what the motion of the axes makes of it, 2.5 rad/s are"),
        (False, False, "specific force", "specific force over 0.5 s is 7 m/s^2 from what the motion of the axes makes of it, 7 m/s^2 are"),
    ],
)
def test_a_mean_that_the_motion_does_not_make_is_told_until_the_next_window_is_over(
    force: bool, turn: bool, check: str, words: str
) -> None:
    assert not any(Moving().half_a_second()), "as much as is allowed"
    imu = Moving(force=force, turn=turn)
    assert imu.half_a_second() == [""] * 127 + [check]
    assert imu.judge.lag_ticks == 127
    assert imu.judge.says(check) == f"its mean {words} allowed"
    assert imu.half_a_second(sound=True) == [check] * 127 + [""]
    assert imu.judge.lag_ticks == 0
    imu.half_a_second()
    imu.judge.begin()
    assert imu.half_a_second(sound=True) == [""] * 128


def test_a_departure_that_silence_has_hidden_is_in_doubt_from_the_next_packet_on() -> None:
    imu = Moving(force=False)
    imu.half_a_second()
    assert [imu.step(came=False) for _ in range(4)] == ["specific force"] * 3 + ["age"]
    assert (imu.step(), imu.judge.lag_ticks) == ("specific force", 0)
