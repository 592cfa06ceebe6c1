"""A second master on the emulated arm's bus while roll moves at 0.4 rad/s: named, and the arm comes to rest as after a quick stop."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import ClassVar, TextIO

import numpy as np
import pytest
from bench_machines import CARM, read_truth, run_in_lockstep

from drivers.errors import SecondMasterError
from hil.bench.bench import Bench
from hil.experiments import Move
from virtual_bus.lockstep import LockstepBus
from virtual_bus.machine import EmulatedMachine

SPEED = 0.40  # rad/s
TRAVEL = 0.11  # rad: ten ticks at this speed, and what Ctrl-C takes with a margin of 1.5
ROLL = [joint.name for joint in CARM.plant.tree.joints].index("roll")
WAY = Move({"propeller": 0.0, "roll": -0.6}, {"propeller": 0.0, "roll": 0.6})


class IntrudedBus(LockstepBus):
    """Somebody else sends a frame right after every SYNC of the bench, to the machine and to the bench."""

    intruder: tuple[int, bytes] | None = None
    machines: ClassVar[list[EmulatedMachine]] = []

    def __init__(self, machine: EmulatedMachine, log: TextIO | None = None) -> None:
        super().__init__(machine, log)
        self.machines.append(machine)

    def send_frame(self, can_id: int, data: bytes) -> None:
        super().send_frame(can_id, data)
        if can_id == self._sync_id and self.intruder is not None:
            self._frames.append(self.intruder)
            self.machine.receive(*self.intruder)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("can_id", "data", "words"),
    [
        pytest.param(0x080, b"", "a second SYNC producer sends 080h", marks=pytest.mark.nightly),
        (0x202, struct.pack("<Hh", 0x0F, 1000), "somebody else sends 202h, the commands to roll_drive"),
        pytest.param(0x77F, b"\x05", "a second master sends the bench's own heartbeat, 77Fh", marks=pytest.mark.nightly),
        pytest.param(
            0x182,
            struct.pack("<Hih", 0x1237, 0, 0),
            r"roll_drive: TPDO 1 \(182h\) comes more than once per SYNC",
            marks=pytest.mark.nightly,
        ),
        (0x3A5, bytes(8), ""),
    ],
    ids=["SYNC", "target torque", "heartbeat", "process data", "a stranger's frame"],
)
def test_the_arm_is_at_rest_within_a_quick_stop(
    can_id: int, data: bytes, words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Every kind of frame is told apart without the arm for every change (drivers/canopen/test_one_master.py)."""
    monkeypatch.setattr("hil.bench.wiring.LockstepBus", IntrudedBus)
    monkeypatch.setattr(IntrudedBus, "intruder", None)
    monkeypatch.setattr(IntrudedBus, "machines", [])
    (plan,) = WAY.plans(CARM)
    speed = np.abs(np.diff(plan.reference[:, 1])) * CARM.sample_rate_Hz
    begin = int(np.argmax(speed >= SPEED)) // 128 * 128 + 128
    at: list[int] = []

    def intrude(bench: Bench, row: int) -> None:
        if row >= begin and not at:
            at.append(row)
            IntrudedBus.intruder = can_id, data

    if not words:
        run_in_lockstep(tmp_path, [plan], progress=intrude)
        return
    with pytest.raises(SecondMasterError, match=words):
        run_in_lockstep(tmp_path, [plan], progress=intrude)
    roll = read_truth(tmp_path / "run.csv")["joint_position_roll"]
    (machine,) = IntrudedBus.machines
    positions = []
    for _ in range(2):
        machine.idle(1.0)
        positions.append(machine.physics.truth()["joint_position"][ROLL])
    assert abs(positions[-1] - roll[at[0]]) < TRAVEL
    assert positions[1] == pytest.approx(positions[0], abs=1e-4)
