"""Recordings without repeats or without a known controller: audited, seen, named, proved, and answered by the command."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from carriage import MACHINE, MASS_kg, recording, repeats
from command_line import Isocenter
from places import DATA, needs_data

from hil.diagnosis.model_choice.alternatives import detection_limits
from hil.diagnosis.model_choice.choose import Choice, choose_effects
from hil.diagnosis.model_choice.fitting import fit
from hil.diagnosis.model_choice.search import library
from hil.diagnosis.prediction.open_runs import predicted
from hil.diagnosis.prediction.refitting import refitted
from hil.diagnosis.residuals.residuals import residuals_of
from hil.machine.effects_file import read_effects_file
from hil.machine.load import machine_from_text
from hil.recording import Channel, Recording, write_recording
from virtual_bus.settings import EffectSetting

COULOMB_N, LOAD_N = 20.0, 6.0
TRUTH = {"coulomb_N": COULOMB_N, "load_N": LOAD_N, "duration_s": 6.0}


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    for number, (label, each) in enumerate({**repeats(1, **TRUTH), **repeats(1, experiment=1, **TRUTH)}.items()):
        write_recording(each, tmp_path / f"{'train' if number == 0 else 'held'}_{label}.csv")
    return tmp_path


@pytest.fixture(scope="module")
def rubbing() -> Choice:
    return choose_effects(residuals_of(MACHINE, repeats(1, **TRUTH)))


def answer(isocenter: Isocenter, folder: Path, *words: str, status: int = 0) -> tuple[dict[str, Any], str]:
    """The document, and what was said on the way."""
    done = isocenter("diagnose", "emps", *words, "-o", str(folder / "found"))
    assert done.status == status, done.err
    return json.loads((folder / "found" / "diagnosis.json").read_text()), done.err


@pytest.mark.nightly
def test_the_command_names_friction_and_load_of_one_recording_after_a_first_answer(folder: Path, isocenter: Isocenter) -> None:
    found, said = answer(isocenter, folder, "train_run_0_0.csv", "--held-out", "held_run_1_0.csv")
    assert "first answer: " in said
    assert "provisional" in said
    found_effects = {finding["effect"]: finding for finding in found["findings"]}
    assert set(found_effects) == {"coulomb_friction", "constant_load"}
    for effect, parameter, truth in (("coulomb_friction", "Fc", COULOMB_N), ("constant_load", "tau0", LOAD_N)):
        low, high = sorted(abs(end) for end in found_effects[effect]["parameters"][parameter]["ci95"])
        assert low <= truth <= high, effect
    assert found["noise"] == "assumed"
    assert found["provisional"] is False
    assert max(finding["confidence"] for finding in found["findings"]) <= 0.9
    assert {one["effect"] for one in found["baseline"]} >= {"coulomb_friction", "constant_load", "viscous_friction"}
    stages = found["fit"]["held_out"]
    assert stages["extended"] < 0.1 * stages["nominal"]
    assert found["audit"]["axes"]["carriage"]["status"] == "unknown"  # its command has noise that no law gives
    assert sum(h["confidence"] for h in found["hypotheses"]) <= 1.0 + 1e-9
    assert {each.name for each in read_effects_file(folder / "found" / "effects.toml", MACHINE)} == set(found_effects)
    machine_from_text((folder / "found" / "machine.toml").read_text(), label="re-tuned")
    assert "coulomb_friction at carriage" in (folder / "found" / "report.html").read_text()


@pytest.mark.nightly
def test_friction_and_load_of_one_recording_are_named(rubbing: Choice) -> None:
    assert {(setting.name, setting.at) for setting in rubbing.best.settings} == {
        ("coulomb_friction", "carriage"),
        ("constant_load", "carriage"),
    }


def test_what_was_seen_is_said_without_a_search(folder: Path, isocenter: Isocenter) -> None:
    done = isocenter("diagnose", "emps", "train_run_0_0.csv", "-o", "found", "--stop-after", "seen", "--json", "-")
    lacking = json.loads(done.out)["seen"]
    assert [(each["recording"], each["joint"], each["unit"]) for each in lacking] == [("train_run_0_0", "carriage", "N")]
    assert not (folder / "found").exists() or not any((folder / "found").iterdir())


def test_another_step_is_refused(folder: Path, isocenter: Isocenter) -> None:
    done = isocenter("diagnose", "emps", "train_run_0_0.csv", "-o", "found", "--stop-after", "all")
    assert done.status == 2
    assert "audit or seen would be right" in done.err


def test_a_carriage_that_stands_says_nothing(tmp_path: Path, isocenter: Isocenter, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    random = np.random.default_rng(3)
    still = 1e-7 * random.standard_normal(2000)
    write_recording(recording(np.zeros(2000), still, 1e-3 * random.standard_normal(2000)), tmp_path / "still.csv")
    found, _ = answer(isocenter, tmp_path, "still.csv", status=1)
    assert found["verdict"] == "inconclusive"
    assert "carriage" in found["reason"]


@pytest.mark.filterwarnings("error:Mean of empty slice")
def test_a_pause_longer_than_a_window_is_no_obstacle() -> None:
    (whole,) = repeats(1, **TRUTH).values()
    kept = (whole.time < 2.0) | (whole.time > 4.5)
    channels = {label: Channel(channel.unit, channel.values[kept]) for label, channel in whole.channels.items()}
    found = refitted(choose_effects(residuals_of(MACHINE, {"paused": Recording(channels, whole.metadata)})))
    assert np.isfinite(found.best.offset).all()


@pytest.mark.nightly
def test_a_friction_of_three_times_its_limit_is_found_and_a_third_is_not() -> None:
    nothing = choose_effects(residuals_of(MACHINE, repeats(1, duration_s=6.0)))
    (limit,) = [each for each in detection_limits(nothing, library(nothing.linear)) if each.effect == "coulomb_friction"]
    assert 0.0 < limit.strength < COULOMB_N
    found = [
        {
            setting.name
            for setting in choose_effects(residuals_of(MACHINE, repeats(1, duration_s=6.0, coulomb_N=by * limit.strength))).best.settings
        }
        for by in (3.0, 1.0 / 3.0)
    ]
    assert "coulomb_friction" in found[0]
    assert "coulomb_friction" not in found[1]


def test_a_refit_keeps_strengths_and_predicts_no_worse(rubbing: Choice) -> None:
    after = refitted(rubbing)
    strengths = {setting.name: setting.parameters for setting in after.best.settings}
    assert strengths["coulomb_friction"]["Fc"] == pytest.approx(COULOMB_N, rel=0.05)
    numbers = rubbing.linear.numbers
    machines = {
        label: (numbers.values(each.best.offset[: len(numbers.indices)]), each.best.settings)
        for label, each in (("before", rubbing), ("after", after))
    }
    errors = predicted(rubbing.residuals.trajectories, {"position_carriage": 1e-7}, machines, "before")
    assert errors is not None
    table = errors.channels["position_carriage"]
    assert table["after"] <= 1.05 * table["before"]


def test_a_gear_whose_losses_would_hide_what_is_not_explained_is_no_better_explanation(rubbing: Choice) -> None:
    """A motor that hardly does anything but overcome friction gives an effort in proportion to it: a bad gear would explain anything."""
    linear = rubbing.linear
    (one,) = linear.records
    gear, dry = EffectSetting("motor_load_friction", "carriage", {"Km": 0.6}), EffectSetting("coulomb_friction", "carriage", {"Fc": 1.0})
    shares = [
        one.equations.trajectory.passed_by_friction(one.motion, one.equations.trajectory.model(None, (each,)))[0] for each in (gear, dry)
    ]
    assert shares[1] == 1.0
    assert 0.4 < shares[0] < 0.95
    load = EffectSetting("constant_load", "carriage", {"tau0": LOAD_N})
    fits = [fit(linear, (each, load), rubbing.best.offset, rubbing.best.dispersion) for each in (gear, dry)]
    assert fits[0] is not None
    assert fits[1] is not None
    assert fits[0].squares > 1.5 * fits[1].squares


@pytest.mark.nightly
def test_a_heavier_carriage_is_a_matter_of_numbers(tmp_path: Path, isocenter: Isocenter, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for label, each in repeats(1, duration_s=6.0, mass=1.1 * MASS_kg).items():
        write_recording(each, tmp_path / f"{label}.csv")
    found = answer(isocenter, tmp_path, "run_0_0.csv")[0]
    assert found["verdict"] == "retuned"
    assert "a resonance above may hide" in found["reason"]


@pytest.mark.nightly
@needs_data("field", "a recording of friction and a load")
def test_where_one_law_and_two_explain_as_much_both_are_listed(
    tmp_path: Path, isocenter: Isocenter, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = DATA / "field" / "17-friction-offset"
    monkeypatch.chdir(tmp_path)
    recordings = [str(folder / f"r{number}.csv") for number in (1, 2, 3)]
    machine = str(DATA / "field" / "work" / "turntable.toml")
    done = isocenter("diagnose", machine, *recordings, "--held-out", str(folder / "h.csv"), "-o", "found", "-j", "1")
    assert done.status == 0, done.err
    found = json.loads((tmp_path / "found" / "diagnosis.json").read_text())
    sets = [{effect["effect"] for effect in hypothesis["effects"]} for hypothesis in found["hypotheses"][:2]]
    assert found["verdict"] == "ambiguous"
    assert {"coulomb_friction", "constant_load"} in sets


FIELD = {
    "39d-cogging-and-friction": {("coulomb_friction", "Fc"): 2.2, ("cogging", "Np"): 7.0, ("cogging", "A1"): 1.4},
    "39e-stick-slip": {("coulomb_friction", "Fc"): 4.0, ("stribeck_friction", "Fs_minus_Fc"): 3.5, ("stribeck_friction", "vs"): 0.004},
    "39f-gear-ratio-94": {("gear_ratio", "beta"): -0.06},
}


@pytest.mark.nightly
@needs_data("field", "recordings of a turntable")
@pytest.mark.parametrize("name", FIELD)
def test_what_the_motion_does_not_settle_simulations_do(
    name: str, tmp_path: Path, isocenter: Isocenter, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Recordings without metadata: the controller's states at row 0 follow from its command."""
    folder = DATA / "field" / name
    monkeypatch.chdir(tmp_path)
    recordings = [str(folder / f"r{number}.csv") for number in (1, 2, 3)]
    machine = str(DATA / "field" / "common" / "turntable.toml")
    done = isocenter("diagnose", machine, *recordings, "--held-out", str(folder / "h.csv"), "-o", "found", "-j", "1")
    assert done.status == 0, done.err
    found = json.loads((tmp_path / "found" / "diagnosis.json").read_text())["findings"]
    assert {each["effect"] for each in found} == {effect for effect, _ in FIELD[name]}
    numbers = {(each["effect"], key): number for each in found for key, number in each["parameters"].items()}
    for key, value in FIELD[name].items():
        assert numbers[key]["value"] == pytest.approx(value, rel=0.02)
