"""What one experiment leaves ambiguous, the experiment that the diagnosis writes decides.

Run on the emulated turntable of `benchmarks/next_experiment.py`, which holds more cases and diagnoses again.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hil.cli.app import main
from hil.diagnosis import files
from hil.diagnosis.diagnose import diagnose
from hil.diagnosis.verdict.answer import NEXT_EXPERIMENT
from hil.machine import load_machine
from hil.recording import Recording, read_recording

TABLE = "turntable"
CABLE = '[[effect]]\nname = "cable_spring"\nat = "turn"\nkc_Nm_rad = 2.0\nkc3_Nm_rad3 = 0.0\ntheta0_rad = 0.3\n'
"""Slack at 0.3 rad, far outside of a jog of 3 degrees, within which a weight on a lever pulls in the same way: of the same load and slope,
its bend is 0.0008 Nm at the ends of the jog, and the table is shaken by 0.05 Nm."""
SHAKEN = '[[effect]]\nname = "base_motion"\nat = "turn"\nA_Nm = 0.05\nf_Hz = {f:.3f}\nphi_rad = {phi:.3f}\n'


def isocenter(*words: object) -> object:
    with pytest.raises(SystemExit) as left:
        main([str(word) for word in words])
    return left.value.code


def run(folder: Path, seed: int, *experiment: object) -> Recording:
    """A recording of the emulated table with its cable, shaken differently by every seed."""
    random = np.random.default_rng(seed)
    effects = folder / f"hidden{seed}.toml"
    effects.write_text(CABLE + SHAKEN.format(f=random.uniform(0.5, 4.0), phi=random.uniform(-3.0, 3.0)))
    path = folder / f"run{seed}.mf4"
    words = ("run", *experiment, "-m", TABLE, "-b", "lockstep:", "--seed", seed, "--effects", effects, "-o", path)
    assert isocenter(*words) == 0
    return read_recording(path, load_machine(TABLE))


@pytest.mark.nightly
def test_the_experiment_it_writes_tells_a_cable_from_what_looks_like_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(files, "write_report", lambda *_: None)  # whose figures take longer than all runs
    machine = load_machine(TABLE)
    jog = ("jog", "--amplitude", 3.0, "--period", 2.5, "--periods", 1)
    recordings = {str(seed): run(tmp_path, seed, *jog) for seed in (1, 2, 3)}
    outcome = diagnose(machine, recordings)
    assert outcome.diagnosis.verdict == "ambiguous"
    assert outcome.proposal is not None
    files.write_diagnosis(outcome, machine, tmp_path / "answer")
    written = tmp_path / "answer" / NEXT_EXPERIMENT
    names = [model.name for model in outcome.proposal.models]
    assert "cable_spring at turn" in names
    assert outcome.proposal.separations.max() > 3.0
    recordings |= {str(seed): run(tmp_path, seed, written) for seed in (4, 5, 6)}
    again = diagnose(machine, recordings).diagnosis
    assert str(again.findings[0].effect) == "cable_spring at turn"
