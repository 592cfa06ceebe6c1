"""Every fault begins and ends on the emulated machine, at every place where it may act, and leaves nothing behind."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from bench_machines import CARM

from hil.emulated.machine import build_emulated
from hil.machine.faults_file import places_of
from virtual_bus.faults.binding import bind_faults, inject
from virtual_bus.faults.machine import FaultyMachine
from virtual_bus.faults.motion_log import MotionLog
from virtual_bus.faults.registry import catalogue, fault_kinds
from virtual_bus.lockstep import LockstepBus, imu_line, io_line

PLACES = places_of(CARM)
EVERYWHERE = [(kind.name, at) for kind in fault_kinds().values() for at in PLACES.of(kind.at)]
READ_INPUTS = bytes.fromhex("000100000006010200000001")


@pytest.fixture(scope="module")
def bus() -> Iterator[LockstepBus]:
    """A bus on which one machine after the other is started by its NMT reset."""
    machine = build_emulated(CARM, np.array([0.0, 0.1]), motion=MotionLog(CARM.axes))
    bus = LockstepBus(machine)
    yield bus
    bus.shutdown()


def seams(machine: FaultyMachine) -> list[tuple[object, ...]]:
    assert machine.faulty_io is not None
    assert machine.faulty_imu is not None
    devices = (machine, machine.faulty_io, machine.faulty_imu, machine.brakes)
    return [seam.places() for device in devices for seam in vars(device).values() if hasattr(seam, "places")]


def answers(bus: LockstepBus, syncs: int) -> None:
    """So many SYNCs, each with a request to the I/O; everything that comes is dropped."""
    imu, io = imu_line(bus.machine), io_line(bus.machine)
    for _ in range(syncs):
        bus.send_frame(0x080, b"")
        io.write(READ_INPUTS)
        io.read()
        imu.read()
        while bus.recv(0.0) is not None:
            pass


@pytest.mark.parametrize(("name", "at"), EVERYWHERE)
def test_it_begins_and_ends_and_leaves_nothing_behind(bus: LockstepBus, name: str, at: str) -> None:
    machine = bus.machine
    assert isinstance(machine, FaultyMachine)
    bus.send_frame(0x000, bytes((0x81, 0)))
    bus.send_frame(0x000, bytes((0x01, 0)))
    answers(bus, 3)
    before = len(machine.schedule.events)
    lasting_s = 10 * machine.period_s
    inject(machine, bind_faults([{"name": name, "at": at, "from_s": machine.time_s, "for_s": lasting_s}], PLACES, "test"))
    answers(bus, 20)
    began, ended = machine.schedule.events[before:]
    assert (began.begins, ended.begins) == (True, False)
    assert ended.time_s - began.time_s == pytest.approx(lasting_s)
    assert not any(seams(machine))
    assert machine.faulty_io is not None
    assert not any((machine.faulty_io.hangs_up, machine.faulty_io.hangs))


def test_there_are_as_many_faults_as_the_table_promises() -> None:
    emulated = [kind for kind in fault_kinds().values() if kind.begin is not None]
    assert len(emulated) >= 45
    assert len(EVERYWHERE) >= 80


def test_every_fault_says_what_it_does_in_a_sentence_and_its_defaults_are_allowed() -> None:
    for kind in fault_kinds().values():
        assert kind.does[0].isupper(), kind.name
        assert kind.does.endswith("."), kind.name
        for parameter in kind.parameters:
            assert parameter.low <= parameter.default <= parameter.high, kind.name
            assert parameter.description, kind.name
        for trial in kind.trials:
            assert set(trial.values) <= {parameter.name for parameter in kind.parameters}, kind.name
    assert len(catalogue()) == len(fault_kinds())
