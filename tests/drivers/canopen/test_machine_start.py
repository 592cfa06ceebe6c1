"""A machine that is as its file says starts, at rest; any other is refused before anything is commanded."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest
from machine_rig import ZERO, Rig
from scripted_nodes import ScriptedDrive

from drivers.errors import (
    BusError,
    BusTimeoutError,
    ConfigurationRefusedError,
    DuplicateNodeError,
    NodeAbsentError,
    WrongIdentityError,
)
from drivers.machine_link import CanMachine
from drivers.settings import Pdo


@pytest.fixture
def rig() -> Rig:
    return Rig()


def test_start_leaves_all_nodes_operational_and_all_drives_without_voltage(rig: Rig) -> None:
    rig.machine.start()
    assert [node.state for node in rig.bus.nodes] == [0x05] * 4
    assert rig.at_rest()
    assert np.isfinite(rig.machine.sample.position).all()


@pytest.mark.parametrize(
    ("spoil", "error", "words"),
    [
        (lambda r: r.bus.nodes.pop(), NodeAbsentError, r"roll_encoder \(node 12\)"),
        (lambda r: r.drives[1].set(0x1018, 2, 7), WrongIdentityError, r"roll_drive \(node 2\): product_code is 00000007h"),
        (lambda r: r.drives[0].aborts.update({(0x1A00, 1): 0x06040041}), ConfigurationRefusedError, "cannot be mapped to the PDO"),
        (lambda r: setattr(r.drives[1], "mute_pdo", True), BusTimeoutError, r"roll_drive: TPDO 1 \(182h\): no answer"),
    ],
)
def test_a_machine_that_is_not_as_its_file_says_does_not_start(
    rig: Rig, spoil: Callable[..., object], error: type[Exception], words: str
) -> None:
    spoil(rig)
    with pytest.raises(error, match=words):
        rig.machine.start()
    assert rig.at_rest()


def test_two_devices_with_one_id_do_not_start(rig: Rig) -> None:
    twin = ScriptedDrive(2)
    twin.bus = rig.bus
    rig.bus.nodes.append(twin)
    with pytest.raises(DuplicateNodeError, match="roll_drive"):
        rig.machine.start()


def test_a_second_bench_on_the_bus_is_refused_before_anything_is_commanded(rig: Rig) -> None:
    other = ScriptedDrive(127)  # anything that beats with the bench's id
    other.bus = rig.bus
    other.set(0x1017, 0, 100)
    rig.bus.nodes.append(other)
    with pytest.raises(DuplicateNodeError, match="another bench is running there"):
        rig.machine.start()
    for _ in range(2):  # whoever is refused has nothing to stop: it would stop the other bench in mid-motion
        assert rig.bus.sent(0x000) == []
        assert rig.io.history == []
        rig.machine.close()


def test_a_closed_machine_is_anybodys_and_a_bench_refused_there_leaves_it_alone(rig: Rig) -> None:
    rig.ready()
    rig.machine.close()
    rig.bus.log.clear()
    commands = len(rig.io.history)
    other = ScriptedDrive(127)
    other.bus = rig.bus
    other.set(0x1017, 0, 100)
    rig.bus.nodes.append(other)
    with pytest.raises(DuplicateNodeError):
        rig.machine.start()
    rig.machine.close()
    assert rig.bus.sent(0x000) == []
    assert len(rig.io.history) == commands


def test_ticks_before_the_start_and_after_a_stop_are_refused(rig: Rig) -> None:
    with pytest.raises(BusError, match="not started"):
        rig.machine.exchange(ZERO)
    rig.ready()
    rig.machine.stop()
    with pytest.raises(BusError, match="start it first"):
        rig.machine.exchange(ZERO)


@pytest.mark.parametrize(
    ("rpdos", "tpdos", "words"),
    [
        ((Pdo(1, 0x201, 1, ((0x6040, 0, 16),)),), None, "map 6040h; in torque mode the loop fills 6040h, 6071h and nothing else"),
        (
            (Pdo(1, 0x201, 1, ((0x6040, 0, 16), (0x6060, 0, 8))),),
            None,
            "map 6040h, 6060h; in torque mode the loop fills 6040h, 6071h and",
        ),
        (None, (Pdo(1, 0x181, 1, ((0x6041, 0, 16),)),), "no TPDO with transmission type 1 maps position_actual_value"),
        (None, (Pdo(1, 0x181, 255, ((0x6041, 0, 16), (0x6064, 0, 32))),), "no TPDO with transmission type 1 maps statusword"),
    ],
)
def test_pdos_that_cannot_run_the_loop_are_refused_before_the_bus_is_touched(
    rig: Rig, rpdos: tuple[Pdo] | None, tpdos: tuple[Pdo] | None, words: str
) -> None:
    drive = rig.settings.nodes[0]
    drive = dataclasses.replace(drive, rpdos=rpdos or drive.rpdos, tpdos=tpdos or drive.tpdos)
    settings = dataclasses.replace(rig.settings, nodes=(drive, *rig.settings.nodes[1:]))
    with pytest.raises(ConfigurationRefusedError, match=words):
        CanMachine(settings, rig.bus, rig.clock)
    assert rig.bus.log == []
