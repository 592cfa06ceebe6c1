"""PDO mapping rules, transmission types, event and inhibit times."""

from __future__ import annotations

import struct
from pathlib import Path

import canopen
import pytest
from device_wires import DRIVE_EDS, Wire, abort_code, bare_wire, client, u8, u16, u32
from examples import examples
from full_device import NODE as FULL_NODE
from full_device import full_device_eds
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.canopen.eds import parse_object_dictionary
from virtual_bus.canopen.node import Node
from virtual_bus.canopen.objects import Entry
from virtual_bus.canopen.pdo import Layout, dummy_entry

START, STOP, PRE_OPERATIONAL = 0x01, 0x02, 0x80
SYNC = 0x080
OFF, NO_RTR = 1 << 31, 1 << 30
STATUSWORD, POSITION, CURRENT, MODE_DISPLAY = 0x60410010, 0x60640020, 0x60780010, 0x60610008
CONTROLWORD, TARGET_TORQUE, HOME_OFFSET = 0x60400010, 0x60710010, 0x607C0020


@pytest.fixture
def drive() -> tuple[Wire, canopen.RemoteNode]:
    return bare_wire(DRIVE_EDS)


def configure(remote: canopen.RemoteNode, communication: int, mapped: list[int], cob_id: int, transmission_type: int) -> None:
    mapping = communication + 0x200
    cob_id |= NO_RTR if communication >= 0x1800 else 0
    remote.sdo.download(communication, 1, u32(cob_id | OFF))
    remote.sdo.download(mapping, 0, u8(0))
    for subindex, entry in enumerate(mapped, 1):
        remote.sdo.download(mapping, subindex, u32(entry))
    remote.sdo.download(mapping, 0, u8(len(mapped)))
    remote.sdo.download(communication, 2, u8(transmission_type))
    remote.sdo.download(communication, 1, u32(cob_id))


def test_the_librarys_own_configuration_is_accepted_and_its_pdos_flow(drive: tuple[Wire, canopen.RemoteNode]) -> None:
    wire, remote = drive
    remote.tpdo.read()
    remote.tpdo[2].clear()
    for name in ("Statusword", "Position actual value"):
        remote.tpdo[2].add_variable(name)
    remote.tpdo[2].cob_id, remote.tpdo[2].trans_type, remote.tpdo[2].enabled = 0x1A4, 1, True
    remote.tpdo.save()
    remote.rpdo.read()
    remote.rpdo[2].clear()
    remote.rpdo[2].add_variable("Home offset")
    remote.rpdo[2].cob_id, remote.rpdo[2].trans_type, remote.rpdo[2].enabled = 0x224, 1, True
    remote.rpdo.save()
    wire.command(START)
    wire.device.objects.find(0x6064).value = -123456
    wire.frame(0x224, struct.pack("<i", -77))
    assert remote.sdo[0x607C].raw == 0, "a synchronous RPDO waits for the SYNC"
    wire.frame(SYNC)
    assert remote.sdo[0x607C].raw == -77
    assert remote.tpdo[2]["Position actual value"].raw == -123456


