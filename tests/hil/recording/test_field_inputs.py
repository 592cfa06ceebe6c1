"""Inputs of the kinds that people bring, which lie beside the repository: each converts with a machine file, as its note says."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pytest
from places import DATA, needs_data

from hil.errors import RecordingError
from hil.machine import Machine, load_machine
from hil.recording import Recording, RecordingWarning, read_recording

FIELD = DATA / "field"
pytestmark = needs_data("field", "inputs as people bring them are")


@pytest.fixture(scope="module")
def turntable() -> Machine:
    return load_machine(FIELD / "work" / "turntable.toml")


def quietly(path: Path, machine: Machine, names: dict[str, str] | None = None) -> Recording:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RecordingWarning)
        return read_recording(path, machine, names)


CAN_LOGS = ["05-asc-busmaster/trace.asc", "06-trc-pcan-rtr/trace.trc", "07-candump-console/dump.log", "07-candump-console/zero.log"]


@pytest.mark.parametrize("name", CAN_LOGS)
def test_the_same_frames_in_every_log_are_the_same_recording(turntable: Machine, name: str) -> None:
    recording, first = quietly(FIELD / name, turntable), quietly(FIELD / CAN_LOGS[0], turntable)
    assert recording.rows == 400
    for channel in ("time", "current_turn", "position_turn", "link_position_turn", "command_turn"):
        np.testing.assert_allclose(recording[channel], first[channel], atol=1e-12)


def test_two_rasters_come_onto_the_machines_rows(turntable: Machine) -> None:
    recording = quietly(FIELD / "02-mf4-two-rasters" / "two_rasters.mf4", turntable)
    assert (recording.rows, recording.sample_rate_Hz) == (1600, 200.0)
    assert np.isfinite(recording["position_turn"][1:-2]).all()


def test_joint_states_are_position_and_current(turntable: Machine) -> None:
    recording = quietly(FIELD / "14-rosbag-joint-states" / "bag" / "bag.mcap", turntable)
    assert recording.rows == 1600
    assert {"position_turn", "current_turn"} <= set(recording.channels)


def test_structures_and_matrices_are_mapped_or_refused_with_the_right_names(turntable: Machine) -> None:
    scope = {"tout": "time", "ScopeData.signals.values": "position_turn"}
    assert quietly(FIELD / "15-mat-structs" / "scope.mat", turntable, scope).rows == 1600
    with pytest.raises(RecordingError, match=r"log\(1,:\); log\(2,:\)"):
        quietly(FIELD / "15-mat-structs" / "mat2d.mat", turntable, {"log": "time"})
    columns = {"log(1,:)": "time", "log(3,:)": "position_turn"}
    assert quietly(FIELD / "15-mat-structs" / "mat2d.mat", turntable, columns).rows == 1600
