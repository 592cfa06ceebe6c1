"""Plant steps are as fine as the effects that were found ask for (carriage.py: a carriage simulated apart)."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from carriage import MACHINE, repeats

from hil.diagnosis.fitting.refit import Fitted
from hil.diagnosis.recorded.align import aligned
from hil.diagnosis.residuals.mismatch import mismatch
from hil.diagnosis.result import EffectAt
from hil.diagnosis.searching.selection import Selection
from hil.diagnosis.searching.step_error import FINER, with_finer_steps
from hil.diagnosis.tuning.free_run import FINE_STEPS, TRAIN, FreeRuns, Trial
from hil.diagnosis.tuning.retune import Tuning, retune
from hil.simulation import Simulator
from hil.simulation.smooth import simulated_matrix, smooth


@pytest.fixture
def runs():
    found = mismatch(MACHINE, aligned(MACHINE, repeats()))
    with FreeRuns({TRAIN: found}, found.noise) as runs:
        yield runs


def beside(effect: EffectAt, values: list[float], tuning: Tuning, cost: float, by_numbers: float = 0.0) -> Selection:
    """A selection that chose this effect, at this cost, with so much of what it removes by numbers alone."""
    nothing = np.zeros((0, 0))
    fitted = Fitted((effect,), (np.array(values),), tuning.offset, nothing, cost, ((0, 0),), nothing, np.ones(1))
    return chosen_of(fitted, SimpleNamespace(fitted=fitted, by_numbers=(by_numbers, 0.0), by_signs=(0.0, 0.0)))


def chosen_of(fitted: Fitted | None, *contenders: SimpleNamespace) -> Selection:
    return Selection(fitted, (), contenders, (), fitted)


def cost_of(runs: FreeRuns, tuning: Tuning) -> float:
    left = runs.measured() - tuning.predicted
    return float(left @ left + tuning.offset @ tuning.offset)


def of_finer_steps(runs: FreeRuns, trial: Trial, finer: int) -> np.ndarray:
    (group,) = runs.sets[TRAIN].groups
    found = Simulator(smooth(MACHINE, finer)).run(group.inputs, trial.values, trial.effects)
    return runs.joined([group.fold(simulated_matrix(MACHINE, found, runs.sets[TRAIN].channels))])


REMOVED = 1e10  # in units of noise

SPRING = EffectAt("cable_spring", "carriage"), [2e5, 0.0, 0.0]


def test_a_corrected_run_is_that_of_steps_without_end(runs):
    """And not of steps a few times finer, whose error is a sixteenth."""
    tuning = retune(runs)
    trial = Trial(tuning.values, beside(*SPRING, tuning, 0.0).chosen.settings)
    expected = of_finer_steps(runs, trial, 16 * FINE_STEPS)
    before = float(np.linalg.norm(runs.run_one(trial) - expected))
    runs.correct(trial)
    assert before > 0.1  # in units of noise
    assert float(np.linalg.norm(runs.run_one(trial) - expected)) < 0.01 * before


def test_beside_a_spring_a_run_is_that_of_much_finer_steps(runs):
    tuning = retune(runs)
    selection = beside(*SPRING, tuning, cost_of(runs, tuning))
    trial = Trial(tuning.values, selection.chosen.settings)
    expected = of_finer_steps(runs, trial, 16 * FINER * FINE_STEPS)
    before = float(np.sum((runs.run_one(trial) - expected) ** 2))
    again = with_finer_steps(runs, tuning, selection)
    assert float(np.sum((runs.run_one(trial) - expected) ** 2)) < 0.01 * before
    assert np.array_equal(again.predicted, runs.run_one(Trial(again.values)))
    assert cost_of(runs, again) <= cost_of(runs, tuning) + 1.0


def test_steps_stay_where_nothing_was_found_or_they_err_as_before(runs):
    tuning = retune(runs)
    assert with_finer_steps(runs, tuning, chosen_of(None)) is tuning
    rubs = beside(EffectAt("coulomb_friction", "carriage"), [1.0], tuning, cost_of(runs, tuning))
    assert with_finer_steps(runs, tuning, rubs) is tuning


@pytest.mark.parametrize(("by_numbers", "stay"), [(0.0, True), (REMOVED, False)])
def test_steps_stay_where_the_effects_own_equation_may_err_by_more(runs, by_numbers, stay):
    """A law errs by 1 % of what it removes, numbers by 1e-5."""
    tuning = retune(runs)
    large = beside(*SPRING, tuning, cost_of(runs, tuning) - REMOVED, by_numbers)
    assert (with_finer_steps(runs, tuning, large) is tuning) is stay


def test_steps_are_refined_beside_a_set_that_another_way_fitted_closer_as_well(runs):
    tuning = retune(runs)
    found = beside(*SPRING, tuning, cost_of(runs, tuning))
    again = chosen_of(replace(found.chosen), *found.contenders)
    assert again.chosen is not found.contenders[0].fitted
    assert with_finer_steps(runs, tuning, again) is not tuning
