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
    assert "still" in comparison.table()


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


def periodic(values: np.ndarray, period: int = 512, settle: int = 1) -> Recording:
    """A recording of one channel that says its periods."""
    return recording(position_roll=("rad", values)).with_metadata(experiment={"period_samples": period, "settle_periods": settle})


def test_a_perfect_simulation_is_told_to_be_one() -> None:
    assert compare(recording(position_roll=("rad", SINE)), recording(position_roll=("rad", SINE))).verdict == (
        "The simulation equals the recording in every value of 1 channel."
    )
    noisy = compare(recording(position_roll=("rad", SINE + 1e-3 * NOISE)), recording(position_roll=("rad", SINE)))
    assert noisy.agrees
    assert noisy.verdict.startswith("The simulation agrees with the recording: none of 1 channel differs by more than twice its noise")
    assert "noise: assumed, from each channel's roughness" in noisy.table()


def test_a_channel_that_does_no_more_than_its_noise_stands_still_and_is_divided_by_nothing() -> None:
    """Rounded encoder counts about a pose, held against a simulation without noise."""
    counts = 1e-6 * np.rint(2.0 * NOISE)
    comparison = compare(recording(position_roll=("rad", 0.5 + counts)), recording(position_roll=("rad", np.full(ROWS, 0.5))))
    channel = comparison["position_roll"]
    assert channel.still
    assert np.isnan(channel.nrmse)
    assert channel.in_noise == pytest.approx(1.0, abs=0.05)  # of two counts
    assert "still" in comparison.table()


@pytest.mark.parametrize("times", [3.0, 30.0])
def test_a_difference_is_counted_in_the_noise_that_periods_show(times: float) -> None:
    wave = np.tile(np.sin(2.0 * np.pi * np.arange(512) / 512.0), 8)
    error = times * 1e-3 * np.sqrt(2.0) * np.cos(2.0 * np.pi * 3.0 * np.arange(ROWS) / 512.0)
    comparison = compare(periodic(wave + 1e-3 * NOISE), periodic(wave + error))
    channel = comparison["position_roll"]
    assert comparison.noise.source == "periods"
    assert channel.noise == pytest.approx(1e-3, rel=0.05)
    assert channel.in_noise == pytest.approx(np.hypot(times, 1.0), rel=0.05)
    assert not comparison.agrees
    assert f"by {channel.rms:.3g} rad rms" in comparison.verdict
    assert "noise: from 7 periods" in comparison.table()


def test_repeats_show_the_noise_and_another_experiment_is_refused() -> None:
    rng = np.random.default_rng(1)
    machine = {"machine": {"hash": "a", "axes": ["roll"]}}
    inputs = {"reference_roll": ("rad", SINE)}
    one, two, three = (
        recording(position_roll=("rad", SINE + 2e-3 * rng.standard_normal(ROWS)), **inputs).with_metadata(**machine) for _ in range(3)
    )
    comparison = compare(one, recording(position_roll=("rad", SINE)), [two, three])
    assert comparison.noise.source == "repeats"
    assert comparison["position_roll"].noise == pytest.approx(2e-3, rel=0.05)
    with pytest.raises(RecordingError, match="repeat 1 is another experiment"):
        compare(one, recording(position_roll=("rad", SINE)), [recording(position_roll=("rad", SINE))])


@pytest.mark.parametrize("wrong", [0.8 * NOISE, np.roll(NOISE, 1)], ids=["gain", "delay"])
def test_a_rough_signal_that_follows_the_simulation_is_no_noise(wrong: np.ndarray) -> None:
    """An acceleration under broad excitation is as rough as noise; a wrong gain or delay in it must show all the same."""
    assert not compare(recording(imu_x=("m/s^2", wrong)), recording(imu_x=("m/s^2", NOISE))).agrees


def test_rounding_of_a_sensor_is_noise() -> None:
    step = 1e-2
    channel = compared(step * np.rint(SINE / step), SINE)
    assert channel.agrees
    assert channel.noise == pytest.approx(2.0 * step, rel=0.01)  # a position is known to two counts
    current = compared(step * np.rint(SINE / step), SINE, "A", "current_roll")
    assert current.agrees
    assert current.noise == pytest.approx(step / np.sqrt(12.0), rel=0.3)


def test_the_zero_that_homing_set_is_no_difference_but_a_link_that_drifts_from_its_motor_is() -> None:
    motor = {"position_roll": ("rad", SINE)}
    apart = compare(recording(**motor, link_position_roll=("rad", SINE + 0.5)), recording(**motor, link_position_roll=("rad", SINE)))
    assert apart["link_position_roll"].rms == pytest.approx(0.0, abs=1e-12)
    drifting = SINE + np.linspace(0.0, 0.5, len(SINE))
    assert not compare(
        recording(**motor, link_position_roll=("rad", drifting)), recording(**motor, link_position_roll=("rad", SINE))
    ).agrees
    alone = compared(SINE + 0.5, SINE, name="link_position_roll")
    assert alone.rms == pytest.approx(0.5)
    assert not alone.agrees


def test_the_table_fits_a_hundred_columns() -> None:
    comparison = compare(
        recording(link_position_propeller=("rad", SINE), imu_y=("m/s^2", NOISE)),
        recording(link_position_propeller=("rad", 0.3 * np.roll(SINE, 3)), imu_y=("m/s^2", 0.0 * NOISE)),
    )
    assert max(map(len, comparison.table().splitlines())) <= 100
