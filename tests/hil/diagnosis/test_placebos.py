"""Placebos: what an effect gains beside a response run backwards, and that beside the effect, by the fit of both together."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from hil.diagnosis.judging.placebos import NO_PLACEBOS, Beside, Placebos, Rivals

SEED = 20261125
ENTRIES = 200


@dataclass(frozen=True, eq=False)
class Moved:
    """What a projection takes of a tuning."""

    jacobian: np.ndarray
    offset: np.ndarray


def falls(residual: np.ndarray, effect: np.ndarray, placebo: np.ndarray) -> tuple[float, float]:
    """What each takes of |residual|^2 beside the other, by least squares of one and of both."""

    def left(*columns: np.ndarray) -> float:
        design = np.column_stack(columns)
        return float(np.sum((residual - design @ np.linalg.lstsq(design, residual, rcond=None)[0]) ** 2))

    both = left(effect, placebo)
    return left(effect) - both, left(placebo) - both


def drawn(alike: float) -> tuple[np.ndarray, np.ndarray]:
    """Two responses with this cosine."""
    rng = np.random.default_rng(SEED)
    one, other = np.linalg.qr(rng.normal(size=(ENTRIES, 2)))[0].T
    return one, alike * one + np.sqrt(1.0 - alike**2) * other


def beside(residual: np.ndarray, effect: np.ndarray, *placebos: np.ndarray) -> Beside | None:
    units = np.stack([placebo / np.linalg.norm(placebo) for placebo in placebos])
    return Rivals(units, units @ residual).beside(3.0 * effect, float(effect @ residual) ** 2 / float(effect @ effect))


@pytest.mark.parametrize("alike", [0.0, 0.4, 0.9, -0.7])
def test_both_gain_beside_each_other_what_a_fit_of_both_says(alike):
    effect, placebo = drawn(alike)
    residual = 20.0 * effect + np.random.default_rng(SEED + 1).normal(size=ENTRIES)
    assert beside(residual, effect, placebo) == pytest.approx(falls(residual, effect, placebo), rel=1e-9)


def test_a_placebo_that_gains_by_its_likeness_to_the_effect_is_no_rival():
    effect, placebo = drawn(0.9)
    residual = 100.0 * effect
    assert float(placebo @ residual) ** 2 > float(effect @ residual) ** 2 / 1.5
    its, own = beside(residual, effect, placebo)
    assert its < 1e-6 and own > 1000.0


def test_an_effect_that_gains_by_its_likeness_to_a_placebo_has_a_rival():
    effect, placebo = drawn(0.9)
    its, own = beside(100.0 * placebo, effect, placebo)
    assert own < 1e-6 and its > 1000.0


def test_the_rival_is_the_one_that_comes_nearest_to_refusing_the_effect():
    effect, alike = drawn(0.9)
    apart = np.linalg.svd(np.stack([effect, alike]))[2][-1]  # from both
    residual = 100.0 * effect + 90.0 * apart
    assert beside(residual, effect, alike, apart) == pytest.approx(falls(residual, effect, apart), rel=1e-9)


def test_an_effect_that_is_a_placebo_gains_nothing_beside_it():
    effect, apart = drawn(0.0)
    residual = 10.0 * effect
    assert beside(residual, effect, effect) == (0.0, 0.0)
    assert beside(residual, effect, effect, apart) == (0.0, 0.0)


def test_without_placebos_or_a_gain_nothing_is_beside_an_effect():
    effect, placebo = drawn(0.0)
    assert Rivals(np.zeros((0, 0)), np.zeros(0)).beside(np.ones(3), 12.0) is None
    assert Rivals(placebo[None], np.array([5.0])).beside(effect, -2.0) is None
    assert Rivals(placebo[None], np.array([5.0])).largest == 25.0


@pytest.mark.parametrize("numbers", [0, 2])
def test_placebos_are_compared_beside_any_tuning_whatever_numbers_it_may_still_move(numbers):
    """Numbers at their bounds move no more: of another stand there may be more or fewer."""
    rng = np.random.default_rng(SEED)
    jacobian = rng.normal(size=(ENTRIES, numbers))
    tuning = Moved(jacobian, np.zeros(numbers))
    responses, residual = rng.normal(size=(3, ENTRIES)), rng.normal(size=ENTRIES)
    rivals = Placebos(responses).at(tuning, residual)
    stacked = np.vstack([jacobian, np.eye(numbers)])

    def left(rows: np.ndarray) -> np.ndarray:
        whole = np.concatenate([rows, np.zeros(numbers)])
        return whole - stacked @ np.linalg.lstsq(stacked, whole, rcond=None)[0] if numbers else whole

    each = [left(row) for row in responses]
    expected = [float(one @ left(residual)) ** 2 / float(one @ one) for one in each]
    assert rivals.along**2 == pytest.approx(expected, rel=1e-9)
    assert rivals.responses.shape == (3, ENTRIES + numbers)
    assert NO_PLACEBOS.at(tuning, residual).largest == 0.0
