"""Noise that is coloured, or loud for a while, is white and even behind its filters; what a model knows already is left alone."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.signal

from hil.diagnosis.residuals.noise_spectrum import colour_of, loudness_of, whitened_by

SEED = 5
ROWS = 6000


def line(random: np.random.Generator, rows: int = ROWS) -> np.ndarray:
    """Noise of a narrow band, of unit variance (rows, 1)."""
    values = scipy.signal.lfilter([1.0], [1.0, -2.0 * 0.97 * np.cos(0.4), 0.97**2], random.standard_normal(rows + 500))[500:]
    return (values / values.std())[:, None]


def test_a_narrow_line_is_white_behind_its_filter() -> None:
    print(f"seed {SEED}")
    random = np.random.default_rng(SEED)
    filters = colour_of([line(random), line(random)])
    fresh = line(random).copy()
    whitened_by(filters, fresh)
    fresh = fresh[100:, 0]
    assert fresh.std() == pytest.approx(1.0, abs=0.2)  # a thousandth of it counts as new in any case
    assert max(abs(np.corrcoef(fresh[k:], fresh[:-k])[0, 1]) for k in (1, 2, 3, 8)) < 0.2  # before: 0.9


def test_noise_that_repeats_show_less_of_than_the_model_knows_is_not_made_louder() -> None:
    print(f"seed {SEED}")
    quiet = 0.1 * np.random.default_rng(SEED).standard_normal((ROWS, 1))
    filters = colour_of([quiet])
    values = quiet.copy()
    whitened_by(filters, values)
    assert values.std() == pytest.approx(0.1, rel=0.05)


def test_a_burst_is_as_loud_as_it_is() -> None:
    print(f"seed {SEED}")
    random = np.random.default_rng(SEED)
    scale = np.where(np.arange(ROWS) % 2000 < 400, 3.0, 0.5)[:, None]
    loudness = loudness_of([scale * random.standard_normal((ROWS, 2)) for _ in range(3)])
    middle = np.arange(150, 250)
    assert loudness[middle].mean() / loudness[middle + 1000].mean() == pytest.approx(6.0, rel=0.15)
    assert np.sqrt(np.mean(loudness**2)) == pytest.approx(1.0, abs=0.05)
