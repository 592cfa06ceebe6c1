"""Numbers re-tuned and effects named by seeing, on a carriage that an independent recursion simulates."""

from __future__ import annotations

import numpy as np
import pytest
from carriage import DAMPING, MACHINE, MASS_kg, repeats

from hil.diagnosis.model_choice.choose import Choice, choose_effects
from hil.diagnosis.observed.groups import groups
from hil.diagnosis.observed.rows import observed
from hil.diagnosis.residuals.residuals import residuals_of
from hil.diagnosis.retuning.numbers import PRIOR

HEAVIER = 1.05
COULOMB_N = 20.0


@pytest.fixture(scope="module")
def heavier() -> Choice:
    return choose_effects(residuals_of(MACHINE, repeats(4, mass=HEAVIER * MASS_kg, damping=0.94 * DAMPING)))


@pytest.fixture(scope="module")
def rubbing() -> Choice:
    return choose_effects(residuals_of(MACHINE, repeats(4, mass=HEAVIER * MASS_kg, coulomb_N=COULOMB_N)))


def test_repeats_are_one_experiment() -> None:
    recordings = {**repeats(2), **repeats(1, experiment=1)}
    found = groups([observed(MACHINE, name, recording) for name, recording in recordings.items()])
    assert [len(group.repeats) for group in found] == [2, 1]
    np.testing.assert_allclose(
        found[0].mean.readings[:, 0], np.mean([recordings[name]["position_carriage"] for name in ("run_0_0", "run_0_1")], axis=0)
    )


def test_where_nothing_is_missing_the_numbers_leave_noise_alone(heavier: Choice) -> None:
    energy = sum(float(one.innovations @ one.innovations) for one in heavier.linear.records) / heavier.linear.readings
    assert energy == pytest.approx(1.0, abs=0.12)
    values = dict(zip([p.name for p in heavier.linear.plant.parameters], heavier.linear.values, strict=True))
    gain = values["carriage.constant_N_V"] / MACHINE.plant.drives[0].constant
    mass = sum(value for name, value in values.items() if name.endswith(("mass_kg", "armature_kg")))  # on one way both are the same
    damping = values["carriage.damping_N_s_m"]
    assert mass / gain == pytest.approx(HEAVIER * MASS_kg, rel=0.005)
    assert damping / gain == pytest.approx(0.94 * DAMPING, rel=0.02)


def test_nothing_is_named_where_nothing_is_missing(heavier: Choice) -> None:
    assert heavier.ranked[0].fitted.settings == ()


def test_a_hidden_friction_is_named_with_its_strength(rubbing: Choice) -> None:
    best = rubbing.ranked[0].fitted
    assert [(setting.name, setting.at) for setting in best.settings] == [("coulomb_friction", "carriage")]
    gain = 1.0 + PRIOR * best.offset[rubbing.linear.numbers.names.index("carriage.constant")]
    assert best.settings[0].parameters["Fc"] / gain == pytest.approx(COULOMB_N, rel=0.02)  # efforts have no scale; laws, a form to a tenth


def test_without_the_friction_a_tenfold_of_the_noise_is_left(rubbing: Choice) -> None:
    assert rubbing.plain.squares > 10.0 * rubbing.best.squares


def test_the_engineer_s_first_fit_finds_no_load_and_no_more_damping(rubbing: Choice) -> None:
    strengths = {setting.name: setting.parameters for setting in rubbing.baseline.settings}
    assert strengths["coulomb_friction"]["Fc"] == pytest.approx(COULOMB_N, rel=0.1)
    assert abs(strengths["constant_load"]["tau0"]) < 0.05 * COULOMB_N
