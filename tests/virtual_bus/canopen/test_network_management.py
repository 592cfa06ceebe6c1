"""NMT states, boot-up, heartbeats both ways, emergencies, stored parameters."""

from __future__ import annotations

from pathlib import Path

import canopen
import pytest
from device_wires import DRIVE_EDS, ENCODER_EDS, Wire, abort_code, bare_wire, u16, u32
from full_device import full_device_eds

from virtual_bus.canopen.bare import bare_device
from virtual_bus.errors import EmulatorError

START, STOP, PRE_OPERATIONAL, RESET_NODE, RESET_COMMUNICATION = 0x01, 0x02, 0x80, 0x81, 0x82
MASTER = 0x77F  # heartbeat of node 127


@pytest.fixture
def drive() -> tuple[Wire, canopen.RemoteNode]:
    return bare_wire(DRIVE_EDS)


def test_a_device_boots_into_pre_operational_and_says_so_once() -> None:
    wire = Wire()
    wire.attach(bare_device(DRIVE_EDS, 4, lambda can_id, data: None))
    assert wire.sent == [(0x704, b"\x00")]
    wire.device.send_heartbeat()
    assert wire.sent[-1] == (0x704, b"\x7f")


@pytest.mark.parametrize(
    ("commands", "state"),
    [
        ([START], 0x05),
        ([STOP], 0x04),
        ([START, PRE_OPERATIONAL], 0x7F),
        ([START, STOP, START], 0x05),
        ([START, RESET_NODE], 0x7F),
        ([STOP, RESET_COMMUNICATION], 0x7F),
        ([0x55], 0x7F),
    ],
)
def test_network_commands_lead_to_the_standards_states(drive: tuple[Wire, canopen.RemoteNode], commands: list[int], state: int) -> None:
    wire, _ = drive
    for command in commands:
        wire.command(command)
    wire.forget()
    wire.device.send_heartbeat()
    assert wire.sent == [(0x704, bytes((state,)))]


def test_commands_for_others_are_ignored_and_for_all_are_obeyed(drive: tuple[Wire, canopen.RemoteNode]) -> None:
    wire, _ = drive
    wire.frame(0x000, bytes((START, 9)))
    assert wire.device.state == 0x7F
    wire.frame(0x000, bytes((START, 0)))
    assert wire.device.state == 0x05


def test_heartbeats_come_with_the_period_that_is_written(drive: tuple[Wire, canopen.RemoteNode]) -> None:
    wire, remote = drive
    remote.sdo[0x1017].raw = 100
    wire.forget()
    wire.pass_time(0.001)
    assert wire.heard(0x704) == [b"\x7f"], "the first one at once"
    wire.forget()
    wire.pass_time(1.0)
    assert wire.heard(0x704) == [b"\x7f"] * 10
    remote.sdo[0x1017].raw = 0
    wire.forget()
    wire.pass_time(1.0)
    assert wire.heard(0x704) == []


def test_heartbeats_go_on_when_stopped(drive: tuple[Wire, canopen.RemoteNode]) -> None:
    wire, remote = drive
    remote.sdo[0x1017].raw = 100
    wire.command(STOP)
    wire.forget()
    wire.pass_time(0.5)
    assert set(wire.heard(0x704)) == {b"\x04"}


def watch_master(wire: Wire, remote: canopen.RemoteNode) -> None:
    remote.sdo.download(0x1016, 1, u32(127 << 16 | 200))
    wire.command(START)


def test_supervision_starts_with_the_first_heartbeat(drive: tuple[Wire, canopen.RemoteNode]) -> None:
    wire, remote = drive
    watch_master(wire, remote)
    wire.forget()
    wire.pass_time(2.0)
    assert wire.heard(0x084) == []
    wire.frame(MASTER, b"\x05")
    wire.pass_time(0.195)
    assert wire.heard(0x084) == []
    wire.pass_time(0.010)
    assert wire.heard(0x084) == [bytes.fromhex("30 81 11 7F 00 00 00 00")]
    assert wire.device.state == 0x7F, "error behaviour 1029h: pre-operational by default"


@pytest.mark.parametrize(("behaviour", "state"), [(0, 0x7F), (1, 0x05), (2, 0x04)])
def test_a_lost_heartbeat_leads_where_the_error_behaviour_says(drive: tuple[Wire, canopen.RemoteNode], behaviour: int, state: int) -> None:
    wire, remote = drive
    remote.sdo.download(0x1029, 1, bytes((behaviour,)))
    watch_master(wire, remote)
    wire.frame(MASTER, b"\x05")
    wire.pass_time(0.3)
    assert wire.device.state == state


def test_a_heartbeat_that_returns_clears_the_error(drive: tuple[Wire, canopen.RemoteNode]) -> None:
    wire, remote = drive
    watch_master(wire, remote)
    wire.frame(MASTER, b"\x05")
    wire.pass_time(0.3)
    wire.forget()
    wire.frame(MASTER, b"\x05")
    assert wire.heard(0x084) == [bytes(8)]
    assert remote.sdo[0x1001].raw == 0
    wire.forget()
    wire.pass_time(0.3)
    assert len(wire.heard(0x084)) == 1, "and it is watched again"


