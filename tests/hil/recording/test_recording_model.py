"""What a recording refuses, and what it derives from its channels and metadata."""

from __future__ import annotations

import numpy as np
import pytest

from hil.errors import RecordingError
from hil.recording import Channel, Recording

EXPERIMENT = {"period_samples": 4, "settle_periods": 1, "start_pose": [0.0, 0.5]}


def recording(
    rows: int = 13, rate_Hz: float = 256.0, metadata: dict[str, dict[str, object]] | None = None, **columns: np.ndarray
) -> Recording:
    channels = {"time": Channel("s", np.arange(rows) / rate_Hz)}
    channels |= {name: Channel("rad", values) for name, values in columns.items()}
    return Recording(channels, {} if metadata is None else metadata)


def test_sample_rate_comes_from_time() -> None:
    assert recording(rows=1000).sample_rate_Hz == 256.0


def test_a_lost_row_has_no_sample_rate_and_is_named() -> None:
    time = np.delete(np.arange(20) / 256.0, 7)
    with pytest.raises(RecordingError, match="between rows 6 and 7"):
        _ = Recording({"time": Channel("s", time)}, {}).sample_rate_Hz


def test_clock_jitter_of_a_real_recorder_is_equal_sampling() -> None:
    time = np.arange(2000) * 1e-3 + np.random.default_rng(1).uniform(-3e-8, 3e-8, 2000)
    assert Recording({"time": Channel("s", time)}, {}).sample_rate_Hz == pytest.approx(1000.0, abs=1e-3)


def test_periods_leave_out_settling_and_the_unfinished_rest() -> None:
    parts = recording(rows=15, metadata={"experiment": EXPERIMENT}, position_roll=np.arange(15.0)).periods()
    assert [part["position_roll"].tolist() for part in parts] == [[4, 5, 6, 7], [8, 9, 10, 11]]
    assert parts[1].time[0] == 8 / 256.0


def test_in_periods_stacks_one_row_per_period() -> None:
    values = recording(rows=12, metadata={"experiment": EXPERIMENT}, position_roll=np.arange(12.0)).in_periods("position_roll")
    np.testing.assert_array_equal(values, [[4, 5, 6, 7], [8, 9, 10, 11]])


@pytest.mark.parametrize("experiment", [{}, {"period_samples": 0}, {"period_samples": 10, "settle_periods": 1}, {"period_samples": "4"}])
def test_no_period_is_said_in_one_line(experiment: dict[str, int | str]) -> None:
    with pytest.raises(RecordingError, match=r"^[^\n]*period[^\n]*$"):
        recording(metadata={"experiment": experiment}).periods()


def repeat(
    machine_hash: str = "m", pose: tuple[float, float] = (0.0, 0.5), excitation: float = 1.0, position: float = 0.0, rows: int = 5
) -> Recording:
    metadata = {"machine": {"hash": machine_hash}, "experiment": {"start_pose": list(pose)}}
    return Recording(
        {
            "time": Channel("s", np.arange(rows) / 256.0),
            "reference_roll": Channel("rad", np.zeros(rows)),
            "excitation_roll": Channel("A", np.full(rows, excitation)),
            "position_roll": Channel("rad", np.full(rows, position)),
        },
        metadata,
    )


def test_what_was_measured_does_not_make_recordings_different_experiments() -> None:
    assert repeat(position=0.0).repeats(repeat(position=1.0))


@pytest.mark.parametrize("other", [{"machine_hash": "n"}, {"pose": (0.0, 0.6)}, {"excitation": 1.1}, {"rows": 6}])
def test_another_machine_pose_excitation_or_length_is_no_repeat(other: dict[str, float | str | tuple[float, float]]) -> None:
    assert not repeat().repeats(repeat(**other))


def test_recordings_of_unknown_machines_are_never_repeats() -> None:
    assert not repeat(machine_hash="").repeats(repeat(machine_hash=""))


def test_axes_are_the_machines_or_those_with_a_position() -> None:
    assert recording(position_roll=np.zeros(13), reference_raw_roll=np.zeros(13)).axes == ("roll",)
    assert recording(metadata={"machine": {"axes": ["propeller", "roll"]}}).axes == ("propeller", "roll")


def test_values_are_kept_in_si() -> None:
    degrees = Recording({"time": Channel("ms", [0.0, 4.0]), "position_roll": Channel("deg", [180.0, np.nan])}, {})
    assert degrees.channels["position_roll"].unit == "rad"
    np.testing.assert_allclose(degrees["position_roll"], [np.pi, np.nan])
    np.testing.assert_allclose(degrees.time, [0.0, 0.004])


@pytest.mark.parametrize(
    ("channels", "message"),
    [
        ({"position_roll": Channel("rad", [0.0])}, "no channel `time"),
        ({"time": Channel("s", [0.0, np.nan])}, "time is missing in row 1"),
        ({"time": Channel("s", [0.0, 0.0])}, "time does not increase"),
        ({"time": Channel("s", [0.0, 1.0]), "x": Channel("", [1.0])}, "channel x: shape"),
        ({"time": Channel("s", [0.0]), "position_roll": Channel("furlong", [1.0])}, r"unknown unit \[furlong\]; \[rad\]"),
        ({"time": Channel("s", [0.0]), "position_roll": Channel("", [1.0])}, "no unit"),
        ({"time": Channel("s", [0.0]), "current_roll": Channel("V", [1.0])}, r"unknown unit \[V\]"),
        ({"time": Channel("s", [0.0]), "a,b": Channel("", [1.0])}, "printable text"),
    ],
)
def test_a_recording_that_is_none_is_refused_in_one_line(channels: dict[str, Channel], message: str) -> None:
    with pytest.raises(RecordingError, match=message) as refusal:
        Recording(channels, {})
    assert "\n" not in str(refusal.value)


def test_metadata_that_toml_cannot_hold_is_refused_by_its_place() -> None:
    with pytest.raises(RecordingError, match=r"metadata\.experiment\.seed"):
        recording(metadata={"experiment": {"seed": object()}})


def test_a_missing_channel_is_answered_with_the_closest() -> None:
    with pytest.raises(RecordingError, match="did you mean position_roll"):
        _ = recording(position_roll=np.zeros(13))["positon_roll"]


def test_values_cannot_be_changed_behind_a_recording() -> None:
    source = np.zeros(13)
    made = recording(position_roll=source)
    source[0] = 1.0
    assert made["position_roll"][0] == 0.0
    with pytest.raises(ValueError, match="read-only"):
        made["position_roll"][0] = 2.0
