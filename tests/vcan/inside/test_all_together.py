"""Multisine with jog, a shaped scan and the observer together on vcan0, emulator and loop in two processes, as at a bench."""

from __future__ import annotations

import subprocess
from pathlib import Path

import numpy as np
import pytest
from test_bench import ISOCENTER, TIMEOUT_S, emulate, patient, run

from hil.experiments import Static
from hil.machine import load_machine
from hil.observing import design_observer, observe, read_design, write_design
from hil.observing.emulated import emulated_recording, emulated_responses
from hil.recording import Recording, read_recording

pytestmark = pytest.mark.vcan

__all__ = ["emulate"]


def observer_design(machine: str, path: Path) -> None:
    """An observer about roll 30 degrees, identified on the emulated machine; not tuned, which takes longer than all else."""
    loaded, pose = load_machine(machine), {"roll": np.radians(30.0)}
    still = emulated_recording(loaded, Static(2.0, pose).plans(loaded)[0], 1)
    write_design(design_observer(loaded, emulated_responses(loaded, [pose]), [still], modes=3), path)


def assert_observed(recording: Recording, design: Path) -> None:
    """Estimates in every row, those of a replay to the bit, and about where the link encoders are."""
    replayed = observe(recording, read_design(design).observer())
    assert np.array_equal(recording.matrix(replayed.names), replayed.values, equal_nan=True)
    assert np.isfinite(replayed.values[1:, : replayed.names.index("estimate_nis_window")]).all()
    for axis in ("propeller", "roll"):
        off = recording[f"link_position_{axis}"] - recording[f"estimate_link_position_{axis}"]
        assert np.nanmax(np.abs(off[256:])) < 1e-4
    assert (recording["estimate_measured"] == 10).mean() > 0.9


def test_multisine_with_jog_and_a_shaped_scan_run_with_the_observer(interface, emulate, tmp_path):
    machine, bus = patient(tmp_path), f"socketcan:{interface}"
    design, shaper = tmp_path / "carm.observer.npz", tmp_path / "roll.shaper.npz"
    observer_design(machine, design)
    shaping = [*ISOCENTER, "shape", machine, "--axis", "roll", "-o", str(shaper)]
    subprocess.run(shaping, capture_output=True, timeout=TIMEOUT_S, check=True)
    emulate(machine, "--bus", bus, "--pose", "roll=30")
    common = ("--machine", machine, "--bus", bus, "--pose", "roll=30", "--observer", str(design))

    excited = tmp_path / "excited.mf4"
    experiment = ("--experiments", "single", "--axes", "roll", "--amplitude", "0.5", "--period", "2", "--jog", "0.2", "--periods", "1")
    done = run("multisine", *common, *experiment, "-o", str(excited))
    assert done.returncode == 0, done.stderr
    assert_observed(read_recording(excited), design)

    scanned = tmp_path / "scanned.mf4"
    sweep = ("--axis", "roll", "--from", "30", "--to", "34", "--speed", "4", "--dwell", "0.5")
    done = run("scan", *common, *sweep, "--shaper", str(shaper), "-o", str(scanned))
    assert done.returncode == 0, done.stderr
    recording = read_recording(scanned)
    assert_observed(recording, design)
    assert np.abs(recording["reference_roll"] - recording["reference_raw_roll"]).max() > 1e-4  # the shaper had its say
    assert np.nanmax(np.abs(recording["reference_roll"] - recording["position_roll"])) < np.radians(1.0)
