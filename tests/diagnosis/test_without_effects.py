"""What an effect gains counts from the best numbers without it, wherever re-tuning ended (carriage.py: a carriage simulated apart)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from carriage import DAMPING, MACHINE, MASS_kg, repeats

from hil.diagnosis import bounded_noise
from hil.diagnosis import diagnose as diagnosing
from hil.diagnosis.align import aligned
from hil.diagnosis.bounded_noise import with_bounded_noise
from hil.diagnosis.diagnose import diagnose
from hil.diagnosis.free_run import Trial
from hil.diagnosis.mismatch import mismatch
from hil.diagnosis.retune import linearised, retune, with_covariance


def stopped_short(runs):
    """Re-tuning that ended where it began."""
    tuning = retune(runs)
    nominal = np.zeros_like(tuning.offset)
    begun = replace(tuning, offset=nominal, values=runs.nominal, predicted=runs.run_one(Trial(runs.nominal)))
    return with_covariance(linearised(runs, begun))


TRUTH = {"mass": 1.08 * MASS_kg, "damping": 0.94 * DAMPING, "duration_s": 2.0}
"""A carriage whose numbers alone are off."""


def test_numbers_that_fits_of_effects_find_are_the_machines_own(monkeypatch):
    monkeypatch.setattr(diagnosing, "retune", stopped_short)
    shares = []
    answer = diagnose(MACHINE, repeats(**TRUTH), repeats(1, experiment=1, **TRUTH), report=lambda what, share: shares.append(share))
    assert answer.diagnosis.verdict == "retuned"
    assert answer.diagnosis.findings == ()
    assert answer.diagnosis.fit.train.retuned < 1.1
    assert shares == sorted(shares)  # the search that is begun once more does not go back


def test_a_bound_on_the_noise_is_that_of_the_best_numbers_as_well(monkeypatch):
    train = mismatch(MACHINE, aligned(MACHINE, repeats(1, **TRUTH)))
    whole = with_bounded_noise(train, 1, lambda what, share: None)
    monkeypatch.setattr(bounded_noise, "retune", stopped_short)
    assert with_bounded_noise(train, 1, lambda what, share: None).noise.std == pytest.approx(whole.noise.std, rel=0.002)
