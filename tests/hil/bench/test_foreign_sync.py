"""A loop that follows the SYNC of another device: the same motion, nothing sent, and what ends a run."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from bench_machines import CARM, edited, read_truth, run_in_lockstep

from drivers.errors import BusTimeoutError, SecondMasterError
from hil.bench.open import open_bench
from hil.bench.options import BenchOptions
from hil.errors import MachineFileError
from hil.experiments import Move
from hil.machine import Machine, machine_from_text
from hil.machine.faults_file import faults_from_text
from hil.machine.summary import machine_lines
from hil.recording import Recording, RecordingWarning, read_recording
from virtual_bus.lockstep import LockstepBus
from virtual_bus.machine import EmulatedMachine

FOLLOWING_TEXT = edited("^master_node_id", 'sync_producer = "plc"\nmaster_node_id')
FOLLOWING = machine_from_text(FOLLOWING_TEXT)
WAY = Move({"propeller": 0.0, "roll": -0.3}, {"propeller": 0.0, "roll": 0.3})
MOVING = 'when = "abs(speed_roll) > 0.2"'
TRAVEL = 0.11  # rad: ten ticks at 0.4 rad/s, and what Ctrl-C takes with a margin of 1.5


@pytest.fixture(scope="module")
def followed(tmp_path_factory: pytest.TempPathFactory) -> tuple[Recording, list[int]]:
    """The way under the SYNC of another device, and the identifiers of what the bench sends."""
    sent: list[int] = []

    class Listening(LockstepBus):
        def send_frame(self, can_id: int, data: bytes) -> None:
            sent.append(can_id)
            super().send_frame(can_id, data)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("hil.bench.wiring.LockstepBus", Listening)
        (following,) = run_in_lockstep(tmp_path_factory.mktemp("followed"), WAY.plans(FOLLOWING), FOLLOWING, noise=False)
    return following, sent


def test_the_arm_moves_as_under_the_benchs_own_sync(followed: tuple[Recording, list[int]], tmp_path: Path) -> None:
    following, _ = followed
    (own,) = run_in_lockstep(tmp_path, WAY.plans(CARM), CARM, name="own", noise=False)
    for name in ("position_roll", "position_propeller", "command_roll", "link_position_roll", "imu_x"):
        np.testing.assert_allclose(following.channel(name).values, own.channel(name).values, rtol=0.0, atol=1e-12, err_msg=name)
    assert following.rows == own.rows
    assert np.array_equal(np.diff(following.ticks), np.ones(following.rows - 1))


@pytest.mark.parametrize(("machine", "who"), [(FOLLOWING, "plc"), (CARM, "the bench")])
def test_the_summary_of_a_machine_says_who_sends_sync(machine: Machine, who: str) -> None:
    assert f"bus, 1000 kbit/s, SYNC from {who} at 256 Hz" in machine_lines(machine)


def test_the_bench_sends_no_sync(followed: tuple[Recording, list[int]]) -> None:
    _, sent = followed
    assert sent.count(0x201) > 1000
    assert 0x080 not in sent


@pytest.mark.parametrize(
    ("fault", "error", "words"),
    [
        ('name = "sync_stops"', BusTimeoutError, r"plc \(bus.sync_producer\): no SYNC for 0.03\d s; timing.overrun_ticks bridges 8 ticks"),
        ('name = "foreign_sync"', SecondMasterError, "SYNC comes between those of plc: a second producer sends it on lockstep"),
        ('name = "foreign_sync"\nevery = 10', SecondMasterError, "SYNC comes between those of plc: a second producer sends it on lockstep"),
    ],
    ids=["silent", "a second one", "a second one, now and then"],
)
def test_a_producer_that_falls_silent_or_is_not_alone_ends_the_run_and_the_arm_rests(
    fault: str, error: type[Exception], words: str, tmp_path: Path
) -> None:
    faults = faults_from_text(f"[[fault]]\n{fault}\n{MOVING}\n", FOLLOWING, "test")
    with pytest.raises(error, match=words):
        run_in_lockstep(tmp_path, WAY.plans(FOLLOWING), FOLLOWING, faults=faults)
    truth = read_truth(tmp_path / "run.csv")
    roll = truth["joint_position_roll"]
    began = np.flatnonzero(np.abs(np.gradient(roll, truth["time"])) > 0.2)[0]
    assert np.ptp(roll[began:]) < TRAVEL
    assert np.ptp(roll[-50:]) < 1e-4


def test_a_pause_that_is_bridged_is_counted_and_said(tmp_path: Path) -> None:
    faults = faults_from_text(f'[[fault]]\nname = "sync_stops"\n{MOVING}\nfor_s = 0.0156\n', FOLLOWING, "test")
    (plan,) = WAY.plans(FOLLOWING)
    with open_bench(FOLLOWING, BenchOptions("lockstep:", faults=faults), plan.start_pose) as bench:
        timing = bench.run(plan, tmp_path / "run.mf4")
    with pytest.warns(RecordingWarning, match="4 ticks are missing in 1 place"):
        steps = np.diff(read_recording(tmp_path / "run.mf4").ticks)
    assert sorted(steps.tolist())[-2:] == [1, 5]
    assert timing.missed == 4
    assert "plc (bus.sync_producer): 4 SYNCs did not come" in timing.notes


def test_nothing_is_started_while_nobody_sends_sync(tmp_path: Path) -> None:
    faults = faults_from_text('[[fault]]\nname = "sync_stops"\n', FOLLOWING, "test")
    with pytest.raises(BusTimeoutError, match=r"plc \(bus.sync_producer\): on lockstep.* nobody sends SYNC \(080h\)"):
        run_in_lockstep(tmp_path, WAY.plans(FOLLOWING), FOLLOWING, faults=faults)


def test_a_producer_of_another_rate_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class At250Hz(EmulatedMachine):
        def __init__(self, *arguments: object, **options: object) -> None:
            super().__init__(*arguments, **options)
            self.period_s = 0.004

    monkeypatch.setattr("hil.emulated.machine.EmulatedMachine", At250Hz)
    with pytest.raises(BusTimeoutError, match=r"SYNC comes every 4.000 ms, timing.sample_rate makes it 3.906 ms"):
        run_in_lockstep(tmp_path, WAY.plans(FOLLOWING), FOLLOWING)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (edited('"plc"', '"roll_drive"', FOLLOWING_TEXT), "roll_drive is one of the nodes"),
        (edited("^overrun_ticks", 'overrun = "wait"\noverrun_ticks', FOLLOWING_TEXT), "another device's ticks do not wait"),
        (
            edited("^answer_timeout_s = .*", 'answer_timeout_s = 0.0025\nanswers = "awaited"', FOLLOWING_TEXT),
            "next SYNC waits for no answer",
        ),
    ],
)
def test_a_producer_that_cannot_be_is_refused(text: str, words: str) -> None:
    with pytest.raises(MachineFileError, match=words):
        machine_from_text(text)
