"""Naming from one recording, whose noise nothing shows, on a carriage that an independent recursion simulates."""

from __future__ import annotations

import numpy as np
import pytest
from carriage import MACHINE, MASS_kg, repeats

from hil.diagnosis.model_choice.choose import Choice, choose_effects
from hil.diagnosis.observed.rows import observed
from hil.diagnosis.residuals.residuals import residuals_of

COULOMB_N, LOAD_N = 20.0, 6.0


@pytest.fixture(scope="module")
def rubbing() -> Choice:
    return choose_effects(residuals_of(MACHINE, repeats(1, duration_s=6.0, coulomb_N=COULOMB_N, load_N=LOAD_N)))


def strengths_in(found: Choice) -> dict[str, dict[str, float]]:
    return {setting.name: dict(setting.parameters) for setting in found.best.settings}


def test_friction_and_load_are_named_with_their_strengths(rubbing: Choice) -> None:
    effects = strengths_in(rubbing)
    assert set(effects) == {"coulomb_friction", "constant_load"}
    assert effects["coulomb_friction"]["Fc"] == pytest.approx(COULOMB_N, rel=0.05)
    assert abs(effects["constant_load"]["tau0"]) == pytest.approx(LOAD_N, rel=0.1)


def test_noise_is_said_to_be_assumed(rubbing: Choice) -> None:
    assert rubbing.levels.are_assumed
    assert not choose_effects(residuals_of(MACHINE, repeats(3, duration_s=2.0))).levels.are_assumed


def test_numbers_alone_are_no_physics() -> None:
    found = choose_effects(residuals_of(MACHINE, repeats(1, duration_s=6.0, mass=1.08 * MASS_kg)))
    assert strengths_in(found) == {}
    values = dict(
        zip(
            [p.name for p in found.linear.plant.parameters],
            found.linear.numbers.values(found.best.offset[: len(found.linear.numbers.indices)]),
            strict=True,
        )
    )
    moving = sum(value for key, value in values.items() if key.endswith(("mass_kg", "armature_kg")))
    assert moving == pytest.approx(1.08 * MASS_kg, rel=0.01)


def test_a_drive_s_constant_is_not_re_tuned_where_nothing_fixes_the_scale_of_efforts(rubbing: Choice) -> None:
    names = rubbing.linear.numbers.names
    assert rubbing.best.offset[names.index("carriage.constant")] == 0.0


@pytest.mark.parametrize("by", [2, 5])
def test_coarser_rows_keep_the_equation_of_motion(by: int) -> None:
    """A parabola under a constant effort stays one, its rows in the middle of those they are the mean of."""
    ((label, recording),) = repeats(1, duration_s=1.0).items()
    fine = observed(MACHINE, label, recording)
    time = fine.time
    fine.readings[:, 0] = 0.5 * time**2
    fine.targets[:] = time[:, None]
    coarse = fine.coarser(by)
    assert coarse.period_s == pytest.approx(by * fine.period_s)
    np.testing.assert_allclose(np.diff(coarse.readings[:, 0], 2), coarse.period_s**2, rtol=1e-6)
    middle = time[0] + 0.5 * (by - 1) * fine.period_s
    np.testing.assert_allclose(coarse.targets[:, 0], coarse.time + middle + 0.5 * (by - 1) * fine.period_s, rtol=1e-9, atol=1e-12)
