"""Recordings that no diagnosis can use are refused in a line that says which, where, and what would be right."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from carriage import MACHINE, repeats

from hil.diagnosis.diagnose import diagnose
from hil.errors import RecordingError
from hil.recording import Channel, Recording


@pytest.fixture(scope="module")
def runs() -> dict[str, Recording]:
    return repeats(3, 0.5, coulomb_N=20.0)


def test_copies_are_no_repeats(runs: dict[str, Recording]) -> None:
    one = next(iter(runs.values()))
    with pytest.raises(RecordingError, match=r"holds the same rows as .*; give each recording once"):
        diagnose(MACHINE, {**runs, "copy": one})


def test_a_held_out_copy_is_told_from_another_motion(runs: dict[str, Recording]) -> None:
    one = next(iter(runs.values()))
    with pytest.raises(RecordingError, match=r"which is fitted to; hold out a recording of another motion"):
        diagnose(MACHINE, runs, {"copy": one})


def test_a_reading_that_no_sensor_has_is_no_physics(runs: dict[str, Recording]) -> None:
    def spoilt(recording: Recording) -> Recording:
        position = recording["position_carriage"].copy()
        position[50] = np.inf
        return replace(recording, channels={**recording.channels, "position_carriage": Channel("m", position)})

    with pytest.raises(RecordingError, match=r"position_carriage is inf in row 50 \(0.05 s\); leave a reading empty"):
        diagnose(MACHINE, {label: spoilt(run) for label, run in runs.items()})


def test_without_an_encoder_that_follows_a_joint_nothing_is_known(runs: dict[str, Recording]) -> None:
    blind = {
        label: replace(run, channels={name: channel for name, channel in run.channels.items() if name != "position_carriage"})
        for label, run in runs.items()
    }
    with pytest.raises(RecordingError, match=r"position_carriage"):
        diagnose(MACHINE, blind)
