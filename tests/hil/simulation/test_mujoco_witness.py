"""An independent witness of a whole run: MuJoCo, told nothing but the machine file and the recording's inputs, sees what was recorded."""

from __future__ import annotations

import subprocess
import sys

import pytest
from places import SUPPORT

from hil.bench.open import open_bench
from hil.bench.options import BenchOptions
from hil.experiments import Multisine
from hil.machine import Machine, load_machine
from hil.machine.mjcf import to_mjcf
from hil.recording import Recording, read_recording
from hil.simulation import compare, simulate

SCRIPT = SUPPORT / "replay_in_mujoco.py"
POSE = {"propeller": 0.4, "roll": -0.6}
pytest.importorskip("mujoco")


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> tuple[Machine, Recording, Recording]:
    """A noise-free multisine under jog over the whole stack in lockstep: the recording and what MuJoCo makes of it."""
    folder = tmp_path_factory.mktemp("witness")
    machine = load_machine("carm")
    experiment = Multisine(pose=POSE, amplitude_A=0.5, period_s=8.0, periods=1, settle_periods=0, jog=None, seed=4)
    plan = experiment.plans(machine)[0]
    recorded, replayed, model = folder / "run.csv", folder / "mujoco.csv", folder / "carm.xml"
    with open_bench(machine, BenchOptions("lockstep:", noise=False), plan.start_pose) as bench:
        bench.run(plan, recorded)
    model.write_text(to_mjcf(machine.plant, machine.name), encoding="utf-8")
    command = [sys.executable, str(SCRIPT), str(model), str(machine.path), str(recorded), str(replayed)]
    subprocess.run(command, check=True, cwd=folder)
    return machine, read_recording(recorded), read_recording(replayed, machine=machine)


def test_the_witness_imports_none_of_the_four_packages() -> None:
    text = SCRIPT.read_text(encoding="utf-8")
    assert not any(f"import {package}" in text or f"from {package}" in text for package in ("hil", "drivers", "controllers", "virtual_bus"))


# The loop rounds positions to 3.1e-6 rad and targets to 5 mA, so runs differ by a few of these steps. Homing leaves the motor side's zero
# off the joint's by the gear's windup under gravity (0.5 mrad): gravity turns by that in the IMU.
LARGEST_RMS = {"command": 0.015, "current": 0.015, "position": 6e-6, "imu": 0.007, "gyro": 1.5e-4}


def check(recorded: Recording, other: Recording) -> None:
    comparison = compare(recorded, other)
    compared = [channel for channel in comparison.channels if channel.name.split("_")[0] in LARGEST_RMS]
    assert len(compared) == 12
    for channel in compared:
        assert channel.rms < LARGEST_RMS[channel.name.split("_")[0]], comparison.table()
        assert channel.nrmse < 0.03, comparison.table()
        assert channel.lag_rows == 0, comparison.table()


@pytest.mark.slow
def test_mujoco_reproduces_the_run(run: tuple[Machine, Recording, Recording]) -> None:
    _, recorded, replayed = run
    check(recorded, replayed)


def test_the_simulation_reproduces_the_run(run: tuple[Machine, Recording, Recording]) -> None:
    machine, recorded, _ = run
    check(recorded, simulate(machine, recorded))
