"""Effects that are given as known: simulated, stated, and not sought at their place."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from carriage import MACHINE, repeats
from command_line import Isocenter

from hil.diagnosis.diagnose import diagnose
from hil.diagnosis.model_choice.everyday import everyday_effects
from hil.diagnosis.model_choice.fitting import fit
from hil.diagnosis.model_choice.search import library
from hil.diagnosis.residuals.equation_errors import Levels
from hil.diagnosis.residuals.residuals import Residuals, residuals_of
from hil.diagnosis.retuning.linear_model import linear_at, nominal_offset
from hil.machine.effects_file import read_effects_file
from hil.recording import write_recording
from virtual_bus.settings import EffectSetting

COULOMB_N, LOAD_N = 20.0, 6.0
TRUTH = {"coulomb_N": COULOMB_N, "load_N": LOAD_N}
FRICTION = EffectSetting("coulomb_friction", "carriage", {"Fc": COULOMB_N})
LOAD = EffectSetting("constant_load", "carriage", {"tau0": LOAD_N})
FILE = '[[effect]]\nname = "coulomb_friction"\nat = "carriage"\nFc_N = 20.0\n'


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    (each,) = repeats(1, duration_s=6.0, **TRUTH).values()
    write_recording(each, tmp_path / "run.csv")
    return tmp_path


@pytest.mark.nightly
def test_the_command_names_what_is_missing_beside_what_is_known(folder: Path, isocenter: Isocenter) -> None:
    (folder / "known.toml").write_text(FILE)
    done = isocenter("diagnose", "emps", "run.csv", "-o", "found", "--known", "known.toml")
    assert done.status == 0, done.err
    found = json.loads((folder / "found" / "diagnosis.json").read_text())
    assert found["known"] == [{"effect": "coulomb_friction", "at": "carriage", "parameters": {"Fc": {"value": COULOMB_N, "unit": "N"}}}]
    assert [finding["effect"] for finding in found["findings"]] == ["constant_load"]
    low, high = found["findings"][0]["parameters"]["tau0"]["ci95"]
    assert low <= LOAD_N <= high
    everywhere = [*found["baseline"], *found["detection_limits"], *(e for h in found["hypotheses"] for e in h["effects"])]
    assert "coulomb_friction" not in {one["effect"] for one in everywhere}
    written = read_effects_file(folder / "found" / "effects.toml", MACHINE)
    assert written[0] == FRICTION
    assert [one.name for one in written] == ["coulomb_friction", "constant_load"]
    assert "known: coulomb_friction at carriage" in done.out
    assert "coulomb_friction at carriage: Fc = 20 N" in (folder / "found" / "report.html").read_text()


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (FILE.replace("coulomb_friction", "coulomb_frition"), ["coulomb_frition", "coulomb_friction?"]),
        (FILE.replace('"carriage"', '"roll"'), ["at = 'roll'", "there is carriage"]),
        (FILE.replace("20.0", "-20.0"), ["Fc_N = -20.0", "from 0 to"]),
        (FILE.replace("Fc_N", "Fc_Nm"), ["'Fc_Nm'", "it takes Fc_N"]),
    ],
)
def test_what_is_no_effect_of_the_machine_is_refused_in_a_line(folder: Path, isocenter: Isocenter, text: str, says: list[str]) -> None:
    (folder / "known.toml").write_text(text)
    done = isocenter("diagnose", "emps", "run.csv", "-o", "found", "--known", "known.toml")
    assert done.status == 2
    assert "known.toml: effect 1" in done.line
    assert all(word in done.line for word in says), done.line


def test_beside_repeats_what_is_known_is_no_finding() -> None:
    recordings = repeats(4, **TRUTH)
    found = diagnose(MACHINE.with_effects((FRICTION,)), recordings, repeats(2, experiment=1, **TRUTH)).diagnosis
    assert [str(finding.effect) for finding in found.findings] == ["constant_load at carriage"]
    assert found.findings[0].parameters["tau0"].value == pytest.approx(LOAD_N, abs=0.6)
    assert [str(one.effect) for one in found.known] == ["coulomb_friction at carriage"]
    both = diagnose(MACHINE.with_effects((FRICTION, LOAD)), recordings).diagnosis
    assert both.verdict in ("consistent", "retuned")
    assert both.findings == ()


def innovations_with(residuals: Residuals, levels: Levels, settings: tuple[EffectSetting, ...]) -> np.ndarray:
    offset = nominal_offset(residuals.trajectories)
    linear = linear_at(residuals.trajectories, levels, offset, settings)
    fitted = fit(linear, settings, offset, longest=0.0)
    assert fitted is not None
    return np.concatenate(fitted.innovations)


def test_along_the_motion_what_is_known_explains_what_it_would_explain_if_found() -> None:
    recordings = repeats(1, **TRUTH)
    plain, knowing = residuals_of(MACHINE, recordings), residuals_of(MACHINE.with_effects((FRICTION,)), recordings)
    without = innovations_with(plain, plain.levels, ())
    known = innovations_with(knowing, plain.levels, ())
    linear = linear_at(plain.trajectories, plain.levels, nominal_offset(plain.trajectories), (FRICTION,))
    (one,) = linear.records
    trajectory = plain.trajectories[0]
    signals = trajectory.signals(one.motion, trajectory.model(linear.values, (FRICTION,)), (FRICTION,))
    found = one.equations.given_along(signals).whitened(one.whitening).reshape(-1)
    assert np.sum(known**2) < 0.5 * np.sum(without**2)
    np.testing.assert_allclose(known, found, atol=0.02)  # of noise: near a reversal the motion that was seen decides how much is unknown


def test_no_law_is_sought_where_it_is_known() -> None:
    knowing = residuals_of(MACHINE.with_effects((FRICTION,)), repeats(1, **TRUTH))
    assert {one.name for one in everyday_effects(knowing.trajectories[0])} == {"constant_load", "viscous_friction"}
    linear = linear_at(knowing.trajectories, knowing.levels, nominal_offset(knowing.trajectories))
    laws = {law.effect.name for law in library(linear).laws}
    assert "coulomb_friction" not in laws
    assert {"asymmetric_friction", "constant_load"} <= laws
