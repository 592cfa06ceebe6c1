"""What a proposal cannot know is found by fits: a wave's frequency between two lines, an age that grows, a number beyond its tolerance."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from carriage import DAMPING, MACHINE, RATE_Hz, disturbance, recording, reference, repeats, run
from scipy.interpolate import CubicSpline

from hil.diagnosis.model_choice.choose import choose_effects
from hil.diagnosis.model_choice.covariance import scattered
from hil.diagnosis.model_choice.fitting import fit
from hil.diagnosis.model_choice.search import library, proposed
from hil.diagnosis.residuals.residuals import residuals_of
from hil.recording import Channel, Recording

REPEATS, DURATION_s = 3, 5.0
PUSH_N, PUSH_Hz, PUSH_rad = 8.0, 7.153, 0.6  # lines of 5 s are looked at 0.1 Hz apart
LATE_s, GROWING = 0.0006, 0.0004


def test_a_force_between_two_lines_of_the_spectrum_is_named_with_its_frequency() -> None:
    wanted = reference(DURATION_s)
    push = PUSH_N * np.sin(2.0 * np.pi * PUSH_Hz * np.arange(len(wanted)) / RATE_Hz + PUSH_rad)
    forces = [push + disturbance(len(wanted), 1.0, seed) for seed in range(REPEATS)]
    pushed = {f"run_{seed}": recording(wanted, *run(wanted, force_N=force, noise_seed=seed)) for seed, force in enumerate(forces)}
    found = choose_effects(residuals_of(MACHINE, pushed)).best
    assert [(one.name, one.at) for one in found.settings] == [("base_motion", "carriage")]
    p = found.settings[0].parameters
    assert p["f"] == pytest.approx(PUSH_Hz, abs=0.01)
    assert p["A"] == pytest.approx(PUSH_N, rel=0.15)  # efforts have the drive's scale
    assert p["phi"] == pytest.approx(PUSH_rad, abs=0.2)


def test_an_age_that_grows_from_more_than_nothing_is_fitted_whole() -> None:
    def aged(one: Recording) -> Recording:
        time_s, position = one["time"], one["position_carriage"]
        late = CubicSpline(time_s, position)(np.maximum(time_s * (1.0 - GROWING) - LATE_s, 0.0))
        return replace(one, channels={**one.channels, "position_carriage": Channel("m", late)})

    found = choose_effects(residuals_of(MACHINE, {key: aged(one) for key, one in repeats(REPEATS, DURATION_s).items()}))
    of = {(law.effect.name, law.at): law.setting(weights) for law, weights in proposed(found.plain, library(found.linear), 1, 1.0)}
    fitted = fit(found.linear, [of["clock_offset", "position_carriage"]])
    assert fitted is not None
    p = fitted.settings[0].parameters
    deviations = dict(zip(("t0", "delta"), scattered(fitted)[-2:], strict=True))
    assert deviations["t0"] < 0.12 / RATE_Hz  # an eighth of a row
    assert p["t0"] == pytest.approx(LATE_s, abs=3.0 * deviations["t0"])
    assert p["delta"] == pytest.approx(GROWING, abs=3.0 * deviations["delta"])


def test_a_law_is_proposed_in_place_of_a_number_on_its_bound() -> None:
    found = choose_effects(residuals_of(MACHINE, repeats(REPEATS, damping=1.8 * DAMPING)))
    assert found.plain.is_pressed[found.linear.numbers.names.index("carriage.damping")]
    laws = [(law.effect.name, law.at) for law, _ in proposed(found.plain, library(found.linear), found.linear.readings, 1.0)]
    assert ("viscous_friction", "carriage") in laws
