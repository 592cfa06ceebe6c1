"""What the machine does in the second before row 0 is in the recording, and said where it is not standstill."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from bench_machines import CARM

from hil.bench.open import open_bench
from hil.bench.options import BenchOptions
from hil.bench.timing import LoopTiming
from hil.experiments import Static
from hil.machine import Machine
from hil.recording import Recording, read_recording
from virtual_bus.settings import EffectSetting

POSE = np.array([0.1, -0.2])
COUNTS = np.array([scaling.position_resolution for scaling in CARM.bus.scalings])


def run(folder: Path, machine: Machine = CARM) -> tuple[LoopTiming, Recording]:
    with open_bench(machine, BenchOptions("lockstep:", noise=False), POSE + np.array([0.0, 0.05])) as bench:
        bench.commissioning = ("a building that shakes pushes more than the first move",)
        timing = bench.run(Static(0.5, dict(zip(CARM.axes, map(float, POSE), strict=True))).plans(CARM)[0], folder / "run.mf4")
    return timing, read_recording(folder / "run.mf4")


def test_a_machine_that_stands_says_how_well(tmp_path: Path) -> None:
    timing, recording = run(tmp_path)
    standing = recording.metadata["initial"]["standing"]
    first = np.array([recording[f"position_{axis}"][0] for axis in CARM.axes])
    assert timing.notes == ()
    assert np.array(standing["deviation"]) == pytest.approx(first - POSE, abs=1.5 * COUNTS.max())
    assert (np.abs(standing["deviation"]) <= 2.0 * COUNTS).all()
    assert (np.abs(standing["speed"]) < 5.0 * COUNTS).all()


@pytest.mark.slow
def test_a_machine_that_does_not_come_to_stand_is_recorded_and_told(tmp_path: Path) -> None:
    """The building shakes both joints, at no second of the wait both through zero: five quarters of a turn a second, and out of step."""
    shaken = CARM.with_effects(
        tuple(
            EffectSetting("base_motion", axis, {"A": 3.0, "f": 1.25, "phi": phi}) for axis, phi in zip(CARM.axes, (0.4, 1.2), strict=True)
        )
    )
    timing, recording = run(tmp_path, shaken)
    assert [note.split(" deg/s after")[1] for note in timing.notes] == [
        f" 16 s of standstill, {np.degrees(2.0 * count):.2g} deg is standing; recorded all the same (initial.standing)" for count in COUNTS
    ]
    assert [note.split(":")[0] for note in timing.notes] == list(CARM.axes)
    assert f"{np.degrees(recording.metadata['initial']['standing']['deviation'][1]):.2g} deg from its pose" in timing.notes[1]