def test_one_node_cannot_be_supervised_twice(drive: tuple[Wire, canopen.RemoteNode]) -> None:
    _, remote = drive
    remote.sdo.download(0x1016, 1, u32(5 << 16 | 200))
    assert abort_code(lambda: remote.sdo.download(0x1016, 2, u32(5 << 16 | 300))) == 0x06040043


def test_errors_fill_the_history_newest_first_and_the_count_can_be_cleared(drive: tuple[Wire, canopen.RemoteNode]) -> None:
    wire, remote = drive
    assert abort_code(lambda: remote.sdo.upload(0x1003, 1)) == 0x08000024
    wire.device.emergency.raise_error(0x2310, b"\x34\x12")
    wire.device.emergency.raise_error(0x4210)
    wire.device.emergency.raise_error(0x4210)
    assert wire.heard(0x084) == [bytes.fromhex("10 23 03 34 12 00 00 00"), bytes.fromhex("10 42 0B 00 00 00 00 00")]
    assert [remote.sdo[0x1003][i].raw for i in range(3)] == [2, 0x4210, 0x12342310]
    assert remote.sdo[0x1001].raw == 0x0B, "generic, current, temperature"
    assert abort_code(lambda: remote.sdo.download(0x1003, 0, b"\x01")) == 0x06090030
    remote.sdo.download(0x1003, 0, b"\x00")
    assert abort_code(lambda: remote.sdo.upload(0x1003, 1)) == 0x08000024


def test_the_history_keeps_the_newest_when_it_is_full(drive: tuple[Wire, canopen.RemoteNode]) -> None:
    wire, remote = drive
    for code in range(0x5000, 0x500A):
        wire.device.emergency.raise_error(code)
    assert [remote.sdo[0x1003][i].raw for i in (0, 1, 8)] == [8, 0x5009, 0x5002]


def test_the_error_register_shows_what_is_left(drive: tuple[Wire, canopen.RemoteNode]) -> None:
    wire, _ = drive
    emergency = wire.device.emergency
    emergency.raise_error(0x2310)
    emergency.raise_error(0x8130)
    wire.forget()
    emergency.clear_error(0x2310)
    emergency.clear_error(0x2310)
    assert wire.heard(0x084) == [bytes.fromhex("00 00 11 00 00 00 00 00")]


def test_the_inhibit_time_holds_emergencies_back(drive: tuple[Wire, canopen.RemoteNode]) -> None:
    wire, remote = drive
    remote.sdo[0x1015].raw = 500  # 50 ms
    wire.forget()
    for code in (0x5000, 0x5001, 0x5002):
        wire.device.emergency.raise_error(code)
    assert len(wire.heard(0x084)) == 1
    wire.pass_time(0.049)
    assert len(wire.heard(0x084)) == 1
    wire.pass_time(0.003)
    assert len(wire.heard(0x084)) == 2
    wire.pass_time(0.051)
    assert [data[:2] for data in wire.heard(0x084)] == [u16(0x5000), u16(0x5001), u16(0x5002)]


def test_a_stopped_device_sends_no_emergency(drive: tuple[Wire, canopen.RemoteNode]) -> None:
    wire, _ = drive
    wire.command(STOP)
    wire.forget()
    wire.device.emergency.raise_error(0x5000)
    assert wire.heard(0x084) == []


@pytest.mark.parametrize(
    ("index", "value", "code"),
    [
        (0x1005, u32(0x101), 0x06090030),
        (0x1005, u32(0x40000080), 0x06090030),  # this device generates no SYNC
        (0x1014, u32(0x000), 0x06090030),
        (0x1014, u32(0x85), 0x06090030),  # in use: only bit 31 may change
        (0x1014, u32(0x20000084), 0x06090030),
        (0x1019, b"\x01", 0x06090030),
        (0x1019, b"\xf1", 0x06090030),
    ],
)
def test_communication_parameters_out_of_the_standard_are_refused(
    drive: tuple[Wire, canopen.RemoteNode], index: int, value: bytes, code: int
) -> None:
    _, remote = drive
    assert abort_code(lambda: remote.sdo.download(index, 0, value)) == code


def test_the_emergency_identifier_moves_by_way_of_invalid(drive: tuple[Wire, canopen.RemoteNode]) -> None:
    wire, remote = drive
    remote.sdo[0x1014].raw = 0x80000084
    wire.device.emergency.raise_error(0x5000)
    assert wire.heard(0x084) == []
    remote.sdo[0x1014].raw = 0x0C4
    wire.device.emergency.raise_error(0x5001)
    assert len(wire.heard(0x0C4)) == 1


