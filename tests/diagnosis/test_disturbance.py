"""The effort a simulation lacks, against efforts that were put on a mass in closed form."""

from __future__ import annotations

import numpy as np
import pytest
from pushed_mass import pushed_mass

from hil.diagnosis.disturbance import disturbance
from hil.diagnosis.mismatch import mismatch
from hil.machine import load_machine
from hil.recording import Channel, Recording, recording_metadata

MACHINE = load_machine("emps")
PERIOD_s = 1.0 / MACHINE.sample_rate_Hz
ROWS = 6000
TIME = np.arange(ROWS) * PERIOD_s
REFERENCE = 0.1 - 0.1 * np.cos(2.0 * np.pi * 0.5 * TIME)


@pytest.fixture(scope="module")
def seen():
    """A push of 30 N up and down a slow sine, in three noisy repeats."""
    position, command = pushed_mass(REFERENCE, lambda time, speed: 30.0 * np.sin(2.0 * np.pi * 0.8 * time))
    still = Channel("V", np.zeros(ROWS))
    recordings = {}
    for number in range(3):
        random = np.random.default_rng(number)
        channels = {
            "time": Channel("s", TIME),
            "reference_carriage": Channel("m", REFERENCE),
            "excitation_carriage": still,
            "command_carriage": Channel("V", command + 0.01 * random.standard_normal(ROWS)),
            "position_carriage": Channel("m", position + 1e-7 * random.standard_normal(ROWS)),
        }
        recordings[f"repeat {number}"] = Recording(channels, recording_metadata(MACHINE, experiment={"start_pose": [0.0]}))
    return mismatch(MACHINE, recordings)


def test_the_missing_effort_is_the_push(seen):
    found = disturbance(seen, seen.groups[0])
    inner = slice(300, -300)
    shapes = np.column_stack([np.sin(2.0 * np.pi * 0.8 * TIME), np.cos(2.0 * np.pi * 0.8 * TIME), np.ones(ROWS)])[inner]
    (along, across, constant), rest, *_ = np.linalg.lstsq(shapes, found.effort[inner, 0])
    assert found.joints == ("carriage",)
    assert (along, across, constant) == (pytest.approx(30.0, rel=0.03), pytest.approx(0.0, abs=1.0), pytest.approx(0.0, abs=1.0))
    assert np.sqrt(rest[0] / len(shapes)) < 3.0
    assert found.joint_share[0] > 0.99


def test_nothing_is_left_for_the_sensors(seen):
    assert disturbance(seen, seen.groups[0]).sensor_share.max() < 0.05
