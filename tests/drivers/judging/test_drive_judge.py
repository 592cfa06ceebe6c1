"""A drive that measures another effort than it was sent, or takes more than its axis's motion explains, is found; a sound one is not."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from drivers.interface import Sample
from drivers.judging.judge import SensorJudge
from drivers.judging.motion_window import Expected, Means, MotionWindow
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
