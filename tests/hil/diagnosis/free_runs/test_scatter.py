"""What repeats scatter by makes noise white, and a misfit as large as a matched filter says."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.signal

from hil.diagnosis.free_runs.scatter import Scatter

ROWS = 2048


@pytest.mark.parametrize(("repeats", "channels"), [(2, 3), (3, 8), (5, 2)])
def test_the_noise_of_the_mean_becomes_white_with_unit_variance(repeats: int, channels: int) -> None:
    print("seeds 0 to 5")
    white = []
    for seed in range(6):
        noise = np.random.default_rng(seed).normal(size=(repeats, ROWS, channels))
        noise[:, :, 0] = scipy.signal.lfilter([1.0], [1.0, -0.95], noise[:, :, 0], axis=1)
        noise[:, :, 1] += 3.0 * noise[:, :, 0]
        mean = noise.mean(axis=0)
        white.append(Scatter(noise - mean, np.zeros((ROWS, channels))).whiten(mean).reshape(ROWS, channels))
    each = np.concatenate([one[200:-200] for one in white])  # the ends are faded out
    assert np.mean(each**2) == pytest.approx(1.0, abs=0.12)
    assert np.abs(np.corrcoef(each.T) - np.eye(channels)).max() < 0.1
    neighbours = np.mean(each[1:] * each[:-1], axis=0)
    assert np.abs(neighbours).max() < 0.1


def test_a_misfit_is_as_large_as_a_matched_filter_says() -> None:
    print("seed 3")
    repeats, deviation = 4, 0.2
    noise = deviation * np.random.default_rng(3).normal(size=(repeats, ROWS, 1))
    wave = 0.05 * np.sin(2.0 * np.pi * 40.3 * np.arange(ROWS) / ROWS)[:, None]
    wave[: ROWS // 8] = wave[-ROWS // 8 :] = 0.0
    found = Scatter(noise - noise.mean(axis=0), np.zeros((ROWS, 1))).whiten(wave)
    assert found @ found == pytest.approx(repeats * np.sum(wave**2) / deviation**2, rel=0.3)


def test_what_all_repeats_have_alike_counts_as_noise() -> None:
    print("seed 0")
    random = np.random.default_rng(0)
    left = Scatter(1e-9 * random.normal(size=(3, ROWS, 1)), random.normal(size=(ROWS, 1))).whiten(random.normal(size=(ROWS, 1)))
    assert np.mean(left**2) == pytest.approx(1.0, abs=0.2)
