"""The verdicts, on a carriage that is simulated apart from the project (carriage.py): one case each, and labels that lie."""

from __future__ import annotations

import json
import tomllib

import numpy as np
import pytest
from carriage import DAMPING, MACHINE, MASS_kg, recording, repeats

from hil.diagnosis.diagnose import diagnose
from hil.diagnosis.files import write_diagnosis
from hil.diagnosis.judging.errors_of_laws import WEIGHTS
from hil.diagnosis.ranking.naming import STANDS_ALONE
from hil.machine import load_machine
from hil.machine.effects_file import read_effects_file

COULOMB_N = 20.0  # of the friction in conftest.py


@pytest.mark.slow
def test_coulomb_friction_is_named_with_its_strength(friction):
    diagnosis = friction.diagnosis
    assert diagnosis.verdict in ("explained", "ambiguous")
    assert diagnosis.findings[0].effect.effect == "coulomb_friction"
    strength = diagnosis.findings[0].parameters["Fc"]
    # force and gain only show in their ratio, and the gain may be wrong by a tenth: the interval says so
    assert strength.unit == "N"
    assert strength.ci95[0] < COULOMB_N < strength.ci95[1]
    assert strength.value == pytest.approx(COULOMB_N, rel=0.15)


def test_the_extended_machine_fits_recordings_it_was_not_fitted_to(friction):
    fit = friction.diagnosis.fit
    assert fit.held_out.nominal > fit.held_out.retuned > 2.0 * fit.held_out.extended
    assert fit.held_out.extended < 1.5
    assert fit.held_out.placebo > 2.0 * fit.held_out.extended
    assert fit.removed_share > 0.9


def test_the_answer_is_written_as_promised(friction, tmp_path):
    write_diagnosis(friction, MACHINE, tmp_path)
    document = json.loads((tmp_path / "diagnosis.json").read_text())
    promised = {"verdict", "findings", "hypotheses", "retuned", "noise", "location", "fit", "unexplained_share", "seconds"}
    assert promised <= set(document)
    finding = {"effect", "at", "confidence", "parameters", "ambiguous_with", "separating_experiment", "evidence_for", "evidence_against"}
    assert finding <= set(document["findings"][0])
    assert set(document["findings"][0]["parameters"]["Fc"]) == {"value", "unit", "ci95"}
    assert sum(hypothesis["confidence"] for hypothesis in document["hypotheses"]) <= 1.0 + 1e-9
    stages = {"nominal", "retuned", "extended", "placebo", "noise_floor", "baseline"}
    assert set(document["fit"]["train"]) == set(document["fit"]["held_out"]) == stages
    assert all(set(channel) == stages for channel in document["fit"]["channels"].values())
    assert sum(document["location"]["channels"].values()) == pytest.approx(1.0)
    assert document["noise"] == "repeats"


def test_the_files_of_the_answer_load_and_hold_what_was_found(friction, tmp_path):
    write_diagnosis(friction, MACHINE, tmp_path)
    machine = load_machine(tmp_path / "machine.toml")
    (effect,) = read_effects_file(tmp_path / "effects.toml", machine)
    assert effect.parameters["Fc"] == pytest.approx(friction.diagnosis.findings[0].parameters["Fc"].value)
    written = tomllib.loads((tmp_path / "machine.toml").read_text())["body"][0]["mass_kg"]
    mass = friction.diagnosis.retuned["carriage.mass"]
    assert written == pytest.approx(mass.value, abs=1e-3 * (mass.ci95[1] - mass.ci95[0]))  # with the digits that its interval supports


