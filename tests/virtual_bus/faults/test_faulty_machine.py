"""Faults act where the real ones do; a machine that waits for one is bit for bit the machine without; runs repeat."""

from __future__ import annotations

from pathlib import Path

import can
import numpy as np
import pytest
from bench_machines import CARM, carm_text_in

from drivers.errors import SecondMasterError
from hil.bench.open import open_bench
from hil.bench.options import BenchOptions
from hil.errors import LoopAbortedError
from hil.experiments import Scan
from hil.faults.budget import standing
from hil.machine import machine_from_text
from hil.machine.faults_file import faults_from_text
from hil.recording import read_recording
from virtual_bus.faults.motion_log import MotionLog
from virtual_bus.faults.outcome import FaultOutcome, outcome_of

SWEEP = "abs(speed_roll) > 0.36"


def run(folder: Path, faults: str, motion: MotionLog | None = None, name: str = "run") -> tuple[str, list[float], list[str]]:
    """Frames, onsets and labels of a short scan of roll with these faults; the error it ends with is raised by the bench."""
    log, events = folder / f"{name}.log", []  # type: ignore[var-annotated]
    (plan,) = Scan("roll", 0.2, -0.3, 0.4, dwell_s=0.1).plans(CARM)
    options = BenchOptions(
        "lockstep:", frame_log=log, faults=faults_from_text(faults, CARM, "faults"), motion=motion, events=events, seed=3
    )
    try:
        with open_bench(CARM, options, plan.start_pose) as bench:
            bench.run(plan, folder / f"{name}.mf4")
    finally:
        text = log.read_text()
    return text, [event.time_s for event in events if event.begins], [event.label for event in events]


def aborted(folder: Path, faults: str, name: str = "run") -> tuple[str, FaultOutcome]:
    """What the bench said of a run with these faults, and what became of the machine."""
    motion, events = MotionLog(CARM.axes), []  # type: ignore[var-annotated]
    (plan,) = Scan("roll", 0.2, -0.3, 0.4, dwell_s=0.1).plans(CARM)
    options = BenchOptions("lockstep:", faults=faults_from_text(faults, CARM, "faults"), motion=motion, events=events, seed=3)
    with pytest.raises(Exception) as raised, open_bench(CARM, options, plan.start_pose) as bench:  # noqa: PT011
        bench.run(plan, folder / f"{name}.mf4")
    onset_s = max(event.time_s for event in events if event.begins)
    return str(raised.value), outcome_of(motion, onset_s, [standing(CARM, axis) for axis in CARM.axes])


def fault(name: str, at: str, when: str = SWEEP, more: str = "") -> str:
    return f'[[fault]]\nname = "{name}"\nat = "{at}"\nwhen = "{when}"\n{more}\n'


def test_a_machine_that_waits_for_a_fault_sends_the_frames_of_one_without(tmp_path: Path) -> None:
    waiting = "".join(
        fault(name, at, "position_roll > 9.0")
        for name, at in (("torque_lost", "roll_drive"), ("brake_weak", "roll"), ("imu_nan", "imu"), ("io_hangs", "io"))
    )
    motion = MotionLog(CARM.axes)
    frames, begun, _ = run(tmp_path, waiting, motion, "waiting")
    assert begun == []
    assert frames == run(tmp_path, "", name="without")[0]
    first, second = (read_recording(tmp_path / f"{name}.mf4") for name in ("waiting", "without"))
    for name, channel in first.channels.items():
        np.testing.assert_array_equal(channel.values, second.channels[name].values, name)


def test_a_random_fault_repeats_bit_for_bit(tmp_path: Path) -> None:
    faults = (
        fault("imu_garbled", "imu") + fault("motor_encoder_noisy", "roll_drive", more="counts = 3") + fault("frames_empty", "roll_encoder")
    )
    first, begun, labels = run(tmp_path, faults, name="first")
    assert first == run(tmp_path, faults, name="second")[0]
    assert len(begun) == 3
    assert labels[0] == "imu_garbled at imu"


def test_hold_to_run_released_brings_the_arm_to_rest_under_its_brake(tmp_path: Path) -> None:
    said, outcome = aborted(tmp_path, fault("hold_to_run_released", "io"))
    assert "hold-to-run was released" in said
    assert outcome.at_rest
    assert outcome.of("roll").ending == "held by its brake"
    assert 0.02 < outcome.of("roll").travel < 0.15
    assert outcome.of("propeller").travel < 1e-3


def test_the_truth_goes_on_when_nothing_holds_the_arm(tmp_path: Path) -> None:
    faults = fault("brake_weak", "roll", "settled roll", "share = 0.0") + fault("drive_loses_power", "roll_drive")
    said, outcome = aborted(tmp_path, faults)
    assert "roll not proven at rest" in said
    assert "IT MOVES" in said
    assert not outcome.of("roll").at_rest
    assert outcome.watched_s > 15.0
    assert outcome.of("roll").travel > 1.0


def test_a_fault_ends_after_its_duration(tmp_path: Path) -> None:
    _, begun, labels = run(tmp_path, fault("drive_warns", "roll_drive", more="for_s = 0.25"))
    assert labels == ["drive_warns at roll_drive"] * 2
    recording = read_recording(tmp_path / "run.mf4")
    warned = recording["statusword_roll"].astype(int) & 1 << 7 > 0
    assert np.count_nonzero(warned) == 64
    assert len(begun) == 1


def test_lost_torque_is_not_the_automatons_to_know(tmp_path: Path) -> None:
    said, outcome = aborted(tmp_path, fault("torque_lost", "roll_drive"))
    assert "drive_roll: its drive measures " in said
    assert outcome.at_rest
    recording = read_recording(tmp_path / "run.mf4")
    assert recording["statusword_roll"][-1] % 64 == 0x37 % 64


def test_an_aborted_run_is_told_apart(tmp_path: Path) -> None:
    with pytest.raises(LoopAbortedError):
        run(tmp_path, fault("door_opened", "io"))


@pytest.mark.parametrize("mode", ["velocity", "position"])
def test_somebody_elses_torque_reaches_a_drive_with_loops_of_its_own(mode: str, tmp_path: Path) -> None:
    machine = machine_from_text(carm_text_in(mode))
    faults = faults_from_text(fault("foreign_torque", "roll_drive", more="torque = 300"), machine, "faults")
    (plan,) = Scan("roll", 0.2, -0.3, 0.4, dwell_s=0.1).plans(machine)
    options = BenchOptions("lockstep:", faults=faults, frame_log=tmp_path / "run.log")
    with open_bench(machine, options, plan.start_pose) as bench, pytest.raises(SecondMasterError, match="somebody else sends 202h"):
        bench.run(plan, tmp_path / "run.mf4")
    sent = [bytes(message.data) for message in can.LogReader(str(tmp_path / "run.log")) if message.arbitration_id == 0x202]
    foreign = [data for data in sent if data[6:] == (300).to_bytes(2, "little")]
    assert foreign
    assert all(data[2:6] in {own[2:6] for own in sent if own not in foreign} for data in foreign)
