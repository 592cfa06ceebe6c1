"""A second IMU that is a node of the CAN bus: recorded beside the one on the serial line, and refused where the file says it wrongly."""

from __future__ import annotations

import warnings

import numpy as np
import pytest

import hil
from hil.errors import MachineFileError
from hil.machine import load_machine, machine_from_text

TEXT = load_machine("carm-real").text.split("# ---- what makes it hard")[0].replace("effort_A = 2.2", "effort_A = 0.3")
NODE = TEXT[TEXT.index("[bus.nodes.source_imu]") : TEXT.index("[bus.homing.propeller]")]


@pytest.fixture(scope="module")
def recording() -> hil.Recording:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", hil.RecordingWarning)
        return hil.open_machine(machine_from_text(TEXT)).run(hil.Static(1.0), bus="lockstep:")  # type: ignore[return-value]


def test_each_row_has_the_sample_of_its_sync(recording: hil.Recording) -> None:
    counter = recording["imu_source_counter"]
    assert not np.isnan(counter).any()
    np.testing.assert_array_equal(np.diff(counter) % 65536, 1)
    np.testing.assert_allclose(recording["imu_source_time"], recording.time, rtol=0, atol=1e-12)


def test_its_readings_are_those_of_the_physics(recording: hil.Recording) -> None:
    simulated = hil.simulate(hil.open_machine(machine_from_text(TEXT)), recording)
    for name, noise in (("imu_source", 0.005), ("gyro_source", 0.0005)):
        for axis in "xyz":
            left = recording[f"{name}_{axis}"] - simulated[f"{name}_{axis}"]
            assert abs(left.mean()) < 5.0 * noise / np.sqrt(len(left)) + 0.0006 * (name == "imu_source") + 0.00006
            assert 0.8 * noise < left.std() < 1.2 * noise
    assert recording["imu_source_z"].mean() > 9.5
    assert abs(recording["imu_source_x"].mean()) < 0.2


@pytest.mark.parametrize(
    ("was", "now", "says"),
    [
        ('sensor = "imu_source"', "", r"source_imu\.sensor: is missing; there is imu, imu_source"),
        ('sensor = "imu_source"', 'sensor = "imu"', r"is on the serial line \(\[bus\.imu\]\) already"),
        ('"sample_counter"]', "]", r"sample_counter is mapped nowhere; an IMU needs it in a TPDO"),
        (NODE, NODE + NODE.replace("source_imu", "other_imu").replace("= 21", "= 22").replace("0x195", "0x196").replace("0x295", "0x296"),
         r"there is the IMU other_imu already; one on the bus is supported"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_told_in_one_line(was: str, now: str, says: str) -> None:
    with pytest.raises(MachineFileError, match=says):
        machine_from_text(TEXT.replace(was, now))
