"""Things go wrong in a tick: the machine is at rest before anybody is told what it was."""

from __future__ import annotations

from typing import Never

import can
import pytest
from machine_rig import ZERO, Rig
from scripted_nodes import PERIOD_S

from drivers.canopen.emcy import decode_emergency
from drivers.errors import (
    KEEP_AWAY,
    BusError,
    DeviceFaultError,
    HeartbeatLostError,
)


@pytest.fixture
def rig() -> Rig:
    return Rig()


def exchange(rig: Rig, ticks: int) -> None:
    for _ in range(ticks):
        rig.machine.exchange(ZERO)


def test_a_drive_that_falls_into_fault_stops_everything_and_is_explained(rig: Rig) -> None:
    rig.ready()
    rig.drives[1].fail(0x2310)
    with pytest.raises(
        DeviceFaultError, match=r"roll_drive \(node 2\): left operation enabled: fault .*EMCY 2310h: continuous overcurrent"
    ):
        rig.machine.exchange(ZERO)
    assert rig.at_rest()
    assert decode_emergency(rig.bus.sent(0x082)[-1]).code == 0x2310


def test_a_drive_that_is_switched_off_by_somebody_else_is_a_fault(rig: Rig) -> None:
    rig.ready()
    rig.drives[0].power = "switched on"
    rig.drives[0].refuses_enable = True
    with pytest.raises(DeviceFaultError, match=r"propeller_drive .*left operation enabled: switched on"):
        rig.machine.exchange(ZERO)
    assert rig.at_rest()


def test_an_emergency_of_any_node_is_in_the_sample(rig: Rig) -> None:
    rig.ready()
    rig.encoders[0].emergency(0x5000, 0x01)
    faults = [rig.machine.exchange(ZERO).fault for _ in range(3)]
    assert any("propeller_encoder (node 11): EMCY 5000h: device hardware" in fault for fault in faults)
    assert faults[-1] == ""


def test_a_node_that_leaves_operational_stops_everything(rig: Rig) -> None:
    rig.ready()
    rig.encoders[0].receive(0x000, bytes((0x80, 11)))
    with pytest.raises(DeviceFaultError, match=r"propeller_encoder \(node 11\): left operational: pre-operational"):
        exchange(rig, 60)
    assert rig.at_rest()


def test_a_controller_that_went_bus_off_is_a_fault(rig: Rig) -> None:
    rig.ready()
    rig.bus.queue.append(can.Message(arbitration_id=0x040, is_error_frame=True, is_extended_id=False, dlc=8))
    assert "bus off" in rig.machine.exchange(ZERO).fault


def test_a_node_that_falls_silent_stops_everything_within_its_time_out(rig: Rig) -> None:
    rig.ready()
    rig.encoders[1].silent = True
    start = rig.bus.time_s
    with pytest.raises(HeartbeatLostError, match=r"roll_encoder \(node 12\)"):
        exchange(rig, 1000)
    assert rig.bus.time_s - start < 0.1 + 0.25 + 8 * PERIOD_S + 0.7  # its period, its tolerance, the round of checks, the stop
    assert rig.at_rest()


def test_a_bus_that_dies_still_closes_the_brakes(rig: Rig) -> None:
    rig.ready()
    rig.bus.broken = True
    with pytest.raises(BusError, match="interface went down"):
        rig.machine.exchange(ZERO)
    assert rig.io.history[-1] == {"propeller": False, "roll": False}
    assert rig.machine.stop_trouble
    assert "stopping: " in rig.machine.stop_trouble[0]
    assert rig.machine.outcome == f"{KEEP_AWAY}: propeller, roll nobody knows whether it stands: the stop broke off"


def test_lost_io_does_not_keep_the_drives_from_holding(rig: Rig) -> None:
    rig.ready()

    def gone(*_: float) -> Never:
        raise BusError("Modbus server is gone")

    rig.io.poll_due = gone
    with pytest.raises(BusError, match="Modbus server is gone"):
        rig.machine.exchange(ZERO)
    assert all(drive.power == "quick stop active" for drive in rig.drives)
    assert "held by its drive: its brake reports open" in rig.machine.outcome
    assert any("Modbus server is gone" in trouble for trouble in rig.machine.stop_trouble)
