"""Placebos: what an effect gains beside a response run backwards, and that beside the effect, by the fit of both together."""

from __future__ import annotations

import numpy as np
import pytest

from hil.diagnosis.judging.placebos import NO_PLACEBOS, Placebos

SEED = 20261125
ENTRIES = 200


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


def beside(residual: np.ndarray, effect: np.ndarray, *placebos: np.ndarray) -> tuple[float, float]:
    units = np.stack([placebo / np.linalg.norm(placebo) for placebo in placebos])
    return Placebos(units, units @ residual).beside(3.0 * effect, float(effect @ residual) ** 2 / float(effect @ effect))


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


def test_the_rival_is_the_one_that_leaves_the_effect_least():
    effect, alike = drawn(0.9)
    apart = np.linalg.svd(np.stack([effect, alike]))[2][-1]  # from both
    residual = 100.0 * effect + 30.0 * apart
    assert beside(residual, effect, alike, apart) == pytest.approx(falls(residual, effect, apart), rel=1e-9)


def test_without_placebos_an_effect_has_no_rival():
    assert NO_PLACEBOS.beside(np.ones(3), 12.0) == (0.0, 12.0)


def test_what_gains_nothing_gains_nothing_beside_a_placebo():
    effect, placebo = drawn(0.0)
    its, own = Placebos(placebo[None], np.array([5.0])).beside(effect, -2.0)
    assert (its, own) == (25.0, -2.0)
