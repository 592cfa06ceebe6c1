"""LSS (CiA 305) of a bare device, with the canopen library's LSS master; and what outlives a restart of the device."""

from __future__ import annotations

from pathlib import Path

import canopen
import pytest
from command_line import Isocenter
from device_wires import DRIVE_EDS, Wire, bare_wire, u16, u32
from full_device import NODE, PRODUCT, REVISION, SERIAL, VENDOR, full_device_eds

from virtual_bus.canopen.bare import bare_device

IDENTITY = (VENDOR, PRODUCT, REVISION, SERIAL)
ANSWER = 0x7E4


@pytest.fixture(autouse=True)
def impatient_master(monkeypatch: pytest.MonkeyPatch) -> None:
    """The device answers before `send` returns, so the library's pauses are not needed."""
    monkeypatch.setattr("canopen.lss.time.sleep", lambda seconds: None)
    monkeypatch.setattr(canopen.lss.LssMaster, "RESPONSE_TIMEOUT", 0.001)


@pytest.fixture
def eds(tmp_path: Path) -> Path:
    path = tmp_path / "full.eds"
    path.write_text(full_device_eds())
    return path


def wired(eds: Path, node_id: int = NODE, memory: Path | None = None) -> Wire:
    wire = Wire()
    wire.attach(bare_device(eds, node_id, lambda can_id, data: None, memory))
    return wire


def sdo_answers(wire: Wire, node_id: int) -> bool:
    wire.forget()
    wire.frame(0x600 + node_id, bytes.fromhex("40 00 10 00 00 00 00 00"))
    return bool(wire.heard(0x580 + node_id))


def test_the_library_selects_a_device_by_its_identity_and_asks_it(eds: Path) -> None:
    wire = wired(eds)
    assert wire.lss.send_switch_state_selective(*IDENTITY)
    assert wire.lss.inquire_node_id() == NODE
    assert tuple(wire.lss.inquire_lss_address(0x5A + i) for i in range(4)) == IDENTITY
    assert wire.lss.send_identify_remote_slave(VENDOR, PRODUCT, 0, 0xFFFFFFFF, SERIAL, SERIAL) is None
    assert wire.heard(ANSWER)[-1][0] == 0x4F


@pytest.mark.parametrize("wrong", range(4))
def test_a_device_is_not_selected_by_another_identity(eds: Path, wrong: int) -> None:
    wire = wired(eds)
    other = [number + (place == wrong) for place, number in enumerate(IDENTITY)]
    with pytest.raises(canopen.lss.LssError):
        wire.lss.send_switch_state_selective(*other)
    with pytest.raises(canopen.lss.LssError):
        wire.lss.inquire_node_id()


def test_a_new_node_id_holds_from_the_next_communication_reset_on(eds: Path) -> None:
    wire = wired(eds)
    wire.lss.send_switch_state_global(wire.lss.CONFIGURATION_STATE)
    wire.lss.configure_node_id(42)
    assert sdo_answers(wire, NODE)
    assert not sdo_answers(wire, 42)
    wire.lss.send_switch_state_global(wire.lss.WAITING_STATE)
    wire.forget()
    wire.frame(0x000, bytes((0x82, NODE)))
    assert wire.heard(0x700 + 42) == [b"\0"]
    assert sdo_answers(wire, 42)
    assert not sdo_answers(wire, NODE)
    assert wire.sdo_raw(bytes.fromhex("40 00 18 01 00 00 00 00"))[4:] == u32(0x40000180 + 42), "defaults follow the node id"


@pytest.mark.parametrize("node_id", [0, 128, 254])
def test_a_node_id_out_of_range_is_refused(eds: Path, node_id: int) -> None:
    wire = wired(eds)
    wire.lss.send_switch_state_global(wire.lss.CONFIGURATION_STATE)
    with pytest.raises(canopen.lss.LssError, match="1"):
        wire.lss.configure_node_id(node_id)


def test_a_bit_timing_is_taken_where_the_data_sheet_has_it(tmp_path: Path) -> None:
    path = tmp_path / "slow.eds"
    path.write_text(full_device_eds().replace("LSS_Supported=1", "LSS_Supported=1\nBaudRate_500=1\nBaudRate_1000=0"))
    wire = wired(path)
    wire.lss.send_switch_state_global(wire.lss.CONFIGURATION_STATE)
    wire.lss.configure_bit_timing(2)
    for index in (0, 5, 9):
        with pytest.raises(canopen.lss.LssError):
            wire.lss.configure_bit_timing(index)


def test_nothing_is_configured_in_the_waiting_state(eds: Path) -> None:
    wire = wired(eds)
    for ask in (lambda: wire.lss.configure_node_id(42), wire.lss.store_configuration, wire.lss.inquire_node_id):
        with pytest.raises(canopen.lss.LssError, match="No LSS response"):
            ask()


def test_fastscan_finds_a_device_without_a_node_id_and_gives_it_one(eds: Path) -> None:
    wire = wired(eds, node_id=255)
    assert wire.sent == [], "no boot-up"
    found, identity = wire.lss.fast_scan()
    assert found
    assert tuple(identity) == IDENTITY
    wire.lss.configure_node_id(7)
    wire.lss.send_switch_state_global(wire.lss.WAITING_STATE)
    assert wire.heard(0x707) == [b"\0"]
    assert sdo_answers(wire, 7)
    assert wire.lss.fast_scan() == (False, None), "it has one now"


def test_what_is_stored_outlives_a_restart(eds: Path, tmp_path: Path) -> None:
    memory = tmp_path / "memory.json"
    wire = wired(eds, memory=memory)
    wire.lss.send_switch_state_global(wire.lss.CONFIGURATION_STATE)
    wire.lss.configure_node_id(9)
    wire.lss.store_configuration()
    for request in ("2b 17 10 00 64 00 00 00", "23 10 10 01 73 61 76 65"):
        assert wire.sdo_raw(bytes.fromhex(request))[0] == 0x60
    again = wired(eds, memory=memory)
    assert again.sent == [(0x709, b"\0")]
    assert again.sdo_raw(bytes.fromhex("40 17 10 00 00 00 00 00"))[4:6] == u16(100)
    assert again.sdo_raw(bytes.fromhex("23 11 10 01 6c 6f 61 64"))[0] == 0x60
    third = wired(eds, memory=memory)
    assert third.sdo_raw(bytes.fromhex("40 17 10 00 00 00 00 00"))[4:6] == u16(100), "restored by the reset that follows only"
    again.command(0x81)
    fourth = wired(eds, memory=memory)
    assert fourth.sdo_raw(bytes.fromhex("40 17 10 00 00 00 00 00"))[4:6] == u16(0)
    assert fourth.device.node_id == 9


def test_a_device_whose_data_sheet_says_nothing_of_lss_has_none() -> None:
    wire, _ = bare_wire(DRIVE_EDS)
    wire.frame(0x7E5, bytes.fromhex("04 01 00 00 00 00 00 00"))
    wire.frame(0x7E5, bytes.fromhex("5e 00 00 00 00 00 00 00"))
    assert wire.sent == []


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--eds", str(DRIVE_EDS), "--node", "255"), "LSS_Supported=0"),
        (("--eds", str(DRIVE_EDS), "--node", "128"), "must be 1 to 127"),
        (("carm", "--memory", "memory.json"), "--eds"),
    ],
)
def test_what_the_emulator_cannot_serve_is_one_line(isocenter: Isocenter, arguments: tuple[str, ...], words: str) -> None:
    done = isocenter("emulate", *arguments, "--bus", "virtual:lss")
    assert done.status == 2
    assert words in done.line