@pytest.mark.parametrize(
    ("prepare", "write", "code"),
    [
        ([], (0x1A00, 0, u8(0)), 0x06010000),  # mapping of a living PDO
        ([], (0x1A00, 1, u32(STATUSWORD)), 0x06010000),
        ([], (0x1800, 1, u32(0x1A4 | NO_RTR)), 0x06090030),  # another identifier for a living PDO
        ([], (0x1800, 3, u16(10)), 0x06090030),  # inhibit time of a living PDO
        (["off"], (0x1A00, 1, u32(STATUSWORD)), 0x06010000),  # entry while the count is not 0
        (["off", "clear"], (0x1A00, 1, u32(0x50000010)), 0x06020000),  # no such object
        (["off", "clear"], (0x1A00, 1, u32(0x10080010)), 0x06040041),  # not mappable
        (["off", "clear"], (0x1A00, 1, u32(0x60410020)), 0x06040041),  # not its length
        (["off", "clear"], (0x1A00, 1, u32(0x00050008)), 0x06040041),  # a gap in what is sent
        (["off", "clear"], (0x1A00, 1, u32(0x604100FF)), 0x06040042),  # longer than any PDO
        (["off", "clear"], (0x1600, 1, u32(STATUSWORD)), 0x06010000),  # the RPDO is still on
        (["off", "clear", "three positions"], (0x1A00, 0, u8(3)), 0x06040042),  # 12 bytes
        (["off", "clear"], (0x1A00, 0, u8(8)), 0x06040042),  # 22 bytes with what the slots still hold, or empty slots
        (["off"], (0x1800, 1, u32(0x20000184 | NO_RTR)), 0x06090030),  # 29-bit identifier
        (["off"], (0x1800, 1, u32(0x604 | NO_RTR)), 0x06090030),  # SDO's identifier
        ([], (0x1800, 1, u32(0x184)), 0x06090030),  # allows RTR, which the device does not have
        ([], (0x1800, 1, u32(0x184 | OFF)), 0x06090030),
        ([], (0x1800, 2, u8(241)), 0x06090030),  # reserved transmission type
        ([], (0x1800, 2, u8(252)), 0x06090030),  # needs RTR
        ([], (0x1800, 4, u8(0)), 0x06090011),
    ],
)
def test_what_the_mapping_procedure_forbids_is_refused(
    drive: tuple[Wire, canopen.RemoteNode], prepare: list[str], write: tuple[int, int, bytes], code: int
) -> None:
    _, remote = drive
    if "off" in prepare:
        remote.sdo.download(0x1800, 1, u32(0x184 | OFF | NO_RTR))
    if "clear" in prepare:
        remote.sdo.download(0x1A00, 0, u8(0))
    if "three positions" in prepare:
        for subindex in (1, 2, 3):
            remote.sdo.download(0x1A00, subindex, u32(POSITION))
    refused = abort_code(lambda: remote.sdo.download(*write))
    if write == (0x1A00, 0, u8(8)):
        assert refused in (code, 0x06020000)
    else:
        assert refused == code


def test_an_object_that_is_read_only_cannot_be_received(drive: tuple[Wire, canopen.RemoteNode]) -> None:
    _, remote = drive
    remote.sdo.download(0x1400, 1, u32(0x204 | OFF))
    remote.sdo.download(0x1600, 0, u8(0))
    assert abort_code(lambda: remote.sdo.download(0x1600, 1, u32(STATUSWORD))) == 0x06040041


def test_a_gap_in_an_rpdo_is_skipped(drive: tuple[Wire, canopen.RemoteNode]) -> None:
    wire, remote = drive
    configure(remote, 0x1400, [0x00060010, HOME_OFFSET], 0x204, 255)
    wire.command(START)
    wire.frame(0x204, struct.pack("<Hi", 0xFFFF, 4711))
    assert remote.sdo[0x607C].raw == 4711


@pytest.mark.parametrize("transmission_type", [1, 2, 3, 240])
def test_a_cyclic_pdo_comes_every_nth_sync(drive: tuple[Wire, canopen.RemoteNode], transmission_type: int) -> None:
    wire, remote = drive
    configure(remote, 0x1800, [MODE_DISPLAY], 0x184, transmission_type)
    wire.command(START)
    came = []
    for count in range(1, 481):
        wire.forget()
        wire.frame(SYNC)
        if wire.heard(0x184):
            came.append(count)
    assert came == list(range(transmission_type, 481, transmission_type))


def test_an_acyclic_pdo_comes_with_the_sync_after_a_change(drive: tuple[Wire, canopen.RemoteNode]) -> None:
    wire, remote = drive
    configure(remote, 0x1800, [MODE_DISPLAY], 0x184, 0)
    wire.command(START)
    wire.frame(SYNC)
    wire.forget()
    wire.frame(SYNC)
    assert wire.heard(0x184) == []
    wire.device.objects.find(0x6061).value = 10
    wire.pass_time(0.01)
    assert wire.heard(0x184) == []
    wire.frame(SYNC)
    assert wire.heard(0x184) == [b"\x0a"]


