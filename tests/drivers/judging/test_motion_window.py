"""Half a second of a motion: what its means are, against their closed forms, and when there are none."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from drivers.interface import Sample
from drivers.judging.motion_means import Expected, Means
from drivers.judging.motion_window import MotionWindow

PERIOD_S = 2.0**-8
TICKS = 128
MIDDLE_S = 63.5 * PERIOD_S  # of the first window
SPREAD = np.sqrt(1.0 / 12.0 - 0.5 / np.pi**2)  # standard deviation of time under a Hann window, in windows
EXPECTED = Expected(np.array([0.25, -0.5]), np.array([0.125, 0.0625]), np.array([1.0, 2.0, 3.0, 4.0, 5.0, 6.0]))

Spoil = Callable[[Sample, int], None]


class Watched:
    """A window of two axes, and the means that it asked about."""

    def __init__(self, expected: Expected = EXPECTED, period_s: float = PERIOD_S) -> None:
        self.means: list[Means] = []
        self.window = MotionWindow(lambda means: (self.means.append(means), expected)[1], 2, period_s)
        self.sample, self.k = Sample(2), 0
        self.sample.position[:] = self.sample.link_position[:] = self.sample.effort[:] = 0.0
        self.sample.imu[:] = 0.0

    def run(self, spoil: Spoil = lambda sample, k: None, rows: int = TICKS) -> list[int]:
        """Rows that end a window; `spoil` changes the samples, each of which keeps what it is not given."""
        overs = []
        for _ in range(rows):
            spoil(self.sample, self.k)
            self.window.step(self.sample, 1)
            if self.window.over:
                overs.append(self.k)
            self.k += 1
        return overs


def test_means_of_an_accelerated_axis_are_those_in_the_middle_of_the_window() -> None:
    def move(sample: Sample, k: int) -> None:
        t = k * PERIOD_S
        sample.position[:] = (0.5 + 0.25 * t, -1.0 + 0.5 * t + 1.5 * t**2)
        sample.link_position[:] = 2.0 * sample.position
        sample.effort[:] = (2.0 - t, 4.0 * t)

    watched = Watched()
    assert watched.run(move, 2 * TICKS) == [TICKS - 1, 2 * TICKS - 1]
    for means, middle_s in zip(watched.means, (MIDDLE_S, MIDDLE_S + 0.5), strict=True):
        position = [0.5 + 0.25 * middle_s, -1.0 + 0.5 * middle_s + 1.5 * (middle_s**2 + (SPREAD * 0.5) ** 2)]
        speed, acceleration = [0.25, 0.5 + 3.0 * middle_s], [0.0, 3.0]
        for side, times in ((0, 1.0), (1, 2.0)):
            assert means.position[side] == pytest.approx(times * np.array(position), rel=1e-3)
            assert means.speed[side] == pytest.approx(times * np.array(speed), rel=1e-3)
            assert means.acceleration[side] == pytest.approx(times * np.array(acceleration), rel=1e-3, abs=1e-9)
        assert means.effort == pytest.approx([2.0 - middle_s, 4.0 * middle_s])
        assert means.deviation == pytest.approx([0.0, 3.0 * SPREAD * 0.5], rel=5e-3, abs=1e-6)


def test_an_axis_without_a_link_encoder_has_the_means_of_its_motor_side() -> None:
    def move(sample: Sample, k: int) -> None:
        sample.position[:] = 1e-3 * k
        sample.link_position[:] = (np.nan, 2e-3 * k)

    watched = Watched()
    watched.run(move)
    (means,) = watched.means
    assert means.position[1] == pytest.approx([0.0635, 0.127])
    assert means.position[0] == pytest.approx([0.0635, 0.0635])
    assert means.speed[1, 0] == means.speed[0, 0]
    assert means.acceleration[1, 0] == means.acceleration[0, 0]


def test_what_is_off_is_what_was_measured_less_what_was_expected() -> None:
    watched = Watched()
    watched.sample.effort[:] = (1.0, 2.0)
    watched.sample.imu[:] = (1.0, 1.0, 1.0, -1.0, -1.0, -1.0)
    for known in (watched.window.effort_off, watched.window.effort_unsure, watched.window.imu_off):
        assert np.isnan(known).all(), "nothing is known before the first window"
    assert watched.run(rows=TICKS - 1) == []
    assert watched.run(rows=1) == [TICKS - 1]
    assert watched.window.effort_off == pytest.approx([0.75, 2.5])
    assert watched.window.effort_unsure.tolist() == [0.125, 0.0625]
    assert watched.window.imu_off == pytest.approx([0.0, -1.0, -2.0, -5.0, -6.0, -7.0])
    assert watched.run(rows=1) == [], "a window is over for one sample"


@pytest.mark.parametrize("channel", ["position", "effort"])
def test_a_window_that_misses_a_reading_of_one_axis_is_not_compared(channel: str) -> None:
    def lose(sample: Sample, k: int) -> None:
        getattr(sample, channel)[1] = np.nan if k == TICKS + 7 else 0.0

    watched = Watched()
    assert watched.run(lose, 3 * TICKS) == [TICKS - 1, 3 * TICKS - 1]
    assert len(watched.means) == 2


@pytest.mark.parametrize(("lost", "known"), [(range(34, 94), False), (range(70), False), (range(58), True), (range(0, 128, 3), True)])
def test_the_imu_is_compared_where_readings_with_more_than_half_of_the_weight_came(lost: range, known: bool) -> None:
    def lose(sample: Sample, k: int) -> None:
        sample.imu[:] = 2.0
        sample.imu[k % 6] = np.nan if k in lost else 2.0  # a packet that lacks one channel is not used

    watched = Watched()
    assert watched.run(lose) == [TICKS - 1], "the axes are compared regardless"
    if known:
        assert watched.window.imu_off == pytest.approx([1.0, 0.0, -1.0, -2.0, -3.0, -4.0])
    else:
        assert np.isnan(watched.window.imu_off).all()


def test_a_machine_without_an_imu_has_its_effort_compared() -> None:
    watched = Watched(Expected(np.zeros(2), np.zeros(2), np.empty(0)))
    assert watched.run() == [TICKS - 1]
    assert np.isnan(watched.window.imu_off).all()
    assert watched.window.effort_off.tolist() == [0.0, 0.0]


def test_lost_ticks_and_a_new_session_begin_the_window_anew() -> None:
    watched = Watched()
    watched.run(rows=100)
    watched.window.step(watched.sample, 2)  # the first of a window
    assert watched.run(rows=126) == []
    assert len(watched.run(rows=1)) == 1
    watched.run(rows=100)
    watched.window.begin()
    assert not watched.window.over
    for known in (watched.window.effort_off, watched.window.effort_unsure, watched.window.imu_off):
        assert np.isnan(known).all()
    assert watched.window.effort_off.shape == watched.window.effort_unsure.shape == (2,)
    assert watched.window.imu_off.shape == (6,)
    assert watched.run(rows=127) == []
    assert len(watched.run(rows=1)) == 1


@pytest.mark.parametrize(("period_s", "ticks"), [(2.0**-10, 512), (0.05, 10), (0.125, 8), (2.0, 8)])
def test_a_window_is_half_a_second_and_eight_samples_at_least(period_s: float, ticks: int) -> None:
    watched = Watched(period_s=period_s)
    assert watched.window.ticks == ticks
    assert watched.run(rows=2 * ticks) == [ticks - 1, 2 * ticks - 1]


def test_a_rehearsal_before_the_sample_that_ends_a_window_is_without_consequence() -> None:
    def move(sample: Sample, k: int) -> None:
        sample.position[:] = np.sin(0.1 * k)
        sample.effort[:] = np.cos(0.2 * k)

    plain, rehearsed = Watched(), Watched()
    ends = []
    for k in range(2 * TICKS):
        ends += [k] if rehearsed.window.rehearse() else []
        assert not rehearsed.window.rehearse(), "once, however long the next sample takes"
        known = rehearsed.window.over, rehearsed.window.effort_off.copy()
        assert rehearsed.run(move, 1) == plain.run(move, 1)
        assert known[0] is (k == TICKS), "a rehearsal ends no window"
        np.testing.assert_array_equal(rehearsed.window.effort_off, plain.window.effort_off)
    assert ends == [TICKS - 1, 2 * TICKS - 1]
    np.testing.assert_array_equal(rehearsed.means[1].rows, plain.means[0].rows)
    np.testing.assert_array_equal(rehearsed.means[3].rows, plain.means[1].rows)
