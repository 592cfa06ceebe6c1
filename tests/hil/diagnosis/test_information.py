"""What parameters are narrowed by, in units of what they may be beforehand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hil.diagnosis.fitting.information import Free, Narrowed, information_of, simpler_forms
from hil.diagnosis.ranking.naming import Weighed
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


def test_a_limit_is_as_uncertain_as_it_is_large_not_as_far_from_none():
    """A saturation at 2 A beside the 1000 A at which it does nothing."""
    found = of("current_saturation", {"imax": ENERGY, "droop": 3.0}, imax=2.0, droop=1.0)
    assert sorted(found) == pytest.approx([3.0, ENERGY])


def free_of(*effects_with_values: tuple[str, dict[str, float]]) -> list[Free]:
    """Parameters of several effects, each counted in units of 1."""
    found = []
    for number, (name, values) in enumerate(effects_with_values):
        parameters = {p.name: p for p in effects()[name].parameters}
        found += [Free(number, parameters[key], value, 1.0) for key, value in values.items()]
    return found


ASYMMETRIC = "asymmetric_friction", {"Fc_plus": 0.8, "Fc_minus": 1.2, "Fv_plus": 0.3, "Fv_minus": 0.2}


def test_without_a_term_a_law_loses_what_a_fit_without_it_leaves():
    """Against the least of the same quadratic with that term's strengths held at zero, the machine's two numbers and the rest free."""
    free = free_of(ASYMMETRIC)
    root = np.random.default_rng(5).standard_normal((30, 6))
    hessian = root.T @ root + np.diag([1.0, 1.0, 0.0, 0.0, 0.0, 0.0])
    best = np.array([0.1, -0.2, *(one.value for one in free)])
    forms = simpler_forms(hessian, 2, free)
    for (loss, seen, without), absent in zip(forms, ([2, 3], [4, 5]), strict=True):
        assert without == tuple(n - 2 for n in absent)
        kept = [n for n in range(6) if n not in absent]
        rest = best.copy()
        rest[absent] = 0.0
        rest[kept] = np.linalg.solve(hessian[np.ix_(kept, kept)], (hessian @ best)[kept])
        assert loss == pytest.approx((rest - best) @ hessian @ (rest - best))
        assert len(seen) == 2


def test_a_law_without_a_term_that_was_fitted_to_nothing_is_narrowed_as_its_other_terms_alone():
    free = free_of(("asymmetric_friction", {"Fc_plus": 1.0, "Fc_minus": 1.0, "Fv_plus": 0.0, "Fv_minus": 0.0}))
    forms = simpler_forms(np.diag([1.0, ENERGY, ENERGY, 5.0, 5.0]), 1, free)
    alone = information_of(np.diag([1.0, ENERGY, ENERGY]), 1, free[:2])
    loss, seen, _ = min(forms, key=lambda form: form.loss)
    assert loss == 0.0
    assert seen == pytest.approx(alone)


def test_strengths_of_one_unit_come_and_go_together_and_a_law_keeps_one_term():
    def count(*some: tuple[str, dict[str, float]]) -> int:
        free = free_of(*some)
        return len(simpler_forms(np.diag([1.0, *[ENERGY] * len(free)]), 1, free))

    cable = "cable_spring", {"kc": 1.0, "kc3": 1.0, "theta0": 0.0}
    assert count(("coulomb_friction", {"Fc": 1.0})) == 0
    assert count(ASYMMETRIC) == 2
    assert count(ASYMMETRIC, cable) == 3 * 3 - 1
    assert count(("current_saturation", {"imax": 2.0, "droop": 0.1})) == 1  # without its limit it is none


@pytest.mark.parametrize("rounded", [-1e-9, 0.0, 1e-9])
def test_a_place_that_the_recordings_do_not_see_leaves_the_other_parameters_free(rounded):
    """Of two terms that do the same, one does it all; what a place is seen by may be rounded below nothing."""
    linear, cubic, place = effects()["cable_spring"].parameters
    free = [Free(0, linear, 1.0, 1.0), Free(0, cubic, 1.0, 1.0), Free(0, place, 0.0, 1.0)]
    seen = np.zeros((4, 4))
    seen[0, 0], seen[1:3, 1:3], seen[3, 3] = 1.0, ENERGY, rounded
    forms = simpler_forms(seen, 1, free)
    assert len(forms) == 2
    for loss, narrowed, _ in forms:
        assert loss == pytest.approx(0.0, abs=1e-6)
        assert sorted(narrowed) == pytest.approx([0.0, 4.0 * ENERGY], abs=1e-6)


def test_what_is_left_of_a_law_does_what_its_absent_term_did_as_far_as_it_can():
    """Of two terms that do the same, each half of it."""
    linear, cubic, _ = effects()["cable_spring"].parameters
    free = [Free(0, linear, 2.0, 2.0), Free(0, cubic, 5.0, 5.0)]
    forms = simpler_forms(np.block([[1.0, np.zeros((1, 2))], [np.zeros((2, 1)), np.full((2, 2), ENERGY)]]), 1, free)
    for loss, seen, _ in forms:
        assert loss == pytest.approx(0.0, abs=1e-9)
        assert seen == pytest.approx([4.0 * ENERGY])


def narrowed(trained: float, held_out: float, **values: float) -> Narrowed:
    parameters = {p.name: p for p in effects()["coulomb_friction"].parameters}
    free = [Free(0, parameters[key], value, 1.0) for key, value in values.items()]
    return Narrowed.of(np.array([[trained]]), np.array([[held_out]]), free)


def test_what_a_second_motion_narrows_costs_the_ratio_of_deviations():
    """A strength of 2, known to 0.1 from training and to 0.02 from both: the log of five, in a prior of 2 that is far wider."""
    from_both = 0.02**-2 - 0.1**-2
    assert narrowed(0.1**-2, from_both, Fc=2.0).cost() == pytest.approx(np.log(5.0), rel=1e-2)
    assert narrowed(0.0, 1e-12, Fc=2.0).cost() == pytest.approx(0.0, abs=1e-6)  # what neither shows


def test_what_narrows_counts_in_the_units_of_the_misfits():
    one = narrowed(50.0, 700.0, Fc=1.0)
    assert one.cost(2.0, 30.0) == pytest.approx(one.in_units(2.0, 30.0).cost())
    assert one.cost(1.0, 1e9) == pytest.approx(0.0, abs=1e-6)  # a motion that says nothing
    moved = Weighed(None, 10.0, 10.0, (50.0,), narrowed=one)
    assert moved.price() - replace(moved, narrowed=None).price() == pytest.approx(one.cost())
    assert moved.in_units(2.0, 30.0).price() - replace(moved, narrowed=None).in_units(2.0, 30.0).price() == pytest.approx(
        one.cost(2.0, 30.0)
    )
