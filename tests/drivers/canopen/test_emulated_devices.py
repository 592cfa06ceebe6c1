"""The drivers on the emulated C-arm, every frame encoded and decoded: nothing here is known to them but the wire."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

import numpy as np
import pytest

from drivers.canopen.scan import scan_bus
from drivers.errors import DeviceFaultError
from drivers.machine_link import CanMachine
from hil.bench.clock import LockstepClock
from hil.emulated.machine import build_emulated
from hil.machine import Machine
from hil.machine.load import load_machine
from virtual_bus.lockstep import LockstepBus

CARM = load_machine("carm")
WITHOUT_IO = dataclasses.replace(CARM, bus=dataclasses.replace(CARM.bus, io=None, imu=None))  # drives work their own brakes
POSE = np.array([0.3, -0.4])


class Rig:
    """A machine link and the emulated machine at the two ends of a lockstep bus."""

    def __init__(self, machine: Machine = WITHOUT_IO, pose: np.ndarray = POSE) -> None:
        self.emulated = build_emulated(machine, pose, noise=False)
        self.bus = LockstepBus(self.emulated)
        self.clock = LockstepClock(self.bus.pass_time, lambda: self.bus.time_s)
        self.link = CanMachine(machine.bus, self.bus, self.clock)
        self.holding = self.emulated.physics.holding_effort(pose)

    def ready(self) -> Rig:
        self.link.start()
        self.link.home(self.holding, check_first_move=False)
        self.link.enable(lambda _: self.holding)
        return self


@pytest.fixture
def rig() -> Iterator[Rig]:
    rig = Rig()
    yield rig
    rig.bus.shutdown()


def test_a_scan_finds_the_four_nodes_with_what_they_are(rig: Rig) -> None:
    found = scan_bus(rig.bus, rig.clock)
    assert [(node.node_id, node.description, node.identity.product_code) for node in found] == [
        (1, "servo drive (CiA 402)", 0x49534F01),
        (2, "servo drive (CiA 402)", 0x49534F01),
        (11, "encoder (CiA 406)", 0x49534F02),
        (12, "encoder (CiA 406)", 0x49534F02),
    ]


def test_start_meets_no_object_that_the_devices_lack(rig: Rig) -> None:
    rig.link.start()
    assert rig.link.notes == ()


def test_homing_finds_the_pose_the_machine_was_put_at(rig: Rig) -> None:
    rig.link.start()
    rig.link.home(rig.holding, check_first_move=False)
    sample = rig.link.exchange(np.zeros(2))
    windup = 2e-3  # under gravity the link is where the motor side is, plus the gear's windup
    assert sample.position == pytest.approx(POSE, abs=windup)
    assert sample.link_position == pytest.approx(POSE, abs=windup)


def test_homing_on_the_encoders_index_pulse_agrees_with_the_link_encoder() -> None:
    settings = WITHOUT_IO.bus
    turn = 4096 * settings.scalings[0].position_resolution  # of the motor, at the joint: the pulse below the start is the first above zero
    nodes = tuple(dataclasses.replace(node, writes=((0x607C, 0, 4096),)) if node.role == "drive" else node for node in settings.nodes)
    homings = (dataclasses.replace(settings.homings[0], method=33), settings.homings[1])  # roll is not balanced: a homing drive lets it sag
    machine = dataclasses.replace(WITHOUT_IO, bus=dataclasses.replace(settings, nodes=nodes, homings=homings))
    rig = Rig(machine, np.array([turn + 0.004, 0.006]))
    rig.link.start()
    lines = rig.link.home(rig.holding, check_first_move=False)
    assert all("differ by" in line for line in lines)
    sample = rig.link.exchange(np.zeros(2))
    assert sample.position == pytest.approx(sample.link_position, abs=5e-3)  # it still swings a little; a turn amiss would be 12.6e-3
    rig.bus.shutdown()


def test_the_first_move_check_passes_on_a_healthy_machine_and_moves_little(rig: Rig) -> None:
    rig.link.start()
    lines = rig.link.home(rig.holding)
    assert [("the right way" in line, "differ by" in line) for line in lines] == [(True, False), (False, True)] * 2
    assert rig.link.exchange(np.zeros(2)).position == pytest.approx(POSE, abs=0.01)


def test_the_effort_of_a_row_answers_to_the_command_before_it(rig: Rig) -> None:
    rig.ready()
    commands = [rig.holding + np.array([0.5, -0.25]) * (-1) ** k for k in range(6)]
    for command in commands:
        sample = rig.link.exchange(command)
        assert sample.effort == pytest.approx(command, abs=0.005)  # one per mille of 5 A


def test_a_positive_command_accelerates_towards_positive_position(rig: Rig) -> None:
    rig.ready()
    start = rig.link.exchange(rig.holding).position.copy()
    for _ in range(100):
        sample = rig.link.exchange(rig.holding + np.array([0.5, -0.5]))
    assert sample.position[0] > start[0] + 1e-3
    assert sample.position[1] < start[1] - 1e-3


def test_a_bench_that_dies_leaves_motors_that_stop_by_themselves_and_the_next_start_recovers(rig: Rig) -> None:
    rig.ready()
    rig.link.exchange(rig.holding)
    rig.bus.pass_time(1.0)  # no heartbeat any more
    for drive in rig.emulated.drives.values():
        assert "operation enabled" not in drive.power_state.name.lower().replace("_", " ")
    successor = CanMachine(WITHOUT_IO.bus, rig.bus, rig.clock)
    successor.start()
    successor.enable(lambda _: rig.holding)  # resets the fault 8130h, checked
    assert successor.exchange(rig.holding).fault == ""


def test_silence_while_running_is_explained_by_the_drives_own_emergency(rig: Rig) -> None:
    rig.ready()
    rig.link.exchange(rig.holding)
    rig.bus.pass_time(1.0)
    with pytest.raises(DeviceFaultError, match=r"left operational: pre-operational; .*8130h: life guard or heartbeat error"):
        rig.link.exchange(rig.holding)


def test_stop_leaves_no_drive_enabled(rig: Rig) -> None:
    rig.ready()
    rig.link.stop()
    assert rig.link.stop_trouble == []
    names = {drive.power_state.name for drive in rig.emulated.drives.values()}
    assert names == {"SWITCH_ON_DISABLED"}