def test_a_node_off_the_bus_is_silent_and_reports_when_it_is_back(drive: tuple[Wire, canopen.RemoteNode]) -> None:
    wire, remote = drive
    remote.sdo[0x1017].raw = 100
    wire.pass_time(0.01)
    wire.forget()
    wire.device.bus_off()
    wire.pass_time(1.0)
    wire.frame(0x604, bytes.fromhex("40 00 10 00 00 00 00 00"))
    assert wire.sent == []
    wire.device.bus_on()
    assert wire.heard(0x084)[0][:2] == u16(0x8140)


@pytest.mark.parametrize(("command", "kept"), [(RESET_NODE, False), (RESET_COMMUNICATION, True)])
def test_a_reset_of_communication_leaves_the_application_alone(drive: tuple[Wire, canopen.RemoteNode], command: int, kept: bool) -> None:
    wire, remote = drive
    default = remote.sdo[0x6085].raw
    remote.sdo[0x6085].raw = default + 1
    remote.sdo[0x1017].raw = 500
    wire.command(command)
    assert remote.sdo[0x1017].raw == 0
    assert remote.sdo[0x6085].raw == (default + 1 if kept else default)


def test_saved_parameters_survive_power_off_and_load_brings_the_defaults_back(tmp_path: Path) -> None:
    memory = tmp_path / "encoder.json"
    wire, remote = bare_wire(ENCODER_EDS, 4, memory)
    assert remote.sdo[0x1010][1].raw == 1
    assert remote.sdo[0x1011][1].raw == 1
    remote.sdo[0x1017].raw = 250
    assert abort_code(lambda: remote.sdo.download(0x1010, 1, b"SAVE")) == 0x08000020
    remote.sdo.download(0x1010, 1, b"save")
    remote.sdo[0x1017].raw = 777  # not saved
    _, again = bare_wire(ENCODER_EDS, 4, memory)
    assert again.sdo[0x1017].raw == 250
    assert abort_code(lambda: again.sdo.download(0x1011, 1, b"save")) == 0x08000020
    again.sdo.download(0x1011, 1, b"load")
    assert again.sdo[0x1017].raw == 250, "restored at the next reset, not before"
    wire, last = bare_wire(ENCODER_EDS, 4, memory)
    assert last.sdo[0x1017].raw == 250, "power failed before the reset"
    last.sdo.download(0x1011, 1, b"load")
    wire.command(RESET_NODE)
    assert last.sdo[0x1017].raw == 0
    _, after = bare_wire(ENCODER_EDS, 4, memory)
    assert after.sdo[0x1017].raw == 0


def test_a_restore_is_done_once() -> None:
    wire, remote = bare_wire(ENCODER_EDS)
    remote.sdo.download(0x1011, 1, b"load")
    wire.command(RESET_NODE)
    remote.sdo[0x1017].raw = 250
    remote.sdo.download(0x1010, 1, b"save")
    wire.command(RESET_NODE)
    assert remote.sdo[0x1017].raw == 250


def test_saving_one_group_leaves_the_others(tmp_path: Path) -> None:
    memory = tmp_path / "drive.json"
    _, remote = bare_wire(DRIVE_EDS, 4, memory)
    remote.sdo[0x1017].raw = 250
    remote.sdo[0x6085].raw = 99
    remote.sdo.download(0x1010, 2, b"save")
    _, again = bare_wire(DRIVE_EDS, 4, memory)
    assert again.sdo[0x1017].raw == 250
    assert again.sdo[0x6085].raw == 200000


@pytest.mark.parametrize(
    ("index", "subindex", "data", "changed"),
    [
        (0x1017, 0, u16(50), True),
        (0x1017, 0, u16(0), False),  # what it has
        (0x2120, 2, u16(9), True),
        (0x1020, 2, u32(34), False),
        (0x1003, 0, b"\0", False),
    ],
)
def test_a_configuration_is_known_by_its_time_until_a_parameter_differs(
    tmp_path: Path, index: int, subindex: int, data: bytes, changed: bool
) -> None:
    """CiA 301, 7.5.2.23, also after it was stored."""
    eds = tmp_path / "full.eds"
    eds.write_text(full_device_eds())
    wire, remote = bare_wire(eds, memory=tmp_path / "memory.json")
    for place, value in ((1, 12), (2, 34)):
        remote.sdo.download(0x1020, place, u32(value))
    remote.sdo.download(0x1010, 1, b"save")
    wire.command(RESET_NODE)
    assert [remote.sdo[0x1020][place].raw for place in (1, 2)] == [12, 34]
    remote.sdo.download(index, subindex, data)
    assert [remote.sdo[0x1020][place].raw for place in (1, 2)] == ([0, 0] if changed else [12, 34])


def test_a_memory_file_of_something_else_is_named(tmp_path: Path) -> None:
    memory = tmp_path / "drive.json"
    memory.write_text('{"1017:00": "zz"}')
    with pytest.raises(EmulatorError, match=r"drive\.json: not a device's stored parameters"):
        bare_wire(DRIVE_EDS, 4, memory)
