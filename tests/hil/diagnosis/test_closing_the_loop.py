"""What one experiment leaves ambiguous, the experiment that the diagnosis writes decides, as clearly as its file predicts.

Run on the emulated turntable of `benchmarks/next_experiment.py`, which holds more cases and diagnoses again.
"""

from __future__ import annotations

import numpy as np
import pytest

from hil.cli.app import main
from hil.diagnosis import files
from hil.diagnosis.diagnose import NEXT_EXPERIMENT, diagnose
from hil.diagnosis.separating import next_experiment
from hil.diagnosis.separating.separation import Separation
from hil.experiments import read_experiment
from hil.machine import load_machine
from hil.recording import read_recording

TABLE = "turntable"
CABLE = '[[effect]]\nname = "cable_spring"\nat = "turn"\nkc_Nm_rad = 2.0\nkc3_Nm_rad3 = 0.0\ntheta0_rad = 0.3\n'
"""Slack at 0.3 rad, far outside of a jog of 3 degrees, within which a weight on a lever pulls in the same way: of the same load and slope,
its bend is 0.0008 Nm at the ends of the jog, and the table is shaken by 0.05 Nm."""
SHAKEN = '[[effect]]\nname = "base_motion"\nat = "turn"\nA_Nm = 0.05\nf_Hz = {f:.3f}\nphi_rad = {phi:.3f}\n'


def isocenter(*words):
    with pytest.raises(SystemExit) as left:
        main([str(word) for word in words])
    return left.value.code


def run(folder, seed, *experiment):
    """A recording of the emulated table with its cable, shaken differently by every seed."""
    random = np.random.default_rng(seed)
    effects = folder / f"hidden{seed}.toml"
    effects.write_text(CABLE + SHAKEN.format(f=random.uniform(0.5, 4.0), phi=random.uniform(-3.0, 3.0)))
    path = folder / f"run{seed}.mf4"
    words = ("run", *experiment, "-m", TABLE, "-b", "lockstep:", "--seed", seed, "--effects", effects, "-o", path)
    assert isocenter(*words) == 0
    return read_recording(path, load_machine(TABLE))


@pytest.mark.nightly
def test_the_experiment_it_writes_tells_a_cable_from_what_looks_like_one(tmp_path, monkeypatch):
    for name, few in (("DRAWS", 4), ("REFITTED", 3), ("REFINEMENTS", 5)):
        monkeypatch.setattr(next_experiment, name, few)
    monkeypatch.setattr(files, "write_report", lambda *_: None)  # whose figures take longer than all runs
    machine = load_machine(TABLE)
    jog = ("jog", "--amplitude", 3.0, "--period", 2.5, "--periods", 1)
    outcome = diagnose(machine, {str(seed): run(tmp_path, seed, *jog) for seed in (1, 2, 3)})
    assert outcome.diagnosis.verdict == "ambiguous" and outcome.proposal is not None
    files.write_diagnosis(outcome, machine, tmp_path / "answer")
    written = tmp_path / "answer" / NEXT_EXPERIMENT
    names = [model.name for model in outcome.proposal.models]
    assert {"cable_spring at turn", "gravity_imbalance at turn"} <= set(names)
    recording = run(tmp_path, 4, written)
    (plan,) = read_experiment(written, machine).plans(machine)
    channels = outcome.train.channels
    shown = Separation(machine, outcome.proposal.models, outcome.train.noise, channels).of_recording(plan, recording.matrix(channels))
    cable = names.index("cable_spring at turn")
    if cable == 0:
        ahead, predicted = shown, outcome.proposal.separations[:, 0]
    else:
        ahead, predicted = -shown[[cable - 1]], outcome.proposal.separations[[cable - 1], 1]
    assert np.all(predicted > 3.0)
    assert np.all((0.5 * predicted < ahead) & (ahead < 2.0 * predicted))
