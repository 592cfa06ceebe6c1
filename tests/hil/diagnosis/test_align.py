"""Recordings on equal rows."""

from __future__ import annotations

import numpy as np
import pytest

from hil.diagnosis.recorded.align import aligned, resampled
from hil.machine import load_machine
from hil.recording import Channel, Recording, RecordingWarning, recording_metadata

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
    ("stamps", "rate_Hz"),
    [
        (TIME / 0.9999, 1000.0),  # a clock of 999.9 Hz
        (np.round(np.arange(ROWS) / 256.0, 6), 256.0),  # to the microsecond
        (TIME + np.random.default_rng(1).uniform(-4e-4, 4e-4, ROWS), 1000.0),
    ],
)
def test_an_input_stays_with_its_tick_however_late_its_row_is_stamped(stamps, rate_Hz):
    kept = np.delete(np.arange(ROWS), [100, 700])
    held = resampled(recording(stamps[kept], command_rotor=1.0 * kept), rate_Hz)["command_rotor"]
    expected = np.arange(ROWS)[: len(held)]
    expected[[100, 700]] -= 1  # lost: the row before holds
    np.testing.assert_array_equal(held, expected)


@pytest.mark.parametrize("rate_Hz", [400.0, 500.0, 1000.0, 2000.0, 5000.0])
def test_at_another_rate_a_sample_has_the_input_in_force_when_it_begins(rate_Hz):
    command = np.arange(800)
    found = resampled(recording(command / rate_Hz, command_rotor=command), 1000.0)["command_rotor"]
    np.testing.assert_array_equal(found, np.floor(np.arange(len(found)) * rate_Hz / 1000.0 + 1e-9))


def with_reference(time: np.ndarray, gaps_s: tuple[float, float] = (0.0, 0.0)) -> Recording:
    kept = (time < gaps_s[0]) | (time >= gaps_s[1])
    columns = {"time": ("s", time), "reference_carriage": ("m", 0.3 * np.sin(3.0 * time))}
    columns |= {"feedforward_carriage": ("V", np.cos(3.0 * time)), "excitation_carriage": ("V", np.arange(len(time)) % 2.0)}
    return Recording({name: Channel(unit, values[kept]) for name, (unit, values) in columns.items()}, {})


@pytest.mark.parametrize("rate_Hz", [100.0, 133.0, 200.0, 333.0, 400.0])
def test_a_reference_is_taken_between_rows_at_any_rate(rate_Hz):
    """It is no channel that is held: half a row late, a closed loop would follow another motion."""
    even = resampled(with_reference(np.arange(int(4.0 * rate_Hz)) / rate_Hz), 200.0)
    assert np.abs(even["reference_carriage"] - 0.3 * np.sin(3.0 * even.time)).max() < 0.3 * 9.0 / 8.0 / rate_Hz**2 * 1.01
    assert np.abs(even["feedforward_carriage"] - np.cos(3.0 * even.time)).max() < 9.0 / 8.0 / rate_Hz**2 * 1.01


def test_a_reference_is_whole_across_a_gap_in_which_nothing_was_measured():
    time = np.arange(800) / 200.0
    even = resampled(with_reference(time, (1.0, 1.2)), 200.0)
    assert even.rows == 800 and np.isfinite(even["reference_carriage"]).all()
    assert np.abs(even["reference_carriage"] - 0.3 * np.sin(3.0 * even.time)).max() < 0.3 * 9.0 * 0.205**2 / 8.0


def test_across_a_gap_a_run_has_the_reference_of_its_repeat():
    time = np.arange(800) / 200.0
    with pytest.warns(RecordingWarning, match=r"b: rows are not equally spaced"):
        even = aligned(load_machine("laas_anti_cogging"), {"b": with_reference(time * 0.2, (0.2, 0.24)), "a": with_reference(time * 0.2)})
    np.testing.assert_array_equal(even["b"]["reference_carriage"], even["a"]["reference_carriage"])


def of_periods(rate_Hz: float, **experiment) -> Recording:
    time = np.arange(900) / rate_Hz
    moved = recording(time, command_rotor=np.sin(time), position_rotor=np.sin(time))
    return moved.with_metadata(experiment={"period_samples": 200, "settle_periods": 1, "periods": 3, "excited_lines": [3]} | experiment)


def test_what_is_counted_in_rows_is_counted_in_the_machines():
    with pytest.warns(RecordingWarning, match="500 rows a second"):
        even = aligned(MOTOR, {"rec": of_periods(500.0, settle_rows=31)})["rec"]
    assert even.experiment == {"period_samples": 400, "settle_periods": 1, "periods": 3, "excited_lines": [3], "settle_rows": 62}
    assert [part.start for part in even.period_slices] == [400, 800, 1200]


def test_periods_of_no_whole_number_of_rows_are_none():
    with pytest.warns(RecordingWarning, match=r"rec: its period of 200 rows is 666\.667 rows at 1000 Hz.*not split"):
        even = aligned(MOTOR, {"rec": of_periods(300.0, settle_rows=31)})["rec"]
    assert even.experiment == {"excited_lines": [3], "settle_rows": 104}


def test_lost_rows_leave_the_periods_as_they_are():
    whole = of_periods(1000.0, settle_rows=31)
    late = Recording({**whole.channels, "time": Channel("s", np.round(whole.time * 1.0001, 5))}, whole.metadata)
    with pytest.warns(RecordingWarning, match="not equally spaced"):
        even = aligned(MOTOR, {"rec": late.part(np.arange(900) != 450)})["rec"]
    assert even.experiment == whole.experiment