def test_the_sync_counter_says_when_to_start(drive: tuple[Wire, canopen.RemoteNode]) -> None:
    wire, remote = drive
    remote.sdo[0x1019].raw = 10
    remote.sdo.download(0x1800, 1, u32(0x184 | OFF | NO_RTR))
    remote.sdo.download(0x1800, 6, u8(3))
    configure(remote, 0x1800, [MODE_DISPLAY], 0x184, 4)
    wire.command(START)
    came = []
    for count in range(1, 21):
        wire.forget()
        wire.frame(SYNC, u8((count - 1) % 10 + 1))
        if wire.heard(0x184):
            came.append(count)
    assert came == [3, 7, 11, 15, 19]


def test_a_sync_of_the_wrong_length_is_reported(drive: tuple[Wire, canopen.RemoteNode]) -> None:
    wire, _ = drive
    wire.frame(SYNC, b"\x01")
    assert wire.heard(0x084)[0][:2] == u16(0x8240)


@pytest.mark.parametrize("transmission_type", [254, 255])
def test_an_event_driven_pdo_comes_on_entering_operational_and_on_every_change(
    drive: tuple[Wire, canopen.RemoteNode], transmission_type: int
) -> None:
    wire, remote = drive
    configure(remote, 0x1800, [HOME_OFFSET], 0x184, transmission_type)
    wire.forget()
    wire.command(START)
    assert wire.heard(0x184) == [bytes(4)]
    remote.sdo[0x607C].raw = 5
    remote.sdo[0x607C].raw = 5
    assert wire.heard(0x184) == [bytes(4), struct.pack("<i", 5)]
    wire.frame(SYNC)
    assert len(wire.heard(0x184)) == 2


def test_the_inhibit_time_gathers_changes(drive: tuple[Wire, canopen.RemoteNode]) -> None:
    wire, remote = drive
    remote.sdo.download(0x1800, 1, u32(0x184 | OFF | NO_RTR))
    remote.sdo.download(0x1800, 3, u16(200))  # 20 ms
    configure(remote, 0x1800, [HOME_OFFSET], 0x184, 255)
    wire.command(START)
    wire.forget()
    for value in (1, 2, 3):
        remote.sdo[0x607C].raw = value
    wire.pass_time(0.018)
    assert wire.heard(0x184) == []
    wire.pass_time(0.004)
    assert wire.heard(0x184) == [struct.pack("<i", 3)]


def test_the_event_timer_repeats_what_does_not_change(drive: tuple[Wire, canopen.RemoteNode]) -> None:
    wire, remote = drive
    remote.sdo.download(0x1800, 5, u16(50))
    configure(remote, 0x1800, [MODE_DISPLAY], 0x184, 255)
    wire.command(START)
    wire.forget()
    wire.pass_time(1.001)
    assert len(wire.heard(0x184)) == 20


def test_pdos_flow_in_operational_only(drive: tuple[Wire, canopen.RemoteNode]) -> None:
    wire, remote = drive
    configure(remote, 0x1800, [MODE_DISPLAY], 0x184, 1)
    configure(remote, 0x1400, [HOME_OFFSET], 0x204, 255)
    for command in (START, PRE_OPERATIONAL, START, STOP, START):
        wire.command(command)
        wire.forget()
        wire.frame(SYNC)
        wire.frame(0x204, struct.pack("<i", command))
        assert len(wire.heard(0x184)) == (1 if command == START else 0)
        assert (wire.device.objects.find(0x607C).value == command) == (command == START)


def test_a_pdo_that_is_switched_off_is_silent(drive: tuple[Wire, canopen.RemoteNode]) -> None:
    wire, remote = drive
    configure(remote, 0x1800, [MODE_DISPLAY], 0x184, 1)
    wire.command(START)
    remote.sdo.download(0x1800, 1, u32(0x184 | OFF | NO_RTR))
    wire.forget()
    wire.frame(SYNC)
    assert wire.sent == []


