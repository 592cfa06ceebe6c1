"""What a fast motion does beyond the linear part: an accelerometer off the axis feels the square of the whole speed."""

from __future__ import annotations

import numpy as np
import pytest

from hil.diagnosis.observed.rows import observed
from hil.diagnosis.residuals.equation_errors import equation_errors
from hil.diagnosis.residuals.trajectory import Motion, Trajectory
from hil.machine.load import machine_from_text
from hil.recording import Channel, Recording, recording_metadata

RADIUS_m = 0.5
TEXT = f"""
format = 1
name = "boom"
description = "a boom with an IMU off its axis"
gravity_m_s2 = [0.0, 0.0, -9.81]

[timing]
sample_rate_Hz = 200.0
substeps = 1

[[body]]
name = "boom"
parent = "world"
mass_kg = 1.0
inertia_kg_m2 = [0.02, 0.02, 0.02, 0.0, 0.0, 0.0]
[body.joint]
name = "turn"
type = "revolute"
axis = [0.0, 0.0, 1.0]

[drives.turn]
joint = "turn"
effort_unit = "Nm"
constant = 1.0
constant_unit = "Nm/Nm"
limit_Nm = 10.0

[sensors.position_turn]
type = "encoder"
joints = ["turn"]
kind = "absolute"
resolution_rad = 1e-6

[sensors.imu]
type = "imu"
body = "boom"
position_m = [{RADIUS_m}, 0.0, 0.0]
accelerometer_noise_rms_m_s2 = [0.01, 0.01, 0.01]
gyro_noise_rms_rad_s = [0.001, 0.001, 0.001]
"""
TIME_s = np.arange(400) / 200.0


@pytest.mark.nightly
def test_the_square_of_the_speed_is_taken_off_the_readings() -> None:
    machine = machine_from_text(TEXT, label="boom")
    slow, fast = 0.4 * np.sin(3.0 * TIME_s), 0.004 * np.sin(60.0 * TIME_s)
    channels = {
        "time": Channel("s", TIME_s),
        "command_turn": Channel("Nm", np.zeros(400)),
        "position_turn": Channel("rad", slow),
        **{f"imu_{axis}": Channel("m/s^2", np.zeros(400)) for axis in "xyz"},
    }
    trajectory = Trajectory(observed(machine, "swing", Recording(channels, recording_metadata(machine))))
    one = equation_errors(trajectory)
    faster = 0.004 * 60.0 * np.cos(60.0 * TIME_s)
    base = one.base
    motion = Motion(base.position + fast[:, None], base.speed + faster[:, None], base.acceleration, base.speed_deviation)
    taken = (one.left - one.about(motion).left)[:, trajectory.observed.channels.index("imu_x")]
    assert taken == pytest.approx(-RADIUS_m * faster**2, abs=2e-3 * RADIUS_m * np.max(faster**2))
    assert one.about(base).left == pytest.approx(one.left, abs=1e-9, nan_ok=True)
