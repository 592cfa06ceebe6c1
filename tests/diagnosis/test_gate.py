"""What chance gains where an order or a frequency is searched, against noise that is searched."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
import scipy.integrate
import scipy.stats

from hil.diagnosis.gate import IN_SAMPLE, PRIOR_FREEDOM, PRIOR_VARIANCE, SIMULATOR_ERROR, TRAIN_LEVEL, Scatter, needed_gain
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


@pytest.mark.parametrize("size", [0.2, 2.0, 6.0])
def test_the_scatter_along_a_response_is_the_variance_expected_after_the_repeats_were_seen(size):
    response = np.array([0.0, 3.0, 4.0])
    along = size * np.array([1.0, -0.5, -0.5])
    runs = SimpleNamespace(repeats=lambda name: [[np.array([9.0, 0.0, 0.0]) + a * response / 5.0 for a in along]])
    seen = float(along @ along) / IN_SAMPLE

    def weight(variance):
        prior = scipy.stats.chi2.pdf(PRIOR_FREEDOM * PRIOR_VARIANCE / variance, PRIOR_FREEDOM) / variance**2
        return prior * scipy.stats.chi2.pdf(seen / variance, len(along) - 1) / variance

    mean, whole = (scipy.integrate.quad(lambda v, k=k: v**k * weight(v), 0.0, np.inf)[0] for k in (1, 0))
    assert Scatter(runs).along(response) == pytest.approx(max(1.0, mean / whole), rel=1e-3)


def test_without_repeats_the_noise_model_stands_alone():
    runs = SimpleNamespace(repeats=lambda name: [[np.array([1.0, 2.0])]])
    assert Scatter(runs).along(np.array([1.0, 0.0])) == 1.0
