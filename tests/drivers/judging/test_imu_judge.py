"""An IMU that is silent, slow, frozen, beyond its scale, not a number or garbled is found; a sound one is not."""

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

PERIOD_S = 1 / 256
NOISE = 0.005
GRAVITY = np.array([0.0, 0.0, 9.81, 0.0, 0.0, 0.0])
SETTINGS = ImuJudging("imu", "mark", PERIOD_S, 256.0, 0.0137, 0.1, (50.0,) * 3 + (7.85,) * 3, (8,) * 6, 2)


def checks_of(change: Callable[[Sample, int], None], rows: int = 1024, settings: ImuJudging = SETTINGS, seed: int = 1) -> list[str]:
    """What an IMU that lies still is found to be, row by row; `change` spoils its samples."""
    noise = np.random.default_rng(seed).normal(size=(rows, 6)) * NOISE
    judge, sample, found = ImuJudge(settings), Sample(1), []
    for k in range(rows):
        sample.imu[:] = GRAVITY + np.round(noise[k], 4)
        sample.imu_counter, sample.imu_fault, sample.imu_damaged = k, "", 0
        change(sample, k)
        found.append(judge.step(sample, 1))
        if found[-1]:
            assert "\n" not in judge.says(found[-1])
    return found


def lose(sample: Sample) -> None:
    sample.imu[:] = np.nan
    sample.imu_counter = -1


def test_a_sound_imu_is_never_found_wrong() -> None:
    for seed in range(3):
        assert set(checks_of(lambda sample, k: None, 20_000, seed=seed)) == {""}


def test_silence_is_found_when_the_newest_packet_is_too_old_and_ends_with_the_next_one() -> None:
    found = checks_of(lambda sample, k: lose(sample) if 300 <= k < 310 else None)
    assert [k for k, check in enumerate(found) if check] == list(range(303, 310))  # the fourth is older than 13.7 ms
    assert set(found) == {"", "age"}


def test_as_few_packets_as_the_tolerance_forbids_are_found_within_a_second() -> None:
    found = checks_of(lambda sample, k: lose(sample) if k % 5 == 0 else None)
    assert found.index("rate") == 255
    assert not any(checks_of(lambda sample, k: lose(sample) if k % 20 == 0 else None))


def test_a_sensor_on_its_own_slower_clock_is_sound() -> None:
    slow = replace(SETTINGS, rate_Hz=100.0, age_s=0.035)
    assert not any(checks_of(lambda sample, k: None if int(k * 100 / 256) > int((k - 1) * 100 / 256) else lose(sample), settings=slow))


def test_one_channel_that_does_not_change_is_frozen_at_the_eighth_packet() -> None:
    def freeze(sample: Sample, k: int) -> None:
        if k >= 300:
            sample.imu[4] = 0.0123

    found = checks_of(freeze)
    assert found.index("frozen") == 307
    assert set(found[307:]) == {"frozen"}


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_a_packet_that_holds_no_number_is_found_in_its_row(value: float) -> None:
    def spoil(sample: Sample, k: int) -> None:
        if k == 300:
            sample.imu[1] = value

    found = checks_of(spoil)
    assert [k for k, check in enumerate(found) if check == "number"] == [300]


def test_a_reading_at_full_scale_is_found() -> None:
    def saturate(sample: Sample, k: int) -> None:
        if k == 300:
            sample.imu[5] = -7.85

    assert checks_of(saturate).index("range") == 300


def test_damaged_messages_are_found_once_there_are_more_than_allowed_in_a_second() -> None:
    def damage(sample: Sample, k: int) -> None:
        sample.imu_damaged = sum(k >= at for at in (10, 400, 520, 530, 540))

    found = checks_of(damage)
    assert found.index("garbage") == 540
    assert not any(found[:540])
    assert not any(checks_of(lambda sample, k: setattr(sample, "imu_damaged", k // 128)))  # two a second, for ever


def test_what_the_device_reports_of_itself_is_found() -> None:
    assert checks_of(lambda sample, k: setattr(sample, "imu_fault", "imu: reports a failed self-test")) == ["fault"] * 1024


def test_readings_that_come_two_ticks_late_are_found_and_a_drifting_clock_is_not() -> None:
    def stamped(late: int, drift: float) -> Callable[[Sample, int], None]:
        def change(sample: Sample, k: int) -> None:
            came = k - (late if k >= 300 else 0)
            if 300 <= k < 300 + late:
                lose(sample)
            sample.imu_time_s = came * PERIOD_S * (1.0 + drift)

        return change

    found = checks_of(stamped(2, 0.0))
    assert [k for k, check in enumerate(found) if check] == list(range(305, 1024))
    assert set(found) == {"", "late"}
    assert not any(checks_of(stamped(1, 1e-4), rows=20_000))
    assert not any(checks_of(stamped(0, -1e-4), rows=20_000))


def test_readings_that_the_motion_of_the_axes_does_not_explain_are_found_window_after_window() -> None:
    settings = replace(SETTINGS, force_tolerance=0.2, turn_tolerance=0.02)
    expected = Expected(np.zeros(1), np.zeros(1), GRAVITY)

    def checks(bias: np.ndarray) -> list[str]:
        window, sample, found = MotionWindow(lambda means: expected, 1, PERIOD_S), Sample(1), []
        judge = ImuJudge(settings, window)
        sample.position[0] = sample.link_position[0] = sample.effort[0] = 0.0
        for k in range(512):
            sample.imu[:] = GRAVITY + 1e-4 * (k % 2) + (bias if 128 <= k < 256 else 0.0)
            sample.imu_counter, sample.imu_time_s = k, k * PERIOD_S
            window.step(sample, 1)
            found.append(judge.step(sample, 1))
        return found

    assert checks(np.array([0.0, 0.3, 0.0, 0.0, 0.0, 0.0])) == [""] * 255 + ["specific force"] * 128 + [""] * 129
    assert checks(np.array([0.0, 0.0, 0.0, 0.0, 0.03, 0.0])) == [""] * 255 + ["angular rate"] * 128 + [""] * 129
    assert not any(checks(np.array([0.0, 0.15, 0.0, 0.0, 0.015, 0.0])))
