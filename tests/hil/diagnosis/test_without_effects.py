"""What an effect gains counts from the best numbers without it, wherever re-tuning ended (carriage.py: a carriage simulated apart)."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from carriage import DAMPING, MACHINE, MASS_kg, repeats

from hil.diagnosis import diagnose as diagnosing
from hil.diagnosis.diagnose import diagnose
from hil.diagnosis.fitting.refit import Fitted
from hil.diagnosis.recorded.align import aligned
from hil.diagnosis.residuals.mismatch import mismatch
from hil.diagnosis.result import EffectAt
from hil.diagnosis.searching import bounded_noise
from hil.diagnosis.searching.bounded_noise import with_bounded_noise
from hil.diagnosis.searching.without_effects import with_its_numbers, without_effects
from hil.diagnosis.tuning.free_run import TRAIN, FreeRuns, Trial
from hil.diagnosis.tuning.retune import Tuning, linearised, retune, tunable, units, with_covariance
from hil.machine import load_machine
from virtual_bus.plant.compiled import compile_plant


def stopped_short(runs):
    """Re-tuning that ended where it began."""
    tuning = retune(runs)
    nominal = np.zeros_like(tuning.offset)
    begun = replace(tuning, offset=nominal, values=runs.nominal, predicted=runs.run_one(Trial(runs.nominal)))
    return with_covariance(linearised(runs, begun))


TRUTH = {"mass": 1.08 * MASS_kg, "damping": 0.94 * DAMPING, "duration_s": 2.0}
"""A carriage whose numbers alone are off."""


@pytest.mark.nightly
def test_numbers_that_fits_of_effects_find_are_the_machines_own(monkeypatch):
    monkeypatch.setattr(diagnosing, "retune", stopped_short)
    shares = []
    answer = diagnose(MACHINE, repeats(**TRUTH), repeats(1, experiment=1, **TRUTH), report=lambda what, share: shares.append(share))
    assert answer.diagnosis.verdict == "retuned"
    assert answer.diagnosis.findings == ()
    assert answer.diagnosis.fit.train.retuned < 1.1
    assert shares == sorted(shares)  # the search that is begun once more does not go back


@pytest.mark.nightly
def test_a_bound_on_the_noise_is_that_of_the_best_numbers_as_well(monkeypatch):
    train = mismatch(MACHINE, aligned(MACHINE, repeats(1, **TRUTH)))
    whole = with_bounded_noise(train, 1, lambda what, share: None)
    monkeypatch.setattr(bounded_noise, "retune", stopped_short)
    assert with_bounded_noise(train, 1, lambda what, share: None).noise.std == pytest.approx(whole.noise.std, rel=0.002)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("effect", "values", "is_tuning"),
    [
        (EffectAt("payload", "carriage"), [0.08 * MASS_kg], True),
        (EffectAt("payload", "carriage"), [0.3 * MASS_kg], False),  # beyond what re-tuning may do
        (EffectAt("viscous_friction", "carriage"), [0.1 * DAMPING], True),
        (EffectAt("coulomb_friction", "carriage"), [0.1], False),  # no number of the machine file
    ],
)
def test_an_effect_that_is_a_number_within_re_tunings_bounds_is_that_number(effect, values, is_tuning):
    with FreeRuns({TRAIN: (found := mismatch(MACHINE, aligned(MACHINE, repeats(**TRUTH))))}, found.noise) as runs:
        tuning = retune(runs)
        nominal = np.zeros_like(tuning.offset)
        fit = fitted(effect, np.array(values), nominal, runs.measured())
        offset = with_its_numbers(tuning, fit, MACHINE.plant)
        assert (offset is not None) is is_tuning
        if offset is not None:
            by_the_effect = runs.run_one(Trial(tuning.at(nominal), fit.settings))
            assert runs.run_one(Trial(tuning.at(offset))) == pytest.approx(by_the_effect, abs=1e-6)


@pytest.mark.parametrize(("shape", "factor", "is_tuning"), [(0.0, 1.02, True), (0.25, 1.02, False), (0.0, 1.05, False)])
def test_an_imus_low_pass_is_a_number_where_it_is_of_first_order_and_as_far_off_as_a_clock(shape, factor, is_tuning):
    carm = load_machine("carm")
    parameters = compile_plant(carm.plant).parameters
    values = np.array([parameter.value for parameter in parameters])
    indices = tunable(parameters)
    tuning = Tuning(
        parameters, indices, units(parameters, indices), np.zeros(len(indices)), values, np.zeros(1), np.zeros((1, 0)), np.eye(0)
    )
    bandwidths = [index for index in indices if parameters[index].quantity.endswith("_bandwidth")]
    fit = fitted(EffectAt("imu_bandwidth", "imu"), np.array([factor * values[bandwidths[0]], shape]), tuning.offset, np.zeros(1))
    offset = with_its_numbers(tuning, fit, carm.plant)
    assert (offset is not None) is is_tuning
    if offset is not None:
        assert tuning.at(offset)[bandwidths] == pytest.approx(factor * values[bandwidths[0]])


def test_re_tuning_that_stopped_short_goes_on_from_a_number_that_was_taken_for_an_effect():
    with FreeRuns({TRAIN: (found := mismatch(MACHINE, aligned(MACHINE, repeats(**TRUTH))))}, found.noise) as runs:
        short = stopped_short(runs)
        fit = fitted(EffectAt("payload", "carriage"), np.array([0.05 * MASS_kg]), np.zeros_like(short.offset), runs.measured())
        again = without_effects(runs, short, SimpleNamespace(contenders=[SimpleNamespace(fitted=fit)], closest=None))
        left = float(np.mean((runs.measured() - again.predicted) ** 2))
    assert left < 1.1


def fitted(effect: EffectAt, values: np.ndarray, offset: np.ndarray, predicted: np.ndarray) -> Fitted:
    return Fitted((effect,), (values,), offset, predicted, 0.0, ((0, 0),), np.zeros((len(predicted), 1)), np.ones(1))