def test_other_numbers_alone_are_no_missing_physics():
    truth = {"mass": 1.09 * MASS_kg, "damping": 0.92 * DAMPING, "duration_s": 4.0, "seed": 7}
    outcome = diagnose(MACHINE, repeats(**truth), repeats(1, experiment=1, **truth))
    assert outcome.diagnosis.verdict == "retuned"
    assert "beyond them no physics shows; these recordings shake the machine up to" in outcome.diagnosis.reason
    assert outcome.diagnosis.findings == ()


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("force_N", "verdict", "confidence"), [(0.24, "ambiguous", 1.0 - WEIGHTS.outside), (0.5, "explained", STANDS_ALONE)]
)
def test_a_name_stands_alone_where_recordings_show_it_by_more_than_another_law_could_imitate(force_N, verdict, confidence):
    """And is as sure as such names have been right."""
    truth = {"at": lambda x: force_N * np.cos(900.0 * x + 0.4), "duration_s": 3.0, "seed": 9}
    outcome = diagnose(MACHINE, repeats(**truth), repeats(1, experiment=1, **truth), look_further=False)
    assert [str(finding.effect) for finding in outcome.diagnosis.findings] == ["cogging at carriage"]
    assert outcome.diagnosis.verdict == verdict
    assert outcome.diagnosis.findings[0].confidence == pytest.approx(outcome.diagnosis.hypotheses[0].confidence)
    assert outcome.diagnosis.findings[0].confidence == pytest.approx(confidence * outcome.hypotheses[0].share, rel=0.02)
    assert ("another law, known or not, may look like so little" in outcome.diagnosis.reason) == (verdict == "ambiguous")


@pytest.mark.nightly
def test_what_the_held_out_recording_alone_shows_is_not_called_other_numbers():
    """Numbers that are off there explain themselves; a wave that only that motion passes does not, and is located there."""
    truth = {"mass": 1.09 * MASS_kg, "duration_s": 3.0, "seed": 7}
    with_wave = repeats(1, experiment=1, at=lambda x: 40.0 * np.cos(900.0 * x), **truth)
    found = diagnose(MACHINE, repeats(**truth), with_wave, look_further=False).diagnosis
    assert found.verdict == "unknown_physics" and found.findings == ()
    assert "record such a motion for training, too" in found.reason
    assert set(found.location.time_s) <= set(with_wave) and sum(found.location.channels.values()) == pytest.approx(1.0)
    heavier = repeats(1, experiment=1, **truth | {"mass": 0.93 * MASS_kg})
    assert diagnose(MACHINE, repeats(**truth), heavier, look_further=False).diagnosis.verdict == "retuned"


def test_nothing_is_found_where_nothing_is_missing():
    outcome = diagnose(MACHINE, repeats(seed=5, duration_s=4.0), repeats(1, experiment=1, seed=5, duration_s=4.0))
    assert outcome.diagnosis.verdict == "consistent"
    assert "a resonance above may hide" in outcome.diagnosis.reason


def test_too_short_a_recording_is_said_to_be_too_short():
    outcome = diagnose(MACHINE, repeats(3, duration_s=0.6))
    assert outcome.diagnosis.verdict == "inconclusive"
    assert "0.6 s" in outcome.diagnosis.reason


@pytest.mark.nightly
@pytest.mark.parametrize("mutation", ["labels negated", "time reversed"])
def test_a_mismatch_of_which_friction_is_not_the_cause_is_not_called_friction(friction, with_friction, mutation):
    stand_in = friction.train.groups[0].simulated[
        :, [friction.train.channels.index(f"{name}_carriage") for name in ("position", "command")]
    ]

    def mutated(found):
        mutants = {}
        for name, original in found.items():
            measured = original.matrix(["position_carriage", "command_carriage"])
            rows = min(len(measured), len(stand_in))
            residual = measured[:rows] - stand_in[:rows]
            residual = -residual if mutation == "labels negated" else residual[::-1]
            values = stand_in[:rows] + residual
            mutants[name] = recording(original["reference_carriage"][:rows], *values.T)
        return mutants

    outcome = diagnose(MACHINE, mutated(with_friction[0]))
    confident = [f.effect.effect for f in outcome.diagnosis.findings if outcome.diagnosis.verdict == "explained"]
    assert "coulomb_friction" not in confident
    assert np.isfinite(outcome.diagnosis.unexplained_share)