@pytest.mark.parametrize(("length", "code", "applied"), [(2, 0x8210, False), (3, 0x8210, False), (5, 0x8220, True)])
def test_an_rpdo_of_the_wrong_length_is_reported(drive: tuple[Wire, canopen.RemoteNode], length: int, code: int, applied: bool) -> None:
    wire, remote = drive
    configure(remote, 0x1400, [HOME_OFFSET], 0x204, 255)
    wire.command(START)
    wire.forget()
    wire.frame(0x204, b"\x01\x00\x00\x00\x00"[:length])
    assert wire.heard(0x084)[0][:2] == u16(code)
    assert remote.sdo[0x607C].raw == (1 if applied else 0)
    wire.forget()
    wire.frame(0x204, b"\x02\x00\x00\x00")
    assert wire.heard(0x084) == [bytes(8)], "and it is over with the next good one"


def test_an_rpdo_that_stays_away_is_reported(drive: tuple[Wire, canopen.RemoteNode]) -> None:
    wire, remote = drive
    remote.sdo.download(0x1400, 5, u16(100))
    configure(remote, 0x1400, [HOME_OFFSET], 0x204, 255)
    wire.command(START)
    wire.forget()
    wire.pass_time(0.5)
    assert wire.heard(0x084) == [], "the watch begins with the first one"
    wire.frame(0x204, bytes(4))
    wire.pass_time(0.099)
    assert wire.heard(0x084) == []
    wire.pass_time(0.003)
    assert wire.heard(0x084)[0][:2] == u16(0x8250)


def test_remote_frames_are_not_answered(drive: tuple[Wire, canopen.RemoteNode]) -> None:
    wire, remote = drive
    configure(remote, 0x1800, [MODE_DISPLAY], 0x184, 1)
    wire.command(START)
    wire.forget()
    wire.send_message(0x184, b"", remote=True)
    assert wire.sent == []


BITS_EDS = "[DeviceInfo]\nProductName=bits\n[1000]\nParameterName=t\nDataType=7\nAccessType=ro\nDefaultValue=0\n" + "".join(
    f"[{index:04X}]\nParameterName=v{index:04X}\nDataType={data_type}\nAccessType=rw\nDefaultValue=0\nPDOMapping=1\n"
    for index, data_type in ((0x2000, 1), (0x2001, 5), (0x2002, 0x16), (0x2003, 3), (0x2004, 0x10), (0x2005, 1))
)


@settings(max_examples=examples(60), deadline=None, derandomize=True)
@given(order=st.permutations(range(6)), raw=st.integers(0, 2**64 - 1))
def test_values_of_any_width_lie_in_the_frame_in_mapping_order_lowest_bit_first(order: list[int], raw: int) -> None:
    node = Node(parse_object_dictionary(BITS_EDS, 4), 4, lambda can_id, data: None)
    entries: list[Entry] = [node.objects.find(0x2000 + i) for i in order]
    layout = Layout(entries)
    bits = [entry.bits for entry in entries]
    assert layout.length == (sum(bits) + 7) // 8
    frame = raw & ((1 << sum(bits)) - 1)
    for entry, value in zip(entries, layout.unpack(frame.to_bytes(8, "little")), strict=True):
        entry.value = value
        shift = sum(bits[: entries.index(entry)])
        expected = frame >> shift & ((1 << entry.bits) - 1)
        assert value == (expected - (1 << entry.bits) if entry.signed and expected >> (entry.bits - 1) else expected)
    assert int.from_bytes(layout.pack(), "little") == frame


