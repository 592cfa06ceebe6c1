"""How strong the noise is that repeats show: an independent recursion's disturbances are found again, however weak they are."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.signal
from carriage import MACHINE, RATE_Hz, disturbance, recording, reference, repeats, run

from hil.diagnosis.model_choice.choose import choose_effects
from hil.diagnosis.residuals.residuals import residuals_of

LOAD_N = 0.4
TONE_Hz, TONE_N = 11.0, 3.0
REPEATS, DURATION_s = 4, 6.0


@pytest.mark.parametrize("rms_N", [1.0, 3.0, 20.0])
def test_a_disturbance_of_4_hz_is_as_strong_and_as_fast_as_it_is(rms_N: float) -> None:
    residuals = residuals_of(MACHINE, repeats(4, disturbance_N=rms_N))
    levels = residuals.levels.single
    assert levels is not None
    assert levels.corner_Hz == 5.0  # the nearest one that is tried
    assert levels.disturbance[0] == pytest.approx(rms_N, rel=0.25)


def test_a_load_that_weak_noise_does_not_hide_is_named() -> None:
    best = choose_effects(residuals_of(MACHINE, repeats(4, duration_s=6.0, disturbance_N=0.3, load_N=LOAD_N))).best
    assert [(setting.name, setting.at) for setting in best.settings] == [("constant_load", "carriage")]
    assert best.settings[0].parameters["tau0"] == pytest.approx(LOAD_N, rel=0.1)


def test_a_narrow_band_is_a_tone_and_no_mode() -> None:
    print(f"seeds 0 to {REPEATS - 1}")
    wanted = reference(DURATION_s)
    b, a = scipy.signal.butter(1, [0.96 * TONE_Hz, 1.04 * TONE_Hz], btype="bandpass", fs=RATE_Hz)
    hummed = {}
    for seed in range(REPEATS):
        white = np.random.default_rng(seed).standard_normal(len(wanted) + 4000)
        hum = scipy.signal.lfilter(b, a, white)[4000:]
        force = TONE_N * hum / hum.std() + disturbance(len(wanted), 0.3, seed)
        hummed[f"run_{seed}"] = recording(wanted, *run(wanted, force_N=force, noise_seed=seed))
    residuals = residuals_of(MACHINE, hummed)
    assert residuals.levels.single is not None
    tones = residuals.levels.single.tones
    assert tones is not None
    assert tones.frequencies_Hz[0] == pytest.approx(TONE_Hz, rel=0.06)  # levels are of the first 1.2 s, and the band is 8 % wide
    assert tones.sizes[0] == pytest.approx(TONE_N, rel=0.3)
    assert residuals.levels.single.disturbance[0] < 0.5 * TONE_N  # else it would be a slow one that hides loads
    assert choose_effects(residuals).best.settings == ()
