"""What takes most of a drive's effort away, or is pressed against a bound, is no finding."""

from __future__ import annotations

import pytest
from carriage import GAIN, MACHINE, disturbance, recording, reference, run

from hil.diagnosis.model_choice.fitting import fit
from hil.diagnosis.model_choice.plausibility import are_driven
from hil.diagnosis.residuals.residuals import residuals_of
from hil.diagnosis.retuning.linear_model import LinearModel, linear_at, nominal_offset
from virtual_bus.settings import EffectSetting


def seen_with(**physics: float) -> LinearModel:
    """The carriage with other physics, along its motion."""
    print("seeds 0 to 2")
    wanted = reference(3.0)
    found = {}
    for seed in range(3):
        forces = disturbance(len(wanted), 1.0, seed)
        found[f"run_{seed}"] = recording(wanted, *run(wanted, force_N=forces, noise_seed=seed, **physics))
    residuals = residuals_of(MACHINE, found)
    return linear_at(residuals.trajectories, residuals.levels, nominal_offset(residuals.trajectories))


@pytest.fixture(scope="module")
def rubbed() -> LinearModel:
    """With friction."""
    return seen_with(coulomb_N=20.0)


@pytest.mark.parametrize(("limit_V", "is_sensible"), [(1e-6, False), (0.2, False), (100.0, True)])
def test_a_current_limit_that_leaves_no_effort_is_none(rubbed: LinearModel, limit_V: float, is_sensible: bool) -> None:
    setting = EffectSetting("current_saturation", "carriage", {"imax": limit_V, "droop": 0.0})
    assert are_driven(rubbed, (setting,)) == is_sensible


def test_a_strength_that_a_bound_keeps_from_what_was_recorded_is_none(rubbed: LinearModel) -> None:
    """A drive three times as strong as its file says lies beyond what the catalogue allows a constant to err by."""
    friction = fit(rubbed, (EffectSetting("coulomb_friction", "carriage", {"Fc": 10.0}),))
    assert friction is not None
    assert friction.is_sensible
    assert friction.settings[0].parameters["Fc"] == pytest.approx(20.0, rel=0.15)
    strong = fit(seen_with(gain=3.0 * GAIN), (EffectSetting("torque_constant", "carriage", {"eps": 0.2}),))
    assert strong is not None
    assert strong.settings[0].parameters["eps"] == 1.0
    assert not strong.is_sensible
