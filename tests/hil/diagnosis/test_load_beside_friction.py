"""A load beside dry friction, whichever way round: together they are one asymmetric friction, which must not be explained alone."""

from __future__ import annotations

import pytest
from carriage import MACHINE, repeats

from hil.diagnosis.diagnose import diagnose
from hil.diagnosis.model_choice.fitting import difference, reach
from virtual_bus.effects.registry import effects
from virtual_bus.settings import EffectSetting

COULOMB_N, LOAD_N = 20.0, 8.0
PAIR = {"coulomb_friction at carriage", "constant_load at carriage"}


@pytest.mark.parametrize("load_N", [LOAD_N, -LOAD_N])
def test_the_pair_is_named_or_a_rival(load_N: float) -> None:
    found = diagnose(MACHINE, repeats(3, seed=41, coulomb_N=COULOMB_N, load_N=load_N)).diagnosis
    answer = {str(finding.effect) for finding in found.findings}
    rivals = [{str(effect) for effect in one} for finding in found.findings for one in finding.ambiguous_sets]
    assert answer == PAIR or (PAIR in rivals and found.verdict == "ambiguous"), found.reason


@pytest.mark.parametrize("value", [0.0, 1e-17, -1e-17, 1e-9])
def test_a_strength_that_has_met_zero_may_go_on_to_the_other_side(value: float) -> None:
    (load,) = (parameter for parameter in effects()["constant_load"].parameters if parameter.is_strength)
    below, above = reach(load, value, 1e-3)
    assert below < -1.0
    assert above > 1.0
    setting = EffectSetting("constant_load", "carriage", {load.name: value})
    assert abs(difference((setting,), 0, load)) >= load.small
