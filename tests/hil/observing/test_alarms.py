"""An alarm of the observer has a place and a likeliest reason, and poses outside the design's are warned of."""

from __future__ import annotations

import re

import numpy as np
import pytest

from hil.observing import Estimate, alarms
from hil.observing.alarms import alarm_lines, outside_lines
from hil.recording import Channel, Recording

RATE_Hz, ROWS = 256.0, 2560
TIME_S = np.arange(ROWS) / RATE_Hz
CHANNELS = ("position_propeller", "position_roll", "imu_y")
UNITS = ("rad", "rad", "m/s^2")
NOISE = np.array([2e-6, 2e-6, 5e-3])
POSES = np.array([[0.0, -0.5], [0.0, 0.0], [0.0, 0.5]])
LATE = TIME_S > 6.0


def recording(roll: np.ndarray) -> Recording:
    channels = {"time": Channel("s", TIME_S)}
    for name, unit, values in zip(CHANNELS, UNITS, (np.zeros(ROWS), roll, np.zeros(ROWS)), strict=True):
        channels[name] = Channel(unit, values)
    return Recording(channels, {"machine": {"axes": ["propeller", "roll"]}})


def estimate(innovation: np.ndarray, alarm: np.ndarray) -> Estimate:
    nis = np.sum((innovation / NOISE) ** 2, axis=1)
    values = np.column_stack([nis, np.full(ROWS, 3.0), nis / 3.0, alarm.astype(float)])
    names = ("estimate_nis", "estimate_measured", "estimate_nis_window", "estimate_alarm")
    return Estimate(TIME_S, names, ("",) * 4, values, CHANNELS, innovation, (), np.zeros((ROWS, 0)), "ukf", "")


def usual() -> np.ndarray:
    return NOISE * np.random.default_rng(0).standard_normal((ROWS, 3))


@pytest.mark.parametrize(
    ("channel", "added", "kind", "said"),
    [
        (1, 40e-6 * LATE, "offset", r"position_roll reads \+4e-05 rad beside what the model predicts: an offset"),
        (2, 0.1 * np.sin(2.0 * np.pi * 17.0 * TIME_S) * LATE, "swing", r"imu_y swings at 17(\.\d)? Hz beside the model: a mode"),
        (
            1,
            40e-6 * np.sin(2.0 * np.pi * 1.2 * TIME_S) * LATE,
            "swing",
            "position_roll is off with the motion, at 1.25 Hz: inertia, friction",
        ),
        (2, 0.1 * np.random.default_rng(1).standard_normal(ROWS) * LATE, "noise", "imu_y scatters more than the design's noise"),
    ],
)
def test_an_alarm_names_channel_time_pose_and_reason(channel: int, added: np.ndarray, kind: str, said: str) -> None:
    innovation = usual()
    innovation[:, channel] += added
    recorded = recording(np.full(ROWS, np.radians(20.0)))
    (alarm,) = alarms(estimate(innovation, LATE), recorded, NOISE, POSES)
    assert (alarm.channel, alarm.kind) == (CHANNELS[channel], kind)
    assert alarm.times == pytest.approx(np.sqrt(np.mean(innovation[LATE, channel] ** 2)) / NOISE[channel], rel=0.05)
    (line,) = alarm_lines([alarm], recorded)
    assert line.startswith("alarm 6.00 to 10.00 s at propeller 0.0 deg, roll 20.0 deg: ")
    assert re.search(said, line), line
    assert "outside" not in line


def test_a_quiet_estimate_has_no_alarm_and_two_apart_are_two() -> None:
    nothing = np.zeros(ROWS, dtype=bool)
    assert alarms(estimate(usual(), nothing), recording(np.zeros(ROWS)), NOISE, POSES) == ()
    twice = (np.abs(TIME_S - 2.0) < 0.1) | (np.abs(TIME_S - 2.3) < 0.1) | (np.abs(TIME_S - 5.0) < 0.1)
    innovation = usual() * np.where(twice, 20.0, 1.0)[:, None]
    found = alarms(estimate(innovation, twice), recording(np.zeros(ROWS)), NOISE, POSES)
    assert [(round(alarm.from_s, 1), round(alarm.to_s, 1)) for alarm in found] == [(1.9, 2.4), (4.9, 5.1)]


def test_where_all_rows_have_an_alarm_the_designs_noise_says_what_is_usual() -> None:
    innovation = usual()
    innovation[:, 0] *= 50.0
    (alarm,) = alarms(estimate(innovation, np.ones(ROWS, dtype=bool)), recording(np.zeros(ROWS)), NOISE, np.zeros((0, 0)))
    assert alarm.channel == "position_propeller"
    assert alarm.times == pytest.approx(50.0, rel=0.05)


def test_an_axis_that_leaves_the_designs_poses_is_warned_of() -> None:
    sweep = recording(np.linspace(0.0, 1.0, ROWS))
    (line,) = outside_lines(sweep, POSES)
    assert line.startswith("warning: roll is outside the design's poses in 48% of rows: it goes from 0 to 57.3 deg")
    (alarm,) = alarms(estimate(usual() * np.where(LATE, 9.0, 1.0)[:, None], LATE), sweep, NOISE, POSES)
    assert alarm.outside == ("roll",)
    assert "roll is outside the design's poses" in alarm_lines([alarm], sweep)[0]
    assert outside_lines(recording(np.full(ROWS, 0.51)), POSES) == []
    assert outside_lines(sweep, np.zeros((0, 0))) == []  # an older design does not say its poses
