"""The oracle's distances: closed forms in white noise, what refitting takes away, where an effect is."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

if TYPE_CHECKING:
    from concealed.truth.oracle import NoiseUnits

SAMPLES, RATE_Hz = 4000, 200.0


def units_of(noise: np.ndarray) -> NoiseUnits:
    from concealed.truth.oracle import NoiseUnits

    return NoiseUnits(noise)


def sine(frequency_Hz: float, amplitude: float) -> np.ndarray:
    t = np.arange(SAMPLES) / RATE_Hz
    return amplitude * np.sin(2.0 * np.pi * frequency_Hz * t)[:, None]


def test_a_distance_in_white_noise_is_the_signals_norm_over_its_deviation() -> None:
    rng = np.random.default_rng(1)
    units = units_of(0.3 * rng.normal(size=(4, SAMPLES, 1)))
    expected = np.sqrt(4.0) * np.linalg.norm(sine(7.0, 0.05)) / 0.3
    assert np.linalg.norm(units(sine(7.0, 0.05))) == pytest.approx(expected, rel=0.15)


def test_a_signal_counts_where_the_noise_is_quiet() -> None:
    rng = np.random.default_rng(2)
    noise = rng.normal(size=(4, SAMPLES, 1)) + 20.0 * np.sin(
        2.0 * np.pi * 30.0 * np.arange(SAMPLES)[:, None] / RATE_Hz + rng.normal(size=(4, 1, 1))
    )
    units = units_of(noise)
    assert np.linalg.norm(units(sine(5.0, 1.0))) > 10.0 * np.linalg.norm(units(sine(30.0, 1.0)))


def test_refitting_takes_away_what_the_machine_files_numbers_explain() -> None:
    from concealed.truth.oracle import left_over

    units = units_of(np.random.default_rng(3).normal(size=(3, SAMPLES, 2)))
    known, new = np.hstack([sine(3.0, 1.0), sine(5.0, 0.5)]), np.hstack([sine(11.0, 1.0), 0.0 * sine(1.0, 1.0)])
    assert left_over(units(2.0 * known), [units(known)]) < 1e-9
    assert left_over(units(2.0 * known + new), [units(known)]) == pytest.approx(np.linalg.norm(units(new)), rel=0.02)


def test_a_burst_is_found_at_its_time_position_frequency_and_channel() -> None:
    from concealed.truth.oracle import location

    units = units_of(0.01 * np.random.default_rng(4).normal(size=(3, SAMPLES, 2)))
    t = np.arange(SAMPLES) / RATE_Hz
    burst = np.where((t > 6.0) & (t < 8.0), 0.03 * np.sin(2.0 * np.pi * 20.0 * t), 0.0)
    found = location(np.column_stack([0.0 * t, burst]), units, RATE_Hz, t[:, None], ["current", "imu_x"], ["ramp"])
    assert found["channels"]["imu_x"] > 0.99
    assert found["time_s"] == [[pytest.approx(6.0, abs=0.2), pytest.approx(8.0, abs=0.2)]]
    low, high = found["frequency_hz"][0][0], found["frequency_hz"][-1][1]
    assert 10.0 < low < 20.0 < high < 40.0
    assert found["position"]["ramp"]["intervals"] == [[pytest.approx(6.0, abs=1.0), pytest.approx(8.0, abs=1.0)]]


@pytest.mark.parametrize(("repeats", "channels"), [(3, 3), (4, 9), (3, 12)])
def test_other_noise_has_a_mean_square_of_one_in_units_of_what_repeats_differ_by(repeats: int, channels: int) -> None:
    """The inverse of a density of some sixty degrees of freedom is too large by a tenth for three channels, by a third for twelve, whatever
    the channels' units are.
    """
    from concealed.truth.oracle import NoiseUnits

    random, samples = np.random.default_rng(6), 2000
    mixture = np.diag(10.0 ** random.uniform(-3.0, 3.0, channels))
    squares = []
    for _ in range(4):
        units = NoiseUnits(random.standard_normal((repeats, samples, channels)) @ mixture)
        other = units((random.standard_normal((repeats, samples, channels)) @ mixture).mean(axis=0))
        squares.append(float(np.mean(other**2)))
    assert np.mean(squares) == pytest.approx(1.0, abs=0.04)
