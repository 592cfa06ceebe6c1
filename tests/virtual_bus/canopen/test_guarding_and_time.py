"""Node guarding, life guarding and TIME of a bare device, with the canopen library's master as the one that guards."""

from __future__ import annotations

import datetime
from collections.abc import Callable
from pathlib import Path

import canopen
import pytest
from device_wires import DRIVE_EDS, Wire, abort_code, bare_wire, client, u8, u16, u32
from full_device import NODE, full_device_eds

from virtual_bus.canopen.bare import bare_device

GUARD = 0x700 + NODE
LIFE_LOST = b"\x30\x81"


class GuardingWire(Wire):
    """A wire on which what the library sends periodically goes out as time passes."""

    def __init__(self) -> None:
        super().__init__()
        self.periodic: list[tuple[float, Callable[[], None]]] = []

    def send_periodic(self, can_id: int, data: bytes | None, period: float, remote: bool = False) -> object:
        wire = self

        class Task:
            def stop(self) -> None:
                wire.periodic.clear()

        self.periodic.append((period, lambda: self.send_message(can_id, b"", remote)))
        return Task()

    def guard_for(self, periods: int) -> None:
        for _ in range(periods):
            for period_s, send in self.periodic:
                send()
                self.pass_time(period_s)


@pytest.fixture
def eds(tmp_path: Path) -> Path:
    path = tmp_path / "full.eds"
    path.write_text(full_device_eds())
    return path


@pytest.fixture
def guarded(eds: Path) -> tuple[GuardingWire, canopen.RemoteNode]:
    wire = GuardingWire()
    wire.attach(bare_device(eds, NODE, lambda can_id, data: None))
    return wire, client(wire, eds)


def test_the_librarys_guarding_sees_the_state_and_a_bit_that_toggles(guarded: tuple[GuardingWire, canopen.RemoteNode]) -> None:
    wire, remote = guarded
    remote.nmt.start_node_guarding(0.1)
    wire.guard_for(3)
    assert wire.heard(GUARD) == [b"\x7f", b"\xff", b"\x7f"]
    assert remote.nmt.state == "PRE-OPERATIONAL"
    wire.command(0x01)
    wire.guard_for(2)
    assert wire.heard(GUARD)[3:] == [b"\x85", b"\x05"]
    assert remote.nmt.state == "OPERATIONAL"
    wire.command(0x82)
    wire.forget()
    wire.guard_for(1)
    assert wire.heard(GUARD) == [b"\x7f"], "the toggle bit begins anew"


def test_a_guarding_master_that_stays_away_is_missed_and_found_again(guarded: tuple[GuardingWire, canopen.RemoteNode]) -> None:
    wire, remote = guarded
    remote.sdo.download(0x100C, 0, u16(100))
    remote.sdo.download(0x100D, 0, u8(3))
    wire.command(0x01)
    wire.pass_time(1.0)
    assert wire.heard(0x080 + NODE) == [], "nothing is missed before the first remote frame"
    remote.nmt.start_node_guarding(0.1)
    wire.guard_for(5)
    wire.pass_time(0.19)
    assert wire.heard(0x080 + NODE) == []
    wire.pass_time(0.02)  # 0.3 s after the last remote frame
    assert [data[:3] for data in wire.heard(0x080 + NODE)] == [LIFE_LOST + b"\x11"]
    wire.forget()
    wire.guard_for(1)
    assert wire.heard(GUARD)[0][0] & 0x7F == 0x7F, "out of operational, as 1029h says"
    assert [data[:3] for data in wire.heard(0x080 + NODE)] == [b"\0\0\0"]


def test_a_heartbeat_takes_the_place_of_guarding(guarded: tuple[GuardingWire, canopen.RemoteNode]) -> None:
    wire, remote = guarded
    remote.sdo.download(0x100C, 0, u16(20))
    remote.sdo.download(0x100D, 0, u8(2))
    remote.nmt.start_node_guarding(0.01)
    wire.guard_for(1)
    remote.sdo.download(0x1017, 0, u16(50))
    wire.pass_time(0.001)
    wire.forget()
    wire.guard_for(4)
    assert wire.heard(GUARD) == [], "no answer to remote frames"
    wire.pass_time(0.2)
    assert set(wire.heard(GUARD)) == {b"\x7f"}
    assert wire.heard(0x080 + NODE) == [], "and nobody is missed"


def test_a_device_without_100c_has_no_guarding() -> None:
    wire, _ = bare_wire(DRIVE_EDS)
    wire.send_message(0x704, b"", remote=True)
    assert wire.sent == []


def test_a_time_stamp_is_taken_where_1012h_says_so(guarded: tuple[GuardingWire, canopen.RemoteNode]) -> None:
    wire, remote = guarded
    moment = datetime.datetime(2025, 3, 1, 13, 45, 10, 250000)
    stamp = int((moment - moment.replace(hour=0, minute=0, second=0, microsecond=0)).total_seconds() * 1000).to_bytes(4, "little")
    stamp += (moment.date() - datetime.date(1984, 1, 1)).days.to_bytes(2, "little")
    remote.sdo.download(0x1012, 0, u32(0x100))
    wire.frame(0x100, stamp)
    assert wire.device.time_stamp is None
    remote.sdo.download(0x1012, 0, u32(0x80000100))
    wire.frame(0x100, stamp[:5])
    assert wire.device.time_stamp is None
    assert wire.device.malformed == 1
    wire.frame(0x100, stamp)
    assert wire.device.time_stamp == moment


@pytest.mark.parametrize("value", [0x80000000, 0x80000601, 0x40000100, 0x20000100])
def test_1012h_takes_no_identifier_of_another_service_and_no_producing(guarded: tuple[Wire, canopen.RemoteNode], value: int) -> None:
    assert abort_code(lambda: guarded[1].sdo.download(0x1012, 0, u32(value))) == 0x06090030


@pytest.mark.parametrize(("value", "taken"), [(0, True), (1, True), (2, True), (3, False), (255, False)])
def test_the_error_behaviour_has_three_values(guarded: tuple[Wire, canopen.RemoteNode], value: int, taken: bool) -> None:
    write = lambda: guarded[1].sdo.download(0x1029, 1, u8(value))  # noqa: E731
    if taken:
        write()
        assert guarded[1].sdo.upload(0x1029, 1) == u8(value)
    else:
        assert abort_code(write) == 0x06090030
