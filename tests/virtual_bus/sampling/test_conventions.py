"""What the emulated bus samples at a SYNC is what an axis at steps of 20 µs shows there, which was written without it."""

from __future__ import annotations

import pytest
from sampling import CONVENTIONS, COUNTS, compared, emulated, late, with_all_sensors

BUS = ("position_turn", "link_position_turn", "current_turn", "velocity_actual_value")
NOISE = {"imu_x": 0.005, "imu_y": 0.005, "gyro_z": 0.0005}
"""Of the shipped IMU, rms [m/s², rad/s]."""
BY_NAME = {each.name: each for each in CONVENTIONS}
QUICK = "delay of 2.4 rows"
LATER_s = 0.009
"""Of the drive that does not fit: within its first row of delay each shows the same target at a SYNC."""


@pytest.mark.parametrize("name", [QUICK, *(pytest.param(name, marks=pytest.mark.slow) for name in BY_NAME if name != QUICK)])
def test_rows_are_those_of_the_witness_and_of_no_other_drive(name: str) -> None:
    """The zero of an incremental encoder is up to half a count from the joint's."""
    there = emulated(with_all_sensors(), BY_NAME[name].effects)
    found = compared(BY_NAME[name].axis, there)
    assert {name: one["counts"] for name, one in found.items() if name in BUS and one["counts"] >= 1.0} == {}
    # an accelerometer follows a torque that jumps within a plant step of 1 ms
    apart = {name: abs(found[name]["emulated"] - found[name]["witness"]) / noise for name, noise in NOISE.items()}
    assert {name: share for name, share in apart.items() if share >= 0.1} == {}
    other = compared(late(BY_NAME[name].axis.delay_s + LATER_s)[0], there)
    assert set(other) == set(COUNTS)
    assert other["link_position_turn"]["counts"] > 100.0
    if "delay" in name:
        assert other["current_turn"]["counts"] > 10.0
