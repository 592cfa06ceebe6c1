"""Claims of the total covariance over poses that are distorted: excited alike they are distorted alike, and that does not average out."""

from __future__ import annotations

import numpy as np
import pytest
from simulated_loop import SAMPLE_RATE_HZ, experiment, orthogonal_multisine, two_mode_loop

from hil.identification import FrequencyResponse, LocalModel, PoseModel, nd_local, periodic_records

PERIOD, LINES, DRAWS = 1024, np.arange(1, 90), 16
POSES = np.linspace(-1.0, 1.0, 5)
MODEL = LocalModel(numerator=3, plant_window=9)
OVER_POSES = PoseModel((1,), (1,), (2,))


def draw(rng: np.random.Generator, *, alike: bool) -> FrequencyResponse:
    """The middle pose's response, with a cubic spring and next to no noise."""
    excitation = orthogonal_multisine(rng, PERIOD, LINES)[None, :1]
    made = []
    for pose in POSES:
        loop = two_mode_loop(frequencies_Hz=(3.0 + 0.003 * pose, 7.0), damping=(0.5, 0.5), lag=0.5, cubic=2e-4)
        excitations = excitation if alike else orthogonal_multisine(rng, PERIOD, LINES)[None, :1]
        data = experiment(
            loop, rng, realisations=1, periods=4, period=PERIOD, lines=LINES, noise=(1e-3, 1e-4, 1e-4), excitations=excitations
        )
        made.append(periodic_records(**data, period_samples=PERIOD, sample_rate_Hz=SAMPLE_RATE_HZ, pose=(0.0, pose)))
    return nd_local(made, MODEL, OVER_POSES)[2]


@pytest.mark.nightly
@pytest.mark.parametrize("alike", [True, False], ids=["excited-alike", "excited-differently"])
def test_the_total_variance_is_that_over_draws_of_phases(alike: bool) -> None:
    rng = np.random.default_rng(95)
    made = [draw(rng, alike=alike) for _ in range(DRAWS)]
    spread = np.var([response.G for response in made], axis=0, ddof=1)
    reported = np.mean([response.standard_deviation("total") ** 2 for response in made], axis=0)
    noise = np.mean([response.standard_deviation("noise") ** 2 for response in made], axis=0)
    assert np.exp(np.mean(np.log(reported / spread))) == pytest.approx(1.0, abs=0.3)
    assert np.median(reported / noise) > 10.0
    assert alike == any("excited alike" in note for note in made[0].notes)
