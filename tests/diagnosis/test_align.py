"""Recordings on equal rows; units, signs and delays pointed out."""

from __future__ import annotations

import numpy as np
import pytest

from hil.diagnosis.align import aligned, suspicions
from hil.diagnosis.mismatch import mismatch
from hil.machine import load_machine
from hil.recording import Channel, Recording, RecordingWarning, recording_metadata
from hil.simulation import simulate

MOTOR = load_machine("laas_anti_cogging")
ROWS = 2000
TIME = np.arange(ROWS) / MOTOR.sample_rate_Hz
COMMAND = 0.3 * np.sin(2.0 * np.pi * 3.0 * TIME)


def recording(time, **columns) -> Recording:
    units = {"command_rotor": "A", "position_rotor": "rad", "speed_rotor": "rad/s"}
    channels = {"time": Channel("s", time)} | {name: Channel(units[name], values) for name, values in columns.items()}
    return Recording(channels, recording_metadata(MOTOR))


def test_unequal_rows_are_put_on_the_machines_own():
    uneven = np.delete(TIME, [100, 101, 700])
    held = recording(uneven, command_rotor=np.floor(20.0 * uneven), position_rotor=np.sin(3.0 * uneven))
    with pytest.warns(RecordingWarning, match=r"rec: rows are not equally spaced.*resampled to 1000 Hz"):
        even = aligned(MOTOR, {"rec": held})["rec"]
    assert even.sample_rate_Hz == pytest.approx(1000.0) and even.rows == ROWS
    assert np.abs(even["position_rotor"] - np.sin(3.0 * even.time)).max() < 2e-5
    assert set(np.unique(even["command_rotor"])) <= set(np.floor(20.0 * uneven))  # held, not interpolated


def test_nothing_is_invented_across_a_long_gap():
    gap = np.delete(TIME, np.arange(300, 340))
    with pytest.warns(RecordingWarning):
        even = aligned(MOTOR, {"rec": recording(gap, command_rotor=np.zeros(len(gap)), position_rotor=gap)})["rec"]
    assert np.isnan(even["position_rotor"][305:335]).all() and np.isfinite(even["position_rotor"][345:]).all()


def test_another_rate_is_resampled():
    slow = np.arange(400) / 500.0
    with pytest.warns(RecordingWarning, match="500 rows a second"):
        assert aligned(MOTOR, {"rec": recording(slow, command_rotor=slow, position_rotor=slow)})["rec"].rows == 799


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda x: -x, "runs against its simulation"),
        (np.degrees, "degrees for radians"),
        (lambda x: np.concatenate([np.zeros(12), x[:-12]]), " 12 ms later"),
        (lambda x: np.concatenate([x[12:], np.zeros(12)]), " 12 ms earlier"),
    ],
)
def test_wrong_signs_units_and_delays_are_pointed_out(change, said):
    clean = simulate(MOTOR, recording(TIME, command_rotor=COMMAND))
    wrong = recording(TIME, command_rotor=COMMAND, position_rotor=change(clean["position_rotor"]), speed_rotor=clean["speed_rotor"])
    found = suspicions(mismatch(MOTOR, {"rec": wrong}))
    assert any(said in sentence and sentence.startswith("position_rotor") for sentence in found)
    assert not any(sentence.startswith("speed_rotor") for sentence in found)
