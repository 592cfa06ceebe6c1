"""What chance gains where an order or a frequency is searched, against noise that is searched."""

from __future__ import annotations

import numpy as np
import pytest

from hil.diagnosis.gate import SIMULATOR_ERROR, TRAIN_LEVEL, needed_gain
from hil.diagnosis.starts import ONE_HARMONIC, TWO_HARMONICS

ROWS, PADDED = 128, 2048
DRAWS = 12000


def largest_gains(harmonics: int) -> np.ndarray:
    """(DRAWS,) energy of white noise along the best wave of a fine search over frequency, and how many cycles it spans."""
    random = np.random.default_rng(3)
    found = []
    for _ in range(DRAWS // 2000):
        lines = np.fft.rfft(random.standard_normal((2000, ROWS)), PADDED, axis=1)
        energy = 2.0 * np.abs(lines) ** 2 / ROWS
        low, high = 2 * PADDED // ROWS, PADDED // 2 // harmonics - PADDED // ROWS
        own = energy[:, low:high]
        found.append((own + (energy[:, 2 * low : 2 * high : 2] if harmonics == 2 else 0.0)).max(axis=1))
    return np.concatenate(found)


def trials(harmonics: int) -> float:
    """As `starts.shapes_of` counts them: range of the wave number times the rms of what it is a wave over."""
    low, high = 2 * PADDED // ROWS, PADDED // 2 // harmonics - PADDED // ROWS
    return (ONE_HARMONIC, TWO_HARMONICS)[harmonics - 1] * 2.0 * np.pi * (high - low) / PADDED * float(np.std(np.arange(ROWS)))


@pytest.mark.parametrize("harmonics", [1, 2])
def test_the_best_of_all_frequencies_passes_by_chance_as_often_as_asked(harmonics):
    needed = needed_gain(trials(harmonics), 2 * harmonics + 1, 0.0, 0)
    assert np.mean(largest_gains(harmonics) > needed) == pytest.approx(TRAIN_LEVEL, rel=0.35)
    uncounted = needed_gain(1, 2 * harmonics + 1, 0.0, 0)
    assert np.mean(largest_gains(harmonics) > uncounted) > 10.0 * TRAIN_LEVEL


def test_noise_above_the_model_asks_for_more_and_noise_below_it_for_no_less():
    assert needed_gain(50, 1, 2000.0, 1000) == pytest.approx(2.0 * needed_gain(50, 1, 1000.0, 1000))
    assert needed_gain(50, 1, 500.0, 1000) == needed_gain(50, 1, 1000.0, 1000)


def test_no_gain_below_the_simulator_s_own_error_counts():
    assert needed_gain(1, 1, 0.0, 10**6) == SIMULATOR_ERROR * 10**6
