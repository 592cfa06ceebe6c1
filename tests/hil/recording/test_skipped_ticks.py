"""Ticks that a run skipped are gaps in its time: every reader says so in one line, and keeps rows and ticks apart."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pytest

from hil.errors import RecordingError
from hil.machine import load_machine
from hil.recording import Channel, Recording, RecordingWarning, read_recording, write_recording
from hil.recording.ticks import on_every_tick
from hil.simulation import simulate

RATE_HZ, PERIOD, PERIODS = 256.0, 8, 5
EVERY = np.arange(PERIOD * PERIODS)
SKIPPED = (11, 12, 30)
TICKS = np.delete(EVERY, SKIPPED)


def excitation(ticks: np.ndarray) -> np.ndarray:
    return np.random.default_rng(3).standard_normal(PERIOD)[ticks % PERIOD]


def run(**tables: object) -> Recording:
    """Five periods of a run that lost three ticks."""
    channels = {
        "time": Channel("s", TICKS / RATE_HZ),
        "reference_roll": Channel("rad", 0.1 + 0.01 * TICKS),
        "excitation_roll": Channel("A", excitation(TICKS)),
        "position_roll": Channel("rad", TICKS.astype(float)),
    }
    experiment = {"period_samples": PERIOD, "settle_periods": 1}
    return Recording(channels, {"experiment": experiment, "bench": {"bus": "socketcan:can0"}, **tables})


def test_rate_and_ticks_come_from_time() -> None:
    recording = run()
    assert recording.sample_rate_Hz == RATE_HZ
    np.testing.assert_array_equal(recording.ticks, TICKS)


def test_a_period_with_a_gap_is_none() -> None:
    """Of ticks 8 to 39 the periods from 8 and from 24 have one."""
    np.testing.assert_array_equal(run().in_periods("position_roll"), [range(16, 24), range(32, 40)])


def test_every_tick_has_its_plan_and_what_was_measured_is_not_invented() -> None:
    whole = on_every_tick(run())
    assert whole.time == pytest.approx(EVERY / RATE_HZ)
    assert whole["reference_roll"] == pytest.approx(0.1 + 0.01 * EVERY)
    np.testing.assert_array_equal(whole["excitation_roll"], excitation(EVERY))
    np.testing.assert_array_equal(np.flatnonzero(np.isnan(whole["position_roll"])), SKIPPED)


def test_a_recording_without_gaps_is_left_as_it_is() -> None:
    recording = run().part(slice(0, 11))
    assert on_every_tick(recording) is recording


@pytest.mark.parametrize("suffix", [".mf4", ".csv"])
def test_whoever_reads_it_is_told_in_one_line(tmp_path: Path, suffix: str) -> None:
    write_recording(run(), tmp_path / f"run{suffix}")
    with pytest.warns(
        RecordingWarning, match=r"run\.(mf4|csv): 3 ticks are missing in 2 places, first after row 10 \(0\.0390625 s\)[^\n]*$"
    ):
        recording = read_recording(tmp_path / f"run{suffix}")
    np.testing.assert_array_equal(recording.ticks, TICKS)
    write_recording(run().part(slice(0, 11)), tmp_path / f"whole{suffix}")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        read_recording(tmp_path / f"whole{suffix}")


def test_rows_that_are_missing_elsewhere_are_refused_as_ever() -> None:
    recording = Recording({"time": Channel("s", TICKS / RATE_HZ)}, {})
    with pytest.raises(RecordingError, match="rows are not equally spaced"):
        _ = recording.sample_rate_Hz


def test_a_simulation_runs_over_the_gap_and_has_the_rows_there_are() -> None:
    machine = load_machine("carm")
    reference = 0.1 * (1.0 - np.cos(2.0 * np.pi * EVERY / 400.0))
    channels = {"time": Channel("s", EVERY / RATE_HZ)}
    for axis in machine.axes:
        channels[f"reference_{axis}"] = Channel("rad", reference)
        channels[f"excitation_{axis}"] = Channel("A", excitation(EVERY))
    experiment = {"period_samples": PERIOD, "settle_periods": 0}
    whole = Recording(channels, {"experiment": experiment, "bench": {"bus": "lockstep:"}})
    full = simulate(machine, whole)
    partly = simulate(machine, whole.part(TICKS))
    np.testing.assert_array_equal(partly.time, whole.time[TICKS])
    assert partly["position_roll"] == pytest.approx(full["position_roll"][TICKS], abs=1e-5)
    assert np.ptp(full["position_roll"]) > 1e-3
