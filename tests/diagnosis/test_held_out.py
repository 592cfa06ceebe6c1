"""What held-out recordings are judged with."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg

from hil.diagnosis.held_out import precision_of


def covariance(seed: int, least: float, numbers: int = 45) -> np.ndarray:
    """Of numbers of which some are known to a part of `least` of the others' variance, as an inverse gives it: with its rounding."""
    random = np.random.default_rng(seed)
    directions = np.linalg.qr(random.standard_normal((numbers, numbers)))[0]
    return np.linalg.inv((directions / np.geomspace(least, 1.0, numbers)) @ directions.T)


def test_a_covariance_comes_back_as_its_inverse():
    known = covariance(1, 1e-4)
    assert precision_of(known) @ known == pytest.approx(np.eye(45), abs=1e-8)
    assert precision_of(np.zeros((0, 0))).shape == (0, 0)


@pytest.mark.parametrize("seed", range(4))
def test_numbers_known_far_better_than_others_leave_it_positive_definite(seed):
    assert np.linalg.eigvalsh(np.linalg.inv(covariance(seed, 1e-17))).min() < 0.0  # an inverse is not
    scipy.linalg.cho_factor(precision_of(covariance(seed, 1e-17)))
