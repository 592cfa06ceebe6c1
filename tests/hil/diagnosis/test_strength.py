"""An effect of no strength explains nothing, and equations that nothing determines leave numbers where they are."""

from __future__ import annotations

import numpy as np

from hil.diagnosis.candidates.entries import effect_sought, setting_of
from hil.diagnosis.retuning.bounded import bounded_least_squares
from hil.diagnosis.verdict.values import acting


def test_effects_without_strength_are_left_out() -> None:
    none = setting_of(effect_sought("coulomb_friction"), "turn", {"Fc": 0.0})
    some = setting_of(effect_sought("coulomb_friction"), "turn", {"Fc": 0.1})
    second = setting_of(effect_sought("cogging"), "turn", {"Np": 7.0, "A1": 0.0, "A2": 0.2})
    assert acting((none, some, second)) == (some, second)


def test_normal_equations_less_some_of_them_have_a_solution() -> None:
    """Stretches are left out by subtraction, and rounding may leave a direction a square below zero."""
    for squares in (np.diag([1.0, -1e-7]), np.array([[1.0, 1.0], [1.0, 1.0 - 1e-7]])):
        found = bounded_least_squares(squares, squares @ [0.5, 0.0], np.full(2, -np.inf), np.full(2, np.inf))
        np.testing.assert_allclose(squares @ found, squares @ [0.5, 0.0], atol=1e-5)
