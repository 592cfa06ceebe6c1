"""The variance along a response by what a residual shows there, against noise whose variance along it is known."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
import scipy.signal

from hil.diagnosis.judging.structure_left import REACH_s, StructureLeft

ROWS, CHANNELS, RATE_Hz = 4000, 2, 200.0


def structure(*lengths: int) -> StructureLeft:
    groups = [SimpleNamespace(time_s=np.zeros(rows)) for rows in lengths]
    noise = SimpleNamespace(size=lambda rows: rows * CHANNELS, rate_Hz=RATE_Hz)
    return StructureLeft(SimpleNamespace(sets={"train": SimpleNamespace(channels=("a", "b"), groups=groups)}, noise=noise), "train")


def seen(response: np.ndarray, draws: int, residual) -> float:
    """Mean over drawn residuals (N, C)."""
    random = np.random.default_rng(6)
    return float(np.mean([structure(ROWS // 2, ROWS // 2).along(response.ravel(), residual(random).ravel()) for _ in range(draws)]))


def white(random) -> np.ndarray:
    return random.standard_normal((ROWS, CHANNELS))


@pytest.fixture
def slow() -> np.ndarray:
    """A response (N, C) in the first channel alone that changes slowly."""
    wave = np.zeros((ROWS, CHANNELS))
    wave[:, 0] = np.cos(2.0 * np.pi * 0.1 * np.arange(ROWS) / RATE_Hz)
    return wave


def test_along_white_noise_it_is_the_noise_s(slow):
    assert seen(slow, 40, white) == pytest.approx(1.0, abs=0.25)


def test_louder_noise_counts_where_the_response_is(slow):
    assert seen(slow, 40, lambda random: white(random) * [3.0, 1.0]) == pytest.approx(9.0, rel=0.2)
    assert seen(slow, 40, lambda random: white(random) * [1.0, 30.0]) == pytest.approx(1.0, abs=0.25)


def test_what_is_left_slowly_counts_by_its_power_where_the_response_is(slow):
    """First-order noise of a twentieth of the reach has (1 + a) / (1 - a) times white noise's power at low frequencies."""
    a = np.exp(-20.0 / (REACH_s * RATE_Hz))

    def residual(random) -> np.ndarray:
        return scipy.signal.lfilter([np.sqrt(1.0 - a**2)], [1.0, -a], white(random), axis=0)

    assert seen(slow, 60, residual) == pytest.approx((1.0 + a) / (1.0 - a), rel=0.2)


def test_nothing_is_less_than_the_noise_and_no_response_shows_nothing(slow):
    assert structure(ROWS).along(slow.ravel(), np.zeros(ROWS * CHANNELS)) == 1.0
    assert structure(ROWS).along(np.zeros(ROWS * CHANNELS), slow.ravel()) == 1.0
