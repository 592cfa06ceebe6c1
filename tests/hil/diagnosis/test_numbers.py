"""Numbers of the file that are wrong by far are findings of their own: recordings by Euler steps that share nothing with the simulator."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hil.diagnosis.diagnose import diagnose
from hil.diagnosis.verdict.answer import NO_HELP
from hil.diagnosis.verdict.values import Outcome
from hil.machine.load import machine_from_text
from tests.hil.diagnosis.pushed_mass import RAIL, MASS_kg, recorded

SECONDS = 20.0


def reference(seed: int) -> np.ndarray:
    time_s = np.arange(round(SECONDS * RAIL.sample_rate_Hz)) / RAIL.sample_rate_Hz
    phases = np.random.default_rng(seed).uniform(0.0, 6.3, 3)
    gate = 0.5 - 0.5 * np.cos(np.pi * np.clip(time_s / 0.5, 0.0, 1.0))
    waves = zip((0.12, 0.03, 0.01), (0.4, 1.3, 3.1), phases, strict=True)
    return np.asarray(gate * sum(a * np.sin(2.0 * np.pi * f * time_s + p) for a, f, p in waves))


def nothing(_time: float, _position: float, _speed: float) -> float:
    return 0.0


@pytest.fixture(scope="module")
def heavier() -> Outcome:
    """A file that says a third of the mass, one recording to fit and another held out."""
    machine = replace(
        machine_from_text(RAIL.text.replace("mass_kg = 20.0", f"mass_kg = {MASS_kg / 3.0}"), label="rail.toml"), controllers=()
    )
    return diagnose(machine, {"run": recorded(reference(11), nothing, 12)}, {"other": recorded(reference(13), nothing, 14)})


def test_a_mass_three_times_the_files_is_a_finding_with_what_the_file_says(heavier: Outcome) -> None:
    (finding,) = heavier.diagnosis.findings
    document = finding.document()
    assert (document["kind"], document["number"], document["at"]) == ("number", "block.mass", "block")
    value = document["parameters"]["value"]
    assert value["nominal"] == pytest.approx(MASS_kg / 3.0)
    assert value["value"] == pytest.approx(MASS_kg, rel=0.01)
    assert 0.9 * MASS_kg < value["ci95"][0] < value["ci95"][1] < 1.1 * MASS_kg
    assert heavier.diagnosis.verdict == "explained"
    assert "block.mass" in heavier.diagnosis.reason


def test_the_machine_that_is_found_predicts_the_recording_that_was_held_out(heavier: Outcome) -> None:
    stages = heavier.diagnosis.fit.held_out
    assert stages is not None
    assert stages.nominal is not None
    assert stages.extended is not None
    assert stages.extended < 0.1 * stages.nominal
    assert heavier.effects == ()


@pytest.mark.nightly
def test_a_machine_that_is_its_file_is_left_as_it_is() -> None:
    machine = replace(RAIL, controllers=())
    outcome = diagnose(machine, {"run": recorded(reference(15), nothing, 16)})
    assert outcome.diagnosis.verdict in ("consistent", "retuned")
    assert outcome.diagnosis.findings == ()
    assert outcome.effects == ()
    mass = outcome.diagnosis.retuned.get("block.mass")
    assert mass is None or mass.value == pytest.approx(MASS_kg, rel=0.01)


def rubs(_time: float, _position: float, speed: float) -> float:
    return -14.0 * float(np.tanh(speed / 1e-3))


@pytest.mark.nightly
def test_a_recording_held_out_that_has_not_what_is_named_takes_the_assurance_away() -> None:
    machine = replace(RAIL, controllers=())
    runs = {"run": recorded(reference(17), rubs, 18)}, {"other": recorded(reference(19), nothing, 20)}
    diagnosis = diagnose(machine, *runs).diagnosis
    assert [finding.effect.effect for finding in diagnosis.findings] == ["coulomb_friction"]
    assert (diagnosis.verdict, diagnosis.findings[0].evidence_against) == ("ambiguous", (NO_HELP,))
    assert NO_HELP in diagnosis.reason
