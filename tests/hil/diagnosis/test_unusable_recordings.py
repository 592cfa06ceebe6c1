"""Recordings that no diagnosis can use are refused in a line that says which, where, and what would be right."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from carriage import MACHINE, repeats

from hil.diagnosis.diagnose import diagnose
from hil.diagnosis.residuals.mismatch import mismatch
from hil.errors import RecordingError
from hil.recording import Channel, RecordingWarning


def with_reading(recording, value: float):
    position = recording["position_carriage"].copy()
    position[50] = value
    return replace(recording, channels={**recording.channels, "position_carriage": Channel("m", position)})


def cut(recording, rows: int):
    return replace(recording, channels={name: Channel(c.unit, c.values[:rows]) for name, c in recording.channels.items()})


@pytest.fixture(scope="module")
def runs():
    return repeats(3, 0.5, coulomb_N=20.0)


@pytest.mark.parametrize("value", [np.inf, -np.inf, 1e200])
def test_what_no_sensor_reads_is_refused_with_its_row(runs, value):
    spoilt = {label: with_reading(run, value) for label, run in runs.items()}
    with pytest.raises(RecordingError, match=r"position_carriage is .* in row 50; leave a reading empty"):
        diagnose(MACHINE, spoilt)


def test_a_record_of_fewer_rows_than_the_noise_s_filter_leaves_is_refused(runs):
    short = {label: cut(run, 6) for label, run in runs.items()}
    with pytest.raises(RecordingError, match=r"6 rows; 12 at least"):
        diagnose(MACHINE, short)
    with pytest.raises(RecordingError, match=r"6 rows; 12 at least"):
        diagnose(MACHINE, runs, short)


def test_a_record_of_one_row_is_refused_by_its_name(runs):
    label, one = next(iter(runs.items()))
    with pytest.raises(RecordingError, match=rf"{label}: 1 rows have no sample rate"):
        diagnose(MACHINE, runs | {label: cut(one, 1)})


def test_copies_are_no_repeats(runs):
    label, one = next(iter(runs.items()))
    with pytest.raises(RecordingError, match=r"the same to the last digit.*not copies of one"):
        diagnose(MACHINE, {label: one, "copy": one, "another": one})


def test_a_channel_that_one_recording_lacks_is_said_to_be_left_out(runs):
    label, one = next(iter(runs.items()))
    lacking = replace(one, channels={name: channel for name, channel in one.channels.items() if name != "position_carriage"})
    with pytest.warns(RecordingWarning, match=rf"{label}: no position_carriage, .* left out"):
        found = mismatch(MACHINE, runs | {label: lacking})
    assert found.channels == ("command_carriage",)
