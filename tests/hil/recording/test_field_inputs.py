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


@pytest.fixture(scope="module")
def bench() -> Machine:
    return load_machine(FIELD / "common" / "turntable.toml")


def swing(rows: int) -> np.ndarray:
    """What the turntable did: 3 degrees at 0.5 Hz, 200 rows a second."""
    angle: np.ndarray = np.radians(3.0) * (1.0 - np.cos(np.pi * np.arange(rows) * 0.005)) / 2.0
    return angle


def said(path: Path, machine: Machine, names: dict[str, str] | None = None) -> tuple[Recording, str]:
    """Return the recording and what was warned of."""
    with pytest.warns(RecordingWarning) as caught:
        recording = read_recording(path, machine, names)
    return recording, " ".join(str(one.message) for one in caught)


def test_a_bag_whose_clock_was_set_back_is_put_right_and_said(bench: Machine) -> None:
    recording, words = said(FIELD / "37-bag-clock-step" / "bag.mcap", bench)
    np.testing.assert_allclose(recording["position_turn"], swing(500), atol=1e-12)
    np.testing.assert_allclose(np.diff(recording.time), 0.005, atol=1e-9)
    assert "set back by 0.7325 s at message 300" in words


def test_a_reading_that_is_a_text_is_missing_and_said(bench: Machine) -> None:
    names = {"RefPos": "reference_turn", "ActPos": "position_turn", "Iq": "current_turn"}
    recording, words = said(FIELD / "36d-mf4-position-with-table" / "rec.mf4", bench, names)
    assert np.flatnonzero(np.isnan(recording["position_turn"])).tolist() == [120]
    assert "ActPos: 1 of 400 readings are texts and missing as numbers: 'fault' (1), first sample 120" in words


def test_revolutions_are_read(bench: Machine) -> None:
    names = {"timestamp": "time", "controller.position": "position_turn", "controller.q_current": "current_turn"}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RecordingWarning)
        recording = read_recording(FIELD / "38-csv-revolutions" / "log.csv", bench, names)
    assert recording.rows == 400
    assert np.ptp(recording["position_turn"]) > 0.05


def test_a_log_in_german_with_lin_and_statistics_is_read_and_counted(bench: Machine) -> None:
    recording, words = said(FIELD / "34-asc-german-dec" / "trace.asc", bench)
    np.testing.assert_allclose(recording["position_turn"], swing(300), atol=2e-5)
    assert "4 error frames; 3 transmit requests; 20 lines that are no frames" in words


def test_a_cut_bag_names_what_makes_it_whole(bench: Machine) -> None:
    with pytest.raises(RecordingError, match="mcap recover"):
        read_recording(FIELD / "35-mcap-cut" / "bag.mcap", bench)
