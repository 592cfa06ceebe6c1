"""The verdicts, on a carriage that is simulated apart from the project (carriage.py): one case each."""

from __future__ import annotations

import json
import re
import tomllib
from pathlib import Path

import numpy as np
import pytest
from carriage import DAMPING, MACHINE, MASS_kg, disturbance, recording, reference, repeats, run

from hil.diagnosis.diagnose import diagnose
from hil.diagnosis.files import write_diagnosis
from hil.diagnosis.verdict.values import Outcome
from hil.machine import load_machine
from hil.machine.effects_file import read_effects_file
from hil.recording import Recording
from virtual_bus.plant.parameters import plant_parameters

COULOMB_N = 20.0  # of the friction in conftest.py


def test_coulomb_friction_is_named_with_its_strength(friction: Outcome) -> None:
    diagnosis = friction.diagnosis
    assert diagnosis.verdict == "explained"
    assert [str(finding.effect) for finding in diagnosis.findings] == ["coulomb_friction at carriage"]
    strength = diagnosis.findings[0].parameters["Fc"]
    # force and gain only show in their ratio, and the gain may be wrong by a tenth: the interval says so
    assert strength.unit == "N"
    assert strength.ci95[0] < COULOMB_N < strength.ci95[1]
    assert strength.value == pytest.approx(COULOMB_N, rel=0.15)
    first, *others = diagnosis.hypotheses
    assert first.is_confirmed
    assert first.parameters == 1
    assert all(h.gained <= 1.01 * first.gained for h in others)


def test_the_extended_machine_predicts_recordings_it_was_not_fitted_to_down_to_noise(friction: Outcome) -> None:
    fit = friction.diagnosis.fit
    assert fit.held_out is not None
    assert fit.horizon_s == pytest.approx(1.0 / MACHINE.sample_rate_Hz)
    nominal, retuned, extended = fit.held_out.nominal, fit.held_out.retuned, fit.held_out.extended
    assert nominal is not None
    assert retuned is not None
    assert extended is not None
    assert fit.removed_share is not None
    assert nominal > retuned > 2.0 * extended
    assert extended == pytest.approx(1.0, abs=0.1)
    assert fit.removed_share > 0.9


def test_held_out_recordings_that_an_answer_does_not_predict_take_its_assurance_away(
    with_friction: tuple[dict[str, Recording], dict[str, Recording]],
) -> None:
    pushed = repeats(1, experiment=1, duration_s=2.0, mass=1.05 * MASS_kg, coulomb_N=COULOMB_N, load_N=30.0)
    diagnosis = diagnose(MACHINE, with_friction[0], pushed).diagnosis
    assert [str(finding.effect) for finding in diagnosis.findings] == ["coulomb_friction at carriage"]
    assert diagnosis.verdict == "ambiguous"
    said = re.search(r"of those held out (\d+)% of the mismatch is left$", diagnosis.reason)
    assert said, diagnosis.reason
    errors = diagnosis.fit.held_out
    assert errors is not None
    assert errors.retuned is not None
    assert errors.extended is not None
    assert int(said[1]) == pytest.approx(100.0 * (errors.extended**2 - 1.0) / (errors.retuned**2 - 1.0), abs=1.0)


def test_the_answer_is_written_as_promised(friction: Outcome, tmp_path: Path) -> None:
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


def test_the_files_of_the_answer_load_and_hold_what_was_found(friction: Outcome, tmp_path: Path) -> None:
    write_diagnosis(friction, MACHINE, tmp_path)
    machine = load_machine(tmp_path / "machine.toml")
    (effect,) = read_effects_file(tmp_path / "effects.toml", machine)
    assert effect.parameters["Fc"] == pytest.approx(friction.diagnosis.findings[0].parameters["Fc"].value)
    written = tomllib.loads((tmp_path / "machine.toml").read_text())["body"][0]["mass_kg"]
    names = [f"{one.owner}.{one.quantity}" for one in plant_parameters(MACHINE.plant)]
    mass = friction.values[names.index("carriage.mass")]
    assert MASS_kg < mass < 1.15 * MASS_kg
    assert written == pytest.approx(mass, rel=1e-3)
    assert "machine.toml has " in friction.diagnosis.frozen["carriage.mass"]  # only ratios to the drive's constant show