def test_bits_and_odd_widths_travel_in_a_pdo(tmp_path: Path) -> None:
    pdo = "[1800]\nParameterName=c\nObjectType=9\n[1800sub0]\nParameterName=n\nDataType=5\nAccessType=ro\nDefaultValue=2\n"
    pdo += "[1800sub1]\nParameterName=id\nDataType=7\nAccessType=rw\nDefaultValue=0x184\n"
    pdo += "[1800sub2]\nParameterName=t\nDataType=5\nAccessType=rw\nDefaultValue=1\n[1A00]\nParameterName=m\nObjectType=9\n"
    pdo += "[1A00sub0]\nParameterName=n\nDataType=5\nAccessType=rw\nDefaultValue=3\n"
    for sub, mapped in ((1, 0x20000001), (2, 0x20040018), (3, 0x20050001)):
        pdo += f"[1A00sub{sub}]\nParameterName=m{sub}\nDataType=7\nAccessType=rw\nDefaultValue={mapped:#x}\n"
    sync = "[1005]\nParameterName=sync\nDataType=7\nAccessType=rw\nDefaultValue=0x80\n"
    path = tmp_path / "bits.eds"
    path.write_text(BITS_EDS + sync + pdo)
    wire = Wire()
    wire.attach(Node(parse_object_dictionary(path.read_text(), 4), 4, lambda can_id, data: None))
    remote = client(wire, path)
    remote.sdo.download(0x2000, 0, b"\x01")
    remote.sdo.download(0x2004, 0, (-2 & 0xFFFFFF).to_bytes(3, "little"))
    remote.sdo.download(0x2005, 0, b"\x01")
    wire.command(START)
    wire.frame(SYNC)
    assert wire.heard(0x184) == [(1 | 0xFFFFFE << 1 | 1 << 25).to_bytes(4, "little")]


@pytest.mark.parametrize("window_us", [0, 5000])
def test_a_synchronous_rpdo_that_comes_after_the_window_waits_for_no_sync(tmp_path: Path, window_us: int) -> None:
    """CiA 301, 7.5.2.7: until the next SYNC; what is not synchronous is taken at any time."""
    path = tmp_path / "full.eds"
    path.write_text(full_device_eds())
    wire, remote = bare_wire(path, FULL_NODE)
    remote.sdo.download(0x1007, 0, u32(window_us))
    remote.sdo.download(0x1400, 5, u16(100))
    wire.command(START)

    def taken_after(seconds: float, value: int) -> bool:
        wire.frame(SYNC)
        wire.pass_time(seconds, 0.001)
        wire.frame(0x200 + FULL_NODE, struct.pack("<hB", value, 3))
        wire.frame(0x300 + FULL_NODE, struct.pack("<I", value))
        assert remote.sdo[0x2102].raw == value
        wire.frame(SYNC)
        return bool(remote.sdo[0x2101].raw == value)

    assert taken_after(0.005, 1)
    assert taken_after(0.006, 2) is (not window_us)
    assert taken_after(0.0, 3), "the window opens with every SYNC"
    for number in range(4, 20):  # frames that are late are missing
        taken_after(0.01, number)
    assert any(data[:2] == b"\x50\x82" for data in wire.heard(0x80 + FULL_NODE)) is bool(window_us)


def test_a_dummy_is_as_wide_as_its_type() -> None:
    assert [dummy_entry(data_type).bits for data_type in range(2, 8)] == [8, 16, 32, 8, 16, 32]


def test_a_device_that_generates_sync_follows_its_own(tmp_path: Path) -> None:
    text = BITS_EDS + "".join(
        f"[{index:04X}]\nParameterName=p{index:04X}\nDataType={data_type}\nAccessType=rw\nDefaultValue={default}\n"
        for index, data_type, default in ((0x1005, 7, "0x80"), (0x1006, 7, "0"), (0x1019, 5, "0"))
    )
    path = tmp_path / "producer.eds"
    path.write_text(text)
    wire, remote = bare_wire(path)
    remote.sdo.download(0x1019, 0, u8(3))
    remote.sdo.download(0x1006, 0, u32(10_000))
    remote.sdo.download(0x1005, 0, u32(0x40000080))
    assert abort_code(lambda: remote.sdo.download(0x1005, 0, u32(0x40000081))) == 0x06090030
    assert abort_code(lambda: remote.sdo.download(0x1019, 0, u8(5))) == 0x08000022
    wire.forget()
    wire.pass_time(0.0505)
    assert wire.heard(SYNC) == [b"\x01", b"\x02", b"\x03", b"\x01", b"\x02"]
