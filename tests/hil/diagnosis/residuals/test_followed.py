"""Which joints encoders follow, and which effects a recording leaves a place for."""

from __future__ import annotations

import numpy as np
import pytest

from hil.diagnosis.candidates.entries import different_places
from hil.diagnosis.observed.rows import observed
from hil.diagnosis.residuals.residuals import residuals_of
from hil.diagnosis.residuals.trajectory import Trajectory
from hil.machine.load import machine_from_text
from hil.recording import Channel, Recording, RecordingWarning, recording_metadata
from virtual_bus.effects.registry import effects

ARM = """
[[body]]
name = "{name}_arm"
parent = "{parent}"
mass_kg = 1.0
center_of_mass_m = [0.0, 0.0, -0.2]
inertia_kg_m2 = [0.02, 0.02, 0.02, 0.0, 0.0, 0.0]
[body.joint]
name = "{name}"
type = "revolute"
axis = [0.0, 1.0, 0.0]

[drives.{name}]
joint = "{name}"
effort_unit = "Nm"
constant = 1.0
constant_unit = "Nm/Nm"
limit_Nm = 10.0

[sensors.position_{name}]
type = "encoder"
joints = {joints}
kind = "absolute"
resolution_rad = 0.0
"""
TEXT = (
    """
format = 1
name = "two_arms"
description = "two arms, the second one's angle read against the room"
gravity_m_s2 = [0.0, 0.0, -9.81]

[timing]
sample_rate_Hz = 200.0
substeps = 1
"""
    + ARM.format(name="first", parent="world", joints='["first"]')
    + ARM.format(name="second", parent="first_arm", joints='["second", "first"]')
)
TIME_s = np.arange(600) / 200.0
FIRST_rad, SECOND_rad = 0.5 * np.sin(4.0 * TIME_s), 0.3 * np.sin(7.0 * TIME_s + 1.0)


def trajectory(efforts: str) -> Trajectory:
    """A recording of both angles, with efforts in channels of this name."""
    machine = machine_from_text(TEXT, label="two arms")
    channels = {"time": Channel("s", TIME_s)}
    channels |= {f"{efforts}_{axis}": Channel("Nm", np.sin(TIME_s)) for axis in machine.axes}
    channels |= {"position_first": Channel("rad", FIRST_rad), "position_second": Channel("rad", FIRST_rad + SECOND_rad)}
    return Trajectory(observed(machine, "swing", Recording(channels, recording_metadata(machine))))


def test_a_joint_is_followed_by_what_a_sum_leaves_beside_the_others() -> None:
    only = trajectory("command")
    assert only.followed.all()
    inside = slice(50, -50)
    np.testing.assert_allclose(only.smooth[1].position[inside], SECOND_rad[inside], atol=1e-5)
    np.testing.assert_allclose(only.smooth[1].speed[inside], 2.1 * np.cos(7.0 * TIME_s + 1.0)[inside], atol=2e-3)


@pytest.mark.parametrize(("efforts", "places"), [("command", ["first", "second"]), ("effort", [])])
def test_what_a_drive_makes_of_commands_is_in_measured_efforts(efforts: str, places: list[str]) -> None:
    only = trajectory(efforts)
    assert only.observed.are_measured.all() == (efforts == "effort")
    for name in ("current_saturation", "drive_bandwidth", "delay"):
        assert different_places(effects()[name], only) == places


def test_recordings_are_seen_in_the_channels_that_all_have() -> None:
    both = trajectory("command").observed
    recording = both.recording
    fewer = {label: channel for label, channel in recording.channels.items() if label != "position_second"}
    with pytest.warns(RecordingWarning, match="fewer: no position_second, which other recordings have"):
        residuals = residuals_of(both.machine, {"both": recording, "fewer": Recording(fewer, recording.metadata)})
    assert [each.observed.channels for each in residuals.trajectories] == [("position_first",)]  # and they are repeats
    assert [each.observed.readings.shape[1] for each in residuals.trajectories] == [1]