def test_other_numbers_alone_are_no_missing_physics() -> None:
    truth = {"mass": 1.09 * MASS_kg, "damping": 0.92 * DAMPING, "duration_s": 4.0, "seed": 7}
    found = diagnose(MACHINE, repeats(**truth), repeats(1, experiment=1, **truth)).diagnosis
    assert found.verdict == "retuned"
    assert "these recordings shake the machine up to" in found.reason
    assert found.findings == ()


def test_nothing_is_found_where_nothing_is_missing() -> None:
    found = diagnose(MACHINE, repeats(seed=5, duration_s=4.0), repeats(1, experiment=1, seed=5, duration_s=4.0)).diagnosis
    assert found.verdict == "consistent"
    assert "a resonance above may hide" in found.reason
    assert found.fit.held_out is not None
    assert found.fit.held_out.nominal == pytest.approx(1.0, abs=0.1)


def test_a_ripple_of_half_a_newton_beside_a_newton_of_disturbances_is_named() -> None:
    truth = {"at": lambda x: 0.5 * np.cos(900.0 * x + 0.4), "duration_s": 3.0, "seed": 9}
    found = diagnose(MACHINE, repeats(**truth), repeats(1, experiment=1, **truth)).diagnosis
    assert found.verdict == "explained"
    assert [str(finding.effect) for finding in found.findings] == ["cogging at carriage"]
    for name, value in {"Np": 900.0, "A1": 0.5, "phi1": 0.4}.items():
        low, high = found.findings[0].parameters[name].ci95
        assert low < value < high


@pytest.mark.nightly
def test_periods_of_one_recording_are_its_repeats() -> None:
    """Eight periods of a second, the first of which settles."""
    period = 1000
    wanted = np.tile(0.03 * (1.0 - np.cos(2.0 * np.pi * np.arange(period) / period)), 8)
    one = recording(wanted, *run(wanted, coulomb_N=COULOMB_N, force_N=_shaken(len(wanted))))
    one = one.with_metadata(experiment={"start_pose": [0.0], "period_samples": period, "settle_periods": 1})
    found = diagnose(MACHINE, {"periodic": one}).diagnosis
    assert found.noise == "periods"
    assert [str(finding.effect) for finding in found.findings] == ["coulomb_friction at carriage"]
    spans = found.location.time_s.get("periodic", ())
    assert all(1.0 <= low < high <= 8.0 for low, high in spans)


def _shaken(rows: int) -> np.ndarray:
    random = np.random.default_rng(3)
    slow = np.convolve(random.standard_normal(rows + 400), np.ones(400) / 20.0, mode="valid")[:rows]
    return np.asarray(slow)


@pytest.mark.nightly
def test_pushes_three_times_as_large_as_the_disturbances_are_no_physics() -> None:
    """For a tenth of a second, once in every repeat, at another time each."""
    wanted = reference(4.0)
    pushed: dict[str, Recording] = {}
    for number in range(4):
        force = disturbance(len(wanted), 1.0, seed=40 + number)
        begin = 700 + 800 * number
        force[begin : begin + 100] += 3.0
        pushed[f"run {number}"] = recording(wanted, *run(wanted, force_N=force, noise_seed=number))
    found = diagnose(MACHINE, pushed).diagnosis
    assert found.verdict in ("consistent", "retuned")
    assert found.findings == ()


@pytest.mark.parametrize("rows", [6, 40])
def test_too_few_rows_are_said_to_be_too_few(rows: int) -> None:
    short = {name: one.part(slice(rows)) for name, one in repeats(3, duration_s=0.6).items()}
    found = diagnose(MACHINE, short).diagnosis
    assert found.verdict == "inconclusive"
    assert f"{rows} rows" in found.reason
    assert "record 100 at least" in found.reason


@pytest.mark.nightly
def test_a_stop_that_every_repeat_meets_once_is_named() -> None:
    """It shows in a twentieth of the recordings, and in all of them: a disturbance would show in one."""
    farthest = float(np.max(reference(3.0)))
    truth = {"at": lambda x: -3e4 * max(x - farthest + 1.5e-3, 0.0), "duration_s": 3.0, "seed": 11}
    found = diagnose(MACHINE, repeats(**truth)).diagnosis
    (stop,) = (finding for finding in found.findings if str(finding.effect) == "end_stop at carriage")
    assert stop.parameters["at_position"].value == pytest.approx(farthest - 1.5e-3, abs=1e-3)  # its law is fitted beside others
