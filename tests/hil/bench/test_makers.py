"""Drives of five makers, by their own data sheets unchanged, go to a pose on the emulated plant."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pytest
from bench_machines import carm_text_in
from other_makers import FILES, carm_text_with, modes_of

from drivers.canopen.process_data import AxisOutput
from drivers.errors import MotionRefusedError
from hil.bench.open import open_bench
from hil.bench.options import BenchOptions
from hil.errors import ExperimentError
from hil.experiments import Multisine, Static
from hil.machine import Machine, machine_from_text

DATA = Path(__file__).resolve().parents[4] / "shared" / "data" / "canopen"
GOAL = np.radians([-5.0, 10.0])
NEAR_rad = 2e-4


def moved(machine: Machine) -> np.ndarray:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of repairs of data sheets
        with open_bench(machine, BenchOptions("lockstep:")) as bench:
            return bench.move(GOAL)


@pytest.mark.parametrize("maker", FILES)
def test_its_drive_goes_to_a_pose_by_its_own_profile(maker: str) -> None:
    file = DATA / FILES[maker]
    if not file.is_file():
        pytest.skip(f"{file} is not here: makers' data sheets are not part of the project")
    assert "profile_position" in modes_of(file)
    reached = moved(machine_from_text(carm_text_with(file, "profile_position")))
    assert reached == pytest.approx(GOAL, abs=NEAR_rad)


@pytest.mark.nightly
@pytest.mark.parametrize("maker", ["maxon EPOS4", "Elmo Gold", "Faulhaber MCBL 300"])
def test_the_loop_leads_a_drive_that_ramps_its_velocity_in_its_own_unit(maker: str, monkeypatch: pytest.MonkeyPatch) -> None:
    file = DATA / FILES[maker]
    if not file.is_file():
        pytest.skip(f"{file} is not here: makers' data sheets are not part of the project")
    machine = machine_from_text(carm_text_with(file, "profile_velocity"))
    joint, wire = [], []
    lead_to = AxisOutput.lead_to

    def noted(output: AxisOutput, target: float) -> None:
        lead_to(output, target)
        joint.append(target)
        wire.append(output.target)

    monkeypatch.setattr(AxisOutput, "lead_to", noted)
    assert moved(machine) == pytest.approx(GOAL, abs=NEAR_rad)
    turns_s = 500.0 / (2.0 * np.pi)
    unit = {"maxon EPOS4": 60.0, "Elmo Gold": 4096.0, "Faulhaber MCBL 300": 60.0}[maker] * turns_s  # rpm, counts/s, rpm by their manuals
    assert np.max(np.abs(joint)) * unit > 10.0
    assert wire == pytest.approx(np.array(joint) * unit, abs=0.51)


@pytest.mark.parametrize("mode", ["velocity", "position"])
def test_the_loop_leads_drives_that_have_the_objects(mode: str) -> None:
    file = DATA / FILES["Elmo Gold"]
    if not file.is_file():
        pytest.skip(f"{file} is not here: makers' data sheets are not part of the project")
    assert moved(machine_from_text(carm_text_with(file, mode))) == pytest.approx(GOAL, abs=NEAR_rad)


def by_itself(mode: str) -> Machine:
    """The C-arm with our own drives in a profile mode, which take no effort."""
    return machine_from_text(carm_text_in(mode))


def test_a_drive_that_goes_by_itself_is_not_run_and_one_without_effort_not_excited(tmp_path: Path) -> None:
    machine = by_itself("profile_position")
    with open_bench(machine, BenchOptions("lockstep:")) as bench, pytest.raises(MotionRefusedError, match="roll: in profile position mode"):
        bench.run(Static(1.0).plans(machine)[0], tmp_path / "run.mf4")
    machine = by_itself("profile_velocity")
    excited = Multisine(period_s=2.0, periods=1, settle_periods=0, amplitude_A=0.05, jog=None).plans(machine)[0]
    with open_bench(machine, BenchOptions("lockstep:")) as bench, pytest.raises(MotionRefusedError, match="takes no effort"):
        bench.run(excited, tmp_path / "run.mf4")


def test_a_drive_that_goes_by_itself_is_not_sent_out_of_range() -> None:
    with open_bench(by_itself("profile_position"), BenchOptions("lockstep:")) as bench:
        before = bench.pose.copy()
        with pytest.raises(ExperimentError, match="roll"):
            bench.move(np.radians([0.0, 95.5]))
        assert bench.pose == pytest.approx(before)


def test_what_cannot_be_checked_of_a_drive_without_effort_is_said() -> None:
    with open_bench(by_itself("profile_position"), BenchOptions("lockstep:")) as bench:
        said = " ".join(bench.commission())
    assert "roll: its first move was not checked, because its drive takes no effort" in said
