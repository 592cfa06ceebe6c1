"""What parameters are narrowed by, in units of what they may be beforehand."""

from __future__ import annotations

import numpy as np
import pytest

from hil.diagnosis.information import Free, information_of
from virtual_bus.effects.registry import effects

ENERGY = 400.0


def of(name: str, seen: dict[str, float], **values: float) -> np.ndarray:
    """Information on an effect with these values; each parameter is counted in units of 1 and loses this much energy by one of them."""
    parameters = {p.name: p for p in effects()[name].parameters}
    free = [Free(0, parameters[key], value, 1.0) for key, value in values.items()]
    hessian = np.diag([1.0, *(seen[key] for key in values)])
    return information_of(hessian, 1, free)


def test_a_law_with_one_strength_is_counted_in_units_of_what_it_is():
    assert of("coulomb_friction", {"Fc": ENERGY}, Fc=1.0) == pytest.approx([ENERGY])
    shape = of("stribeck_friction", {"Fs_minus_Fc": ENERGY, "vs": 3.0}, Fs_minus_Fc=1.0, vs=1.0)
    assert sorted(shape) == pytest.approx([3.0, ENERGY])


def test_a_strength_that_was_fitted_to_nothing_might_have_been_as_large_as_the_law():
    """Friction that may differ with direction, of which one way has none at all, counted in a hundredth of the other."""
    found = of("asymmetric_friction", {"Fc_plus": ENERGY, "Fc_minus": 1e-4 * ENERGY}, Fc_plus=1.0, Fc_minus=0.0)
    assert found == pytest.approx([ENERGY, ENERGY], rel=1e-6)


@pytest.mark.parametrize("kc3", [0.0, 1e-12, 1e-7])
@pytest.mark.parametrize("least", [1e-6, 0.1, 1e3])
def test_how_finely_a_strength_near_zero_is_counted_says_nothing_about_how_large_it_may_be(kc3, least):
    """A cable's cubic stiffness, one unit of which would be an energy of 2e9, beside the linear one that does all there is."""
    linear, cubic, _ = effects()["cable_spring"].parameters
    size = max(kc3, least)  # `coordinates.SMALLEST_SHARE`
    found = information_of(np.diag([1.0, ENERGY, 2e9 * size**2]), 1, [Free(0, linear, 2.0, 2.0), Free(0, cubic, kc3, size)])
    assert found == pytest.approx([ENERGY, ENERGY], rel=1e-6)


def test_what_an_effect_of_one_strength_does_not_do_costs_nothing():
    fc = effects()["coulomb_friction"].parameters[0]
    assert information_of(np.diag([1.0, ENERGY]), 1, [Free(0, fc, 0.0, 1e-4)]) == pytest.approx([0.0])
    assert information_of(np.diag([1.0, ENERGY]), 1, [Free(0, fc, 1e-6, 1e-4)]) == pytest.approx([1e-4 * ENERGY])


def test_a_strength_that_the_recordings_do_not_see_costs_nothing():
    found = of("asymmetric_friction", {"Fc_plus": ENERGY, "Fc_minus": 0.0}, Fc_plus=1.0, Fc_minus=0.0)
    assert sorted(found) == pytest.approx([0.0, ENERGY])


def test_no_strength_is_larger_than_any_machine_has():
    largest = next(p.high for p in effects()["asymmetric_friction"].parameters if p.name == "Fc_minus")
    found = of("asymmetric_friction", {"Fc_plus": ENERGY, "Fc_minus": 1e-9}, Fc_plus=1.0, Fc_minus=0.0)
    assert min(found) == pytest.approx(1e-9 * largest**2)


def test_what_the_machine_s_numbers_imitate_is_not_known():
    hessian = np.array([[4.0, 2.0], [2.0, 5.0]])
    parameter = effects()["coulomb_friction"].parameters[0]
    assert information_of(hessian, 1, [Free(0, parameter, 1.0, 1.0)]) == pytest.approx([4.0])
