"""What an effect gains counts from the best numbers without it, wherever re-tuning ended (carriage.py: a carriage simulated apart)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from carriage import DAMPING, MACHINE, MASS_kg, repeats

from hil.diagnosis import diagnose as diagnosing
from hil.diagnosis.diagnose import diagnose
from hil.diagnosis.free_run import Trial
from hil.diagnosis.retune import linearised, retune, with_covariance


def stopped_short(runs):
    """Re-tuning that ended where it began."""
    tuning = retune(runs)
    nominal = np.zeros_like(tuning.offset)
    begun = replace(tuning, offset=nominal, values=runs.nominal, predicted=runs.run_one(Trial(runs.nominal)))
    return with_covariance(linearised(runs, begun))


@pytest.fixture
def answer(monkeypatch):
    """Of a carriage whose numbers alone are off, after re-tuning that did not find them."""
    monkeypatch.setattr(diagnosing, "retune", stopped_short)
    truth = {"mass": 1.08 * MASS_kg, "damping": 0.94 * DAMPING, "duration_s": 2.0}
    return diagnose(MACHINE, repeats(**truth), repeats(1, experiment=1, **truth))


def test_numbers_that_fits_of_effects_find_are_the_machines_own(answer):
    assert answer.diagnosis.verdict == "retuned"
    assert answer.diagnosis.findings == ()
    assert answer.diagnosis.fit.train.retuned < 1.1
