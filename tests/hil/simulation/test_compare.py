"""What `compare` says about differences whose size is known."""

from __future__ import annotations

import json

import numpy as np
import pytest

from hil.errors import RecordingError
from hil.recording import Channel, Recording
from hil.simulation import ChannelComparison, compare

ROWS = 4096
TIME_S = np.arange(ROWS) / 256.0
SINE = np.sin(2.0 * np.pi * 0.5 * TIME_S)
NOISE = np.random.default_rng(0).standard_normal(ROWS)


def recording(**channels: tuple[str, np.ndarray]) -> Recording:
    return Recording({"time": Channel("s", TIME_S), **{name: Channel(unit, values) for name, (unit, values) in channels.items()}}, {})


def compared(recorded: np.ndarray, simulated: np.ndarray, unit: str = "rad", name: str = "position_roll") -> ChannelComparison:
    return compare(recording(**{name: (unit, recorded)}), recording(**{name: (unit, simulated)}))[name]


def test_equal_channels_do_not_differ() -> None:
    result = compared(SINE, SINE)
    assert (result.rms, result.largest, result.nrmse, result.lag_rows) == (0.0, 0.0, 0.0, 0)


def test_a_scaled_sine_differs_by_the_scale_whatever_its_mean() -> None:
    result = compared(SINE + 5.0, 0.9 * SINE + 5.0)
    assert result.rms == pytest.approx(0.1 / np.sqrt(2.0), rel=1e-3)
    assert result.largest == pytest.approx(0.1, rel=1e-3)
    assert result.nrmse == pytest.approx(0.1, rel=1e-3)


def test_an_offset_is_a_difference() -> None:
    assert compared(SINE, SINE + 0.2).nrmse == pytest.approx(0.2 * np.sqrt(2.0), rel=1e-3)


def test_units_are_carried_along() -> None:
    assert compared(SINE, SINE, "A", "current_roll").unit == "A"


@pytest.mark.parametrize("lag", [-3, -1, 1, 2])
def test_a_recording_that_is_late_by_rows_is_found(lag: int) -> None:
    assert compared(np.roll(NOISE, lag), NOISE).lag_rows == lag


def test_a_wrong_model_without_delay_has_no_lag() -> None:
    assert compared(SINE, 0.8 * SINE).lag_rows == 0


def test_rows_without_a_sample_are_left_out() -> None:
    holed = SINE.copy()
    holed[100:200] = np.nan
    result = compared(holed, SINE + 0.1)
    assert result.rows == ROWS - 100
    assert result.rms == pytest.approx(0.1)


def test_a_channel_at_rest_has_no_nrmse_and_json_says_null() -> None:
    comparison = compare(recording(position_roll=("rad", np.full(ROWS, 24.1))), recording(position_roll=("rad", np.full(ROWS, 24.2))))
    assert np.isnan(comparison["position_roll"].nrmse)
    document = json.loads(json.dumps(comparison.document(), allow_nan=False))
    assert document["channels"]["position_roll"]["nrmse"] is None
    assert document["channels"]["position_roll"]["rms"] == pytest.approx(0.1)
    assert "n/a" in comparison.table()


def test_inputs_are_not_compared_and_lonely_channels_are_named() -> None:
    measured = recording(position_roll=("rad", SINE), reference_roll=("rad", SINE), statusword_roll=("", NOISE * 0.0))
    simulated = recording(position_roll=("rad", SINE), reference_roll=("rad", SINE))
    comparison = compare(measured, simulated)
    assert [channel.name for channel in comparison.channels] == ["position_roll"]
    assert comparison.only_recorded == ("statusword_roll",)


def test_recordings_that_do_not_belong_together_are_refused() -> None:
    with pytest.raises(RecordingError, match="4096 rows recorded, 3000 simulated"):
        compare(recording(position_roll=("rad", SINE)), recording(position_roll=("rad", SINE)).part(slice(0, 3000)))
    with pytest.raises(RecordingError, match="no channel in common"):
        compare(recording(position_roll=("rad", SINE)), recording(position_propeller=("rad", SINE)))
    with pytest.raises(RecordingError, match=r"recorded in \[m\], simulated in \[rad\]"):
        compare(recording(position_x=("m", SINE)), recording(position_x=("rad", SINE)))
    slow = Recording({"time": Channel("s", TIME_S * 2.0), "position_roll": Channel("rad", SINE)}, {})
    with pytest.raises(RecordingError, match="times differ"):
        compare(recording(position_roll=("rad", SINE)), slow)
