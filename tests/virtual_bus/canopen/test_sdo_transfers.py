"""The SDO server against the canopen library's client, and frame by frame against CiA 301."""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path

import canopen
import pytest
from device_wires import DRIVE_EDS, Wire, abort_code, bare_wire, client, u16, u32
from examples import examples
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.canopen.eds import parse_object_dictionary
from virtual_bus.canopen.node import Node
from virtual_bus.canopen.sdo_block import crc16

LAB_DEVICE = """
[DeviceInfo]
ProductName=laboratory
[1000]
ParameterName=Device type
DataType=7
AccessType=ro
DefaultValue=0
[1017]
ParameterName=heartbeat
DataType=6
AccessType=rw
DefaultValue=0
[2000]
ParameterName=text
DataType=9
AccessType=rw
DefaultValue=hello
[2001]
ParameterName=domain
ObjectType=2
DataType=0xF
AccessType=rw
[2002]
ParameterName=long
DataType=0x1B
AccessType=rw
DefaultValue=0x1122334455667788
[2003]
ParameterName=secret
DataType=5
AccessType=wo
DefaultValue=1
[2004]
ParameterName=between
DataType=3
AccessType=rw
DefaultValue=0
LowLimit=-10
HighLimit=10
[2005]
ParameterName=real
DataType=8
AccessType=rw
DefaultValue=1.5
[2006]
ParameterName=narrow
DataType=0x16
AccessType=rw
DefaultValue=0x123456
[2007]
ParameterName=empty
DataType=9
AccessType=rw
DefaultValue=
"""


@pytest.fixture
def lab(tmp_path: Path) -> tuple[Wire, canopen.RemoteNode]:
    wire = Wire()
    wire.attach(Node(parse_object_dictionary(LAB_DEVICE, 4), 4, lambda can_id, data: None))
    path = tmp_path / "lab.eds"
    path.write_text(LAB_DEVICE)
    return wire, client(wire, path)


@pytest.mark.parametrize(
    ("index", "written"),
    [(0x1017, u16(500)), (0x2005, b"\x00\x00\x20\x40"), (0x2006, b"\x01\x02\x03"), (0x2000, b"abcd"), (0x2000, b"x")],
)
def test_short_values_travel_expedited(lab: tuple[Wire, canopen.RemoteNode], index: int, written: bytes) -> None:
    wire, remote = lab
    remote.sdo.download(index, 0, written)
    assert remote.sdo.upload(index, 0) == written
    assert all(data[0] & 0xE0 in (0x60, 0x40) for data in wire.heard(0x584)), "one frame each way"


@pytest.mark.parametrize("length", [0, 5, 6, 7, 8, 14, 15, 100, 1000])
def test_long_values_travel_in_segments(lab: tuple[Wire, canopen.RemoteNode], length: int) -> None:
    _, remote = lab
    written = bytes(i % 251 for i in range(length))
    remote.sdo.download(0x2001, 0, written, force_segment=True)
    assert remote.sdo.upload(0x2001, 0) == written


@pytest.mark.parametrize("length", [1, 6, 7, 8, 888, 889, 890, 2000])
@pytest.mark.parametrize("with_crc", [True, False])
def test_block_transfers_go_both_ways(lab: tuple[Wire, canopen.RemoteNode], length: int, with_crc: bool) -> None:
    _, remote = lab
    written = bytes(i * 7 % 253 for i in range(length))
    with remote.sdo.open(0x2001, 0, "wb", size=length, block_transfer=True, request_crc_support=with_crc) as stream:
        stream.write(written)
    with remote.sdo.open(0x2001, 0, "rb", block_transfer=True, request_crc_support=with_crc) as stream:
        assert stream.read() == written


def test_the_block_checksum_is_the_standards() -> None:
    assert crc16(b"123456789") == 0x31C3


def test_a_lost_block_segment_is_sent_again(lab: tuple[Wire, canopen.RemoteNode]) -> None:
    wire, remote = lab
    remote.sdo.download(0x2001, 0, bytes(range(28)), force_segment=True)
    wire.sdo_raw(bytes.fromhex("A0 01 20 00 04 00 00 00"))
    wire.forget()
    wire.frame(0x604, bytes.fromhex("A3 00 00 00 00 00 00 00"))
    assert [data[0] for data in wire.heard(0x584)] == [1, 2, 3, 0x84]
    wire.forget()
    wire.frame(0x604, bytes.fromhex("A2 02 04 00 00 00 00 00"))  # segments 3 and 4 were lost
    again = wire.heard(0x584)
    assert [data[0] for data in again] == [1, 0x82]
    assert again[0][1:] == bytes(range(14, 21))
    assert wire.sdo_raw(bytes.fromhex("A2 02 04 00 00 00 00 00"))[0] == 0xC1


def test_a_block_download_acknowledges_up_to_the_hole(lab: tuple[Wire, canopen.RemoteNode]) -> None:
    wire, remote = lab
    assert wire.sdo_raw(bytes.fromhex("C2 01 20 00 15 00 00 00"))[:5] == bytes.fromhex("A4 01 20 00 7F")
    wire.forget()
    wire.frame(0x604, b"\x01" + b"A" * 7)
    wire.frame(0x604, b"\x83" + b"C" * 7)  # segment 2 was lost
    assert wire.heard(0x584) == [bytes.fromhex("A2 01 7F 00 00 00 00 00")]
    wire.forget()
    wire.frame(0x604, b"\x01" + b"B" * 7)
    assert wire.sdo_raw(b"\x82" + b"C" * 7)[:2] == b"\xa2\x02"
    assert wire.sdo_raw(bytes.fromhex("C1 00 00 00 00 00 00 00"))[0] == 0xA1
    assert remote.sdo.upload(0x2001, 0) == b"A" * 7 + b"B" * 7 + b"C" * 7


def test_a_long_integer_needs_segments_and_keeps_its_bytes(lab: tuple[Wire, canopen.RemoteNode]) -> None:
    _, remote = lab
    assert remote.sdo.upload(0x2002, 0) == (0x1122334455667788).to_bytes(8, "little")
    remote.sdo.download(0x2002, 0, bytes(range(8)))
    assert remote.sdo.upload(0x2002, 0) == bytes(range(8))


def test_an_empty_text_reads_as_no_bytes(lab: tuple[Wire, canopen.RemoteNode]) -> None:
    _, remote = lab
    assert remote.sdo.upload(0x2007, 0) == b""


@pytest.mark.parametrize(
    ("action", "code"),
    [
        (lambda sdo: sdo.upload(0x2003, 0), 0x06010001),
        (lambda sdo: sdo.download(0x1000, 0, u32(1)), 0x06010002),
        (lambda sdo: sdo.upload(0x3000, 0), 0x06020000),
        (lambda sdo: sdo.upload(0x1000, 1), 0x06090011),
        (lambda sdo: sdo.download(0x1017, 0, u32(1)), 0x06070012),
        (lambda sdo: sdo.download(0x1017, 0, b"\x01"), 0x06070013),
        (lambda sdo: sdo.download(0x1017, 0, b"\x01", force_segment=True), 0x06070013),
        (lambda sdo: sdo.download(0x2004, 0, u16(11)), 0x06090031),
        (lambda sdo: sdo.download(0x2004, 0, u16(0x10000 - 11)), 0x06090032),
        (lambda sdo: sdo.download(0x2001, 0, bytes(70000)), 0x05040005),
    ],
)
def test_what_is_wrong_is_said_by_its_abort_code(lab: tuple[Wire, canopen.RemoteNode], action: Callable[..., object], code: int) -> None:  # type: ignore[no-untyped-def]
    _, remote = lab
    assert abort_code(lambda: action(remote.sdo)) == code


def abort_of(answer: bytes) -> int:
    assert answer[0] == 0x80, answer.hex()
    return int.from_bytes(answer[4:], "little")


def test_an_unknown_command_is_refused(lab: tuple[Wire, canopen.RemoteNode]) -> None:
    wire, _ = lab
    assert abort_of(wire.sdo_raw(bytes.fromhex("E0 00 10 00 00 00 00 00"))) == 0x05040001


def test_a_segment_without_a_transfer_is_refused(lab: tuple[Wire, canopen.RemoteNode]) -> None:
    wire, _ = lab
    assert abort_of(wire.sdo_raw(bytes.fromhex("60 00 00 00 00 00 00 00"))) == 0x05040001


@pytest.mark.parametrize("initiate", ["40 02 20 00 00 00 00 00", "21 02 20 00 08 00 00 00"])
def test_a_toggle_bit_that_does_not_alternate_is_refused_and_names_the_object(lab: tuple[Wire, canopen.RemoteNode], initiate: str) -> None:
    wire, _ = lab
    request = bytes.fromhex(initiate)
    wire.sdo_raw(request)
    answer = wire.sdo_raw(bytes((0x70 if request[0] == 0x40 else 0x10,)) + bytes(7))
    assert abort_of(answer) == 0x05030000
    assert answer[1:4] == request[1:4]


def test_a_block_size_of_zero_is_refused(lab: tuple[Wire, canopen.RemoteNode]) -> None:
    wire, _ = lab
    assert abort_of(wire.sdo_raw(bytes.fromhex("A0 00 20 00 00 00 00 00"))) == 0x05040002


def test_a_wrong_block_checksum_is_refused(lab: tuple[Wire, canopen.RemoteNode]) -> None:
    wire, remote = lab
    wire.sdo_raw(bytes.fromhex("C6 01 20 00 07 00 00 00"))
    wire.sdo_raw(b"\x81" + b"A" * 7)
    assert abort_of(wire.sdo_raw(bytes.fromhex("C1 34 12 00 00 00 00 00"))) == 0x05040004
    assert remote.sdo.upload(0x2001, 0) == b""


def test_a_segment_more_than_announced_is_refused(lab: tuple[Wire, canopen.RemoteNode]) -> None:
    wire, _ = lab
    wire.sdo_raw(bytes.fromhex("21 01 20 00 05 00 00 00"))
    assert abort_of(wire.sdo_raw(b"\x00" + b"A" * 7)) == 0x06070012


@pytest.mark.parametrize(("announced", "code"), [(8, 0x06070012), (1, 0x06070013)])
def test_a_length_that_does_not_fit_the_object_is_refused_before_any_segment(
    lab: tuple[Wire, canopen.RemoteNode], announced: int, code: int
) -> None:
    wire, _ = lab
    assert abort_of(wire.sdo_raw(bytes.fromhex("21 17 10 00") + u32(announced))) == code
    assert abort_of(wire.sdo_raw(bytes.fromhex("C2 17 10 00") + u32(announced))) == code


def test_a_new_request_ends_the_old_transfer(lab: tuple[Wire, canopen.RemoteNode]) -> None:
    wire, remote = lab
    wire.sdo_raw(bytes.fromhex("21 01 20 00 64 00 00 00"))
    assert remote.sdo.upload(0x2005, 0) == b"\x00\x00\xc0\x3f"
    assert abort_of(wire.sdo_raw(b"\x00" + b"A" * 7)) == 0x05040001


def test_a_clients_abort_is_not_answered_and_ends_the_transfer(lab: tuple[Wire, canopen.RemoteNode]) -> None:
    wire, _ = lab
    wire.sdo_raw(bytes.fromhex("21 01 20 00 64 00 00 00"))
    wire.forget()
    wire.frame(0x604, bytes.fromhex("80 01 20 00 00 00 04 05"))
    assert wire.sent == []
    assert abort_of(wire.sdo_raw(b"\x00" + b"A" * 7)) == 0x05040001


@pytest.mark.parametrize("length", range(8))
def test_a_frame_that_is_not_eight_bytes_is_no_sdo(lab: tuple[Wire, canopen.RemoteNode], length: int) -> None:
    wire, _ = lab
    wire.frame(0x604, b"\x40\x00\x10\x00\x00\x00\x00\x00"[:length])
    assert wire.sent == []


def test_a_stopped_device_does_not_answer(lab: tuple[Wire, canopen.RemoteNode]) -> None:
    wire, _ = lab
    wire.command(0x02)
    wire.frame(0x604, bytes.fromhex("40 00 10 00 00 00 00 00"))
    assert wire.sent == []


def test_a_write_is_seen_by_the_next_read_on_the_shipped_drive() -> None:
    _, remote = bare_wire(DRIVE_EDS)
    remote.sdo[0x6085].raw = 123456
    assert remote.sdo[0x6085].raw == 123456


@settings(max_examples=examples(150), deadline=None, derandomize=True)
@given(frames=st.lists(st.binary(min_size=8, max_size=8), min_size=1, max_size=12))
def test_no_sequence_of_requests_breaks_the_server(frames: list[bytes]) -> None:
    wire = Wire()
    wire.attach(Node(parse_object_dictionary(LAB_DEVICE, 4), 4, lambda can_id, data: None))
    for frame in frames:
        wire.forget()
        wire.frame(0x604, frame)
        assert all(len(data) == 8 for data in wire.heard(0x584))
    wire.frame(0x604, bytes.fromhex("80 00 00 00 00 00 00 00"))  # whatever was under way is over
    assert wire.sdo_raw(bytes.fromhex("40 00 10 00 00 00 00 00"))[:4] == bytes.fromhex("43 00 10 00")


def test_a_dead_clients_transfer_is_aborted_after_a_second_and_the_next_client_is_served(
    lab: tuple[Wire, canopen.RemoteNode],
) -> None:
    wire, remote = lab
    assert wire.sdo_raw(struct.pack("<BHBI", 0x40, 0x2000, 0, 0))[0] == 0x41  # a name in segments, and no segment is asked for
    wire.forget()
    wire.pass_time(0.9)
    assert wire.heard(0x580 + wire.device.node_id) == []
    wire.pass_time(0.2)
    assert wire.heard(0x580 + wire.device.node_id) == [struct.pack("<BHBI", 0x80, 0x2000, 0, 0x05040000)]
    wire.pass_time(5.0)
    assert len(wire.heard(0x580 + wire.device.node_id)) == 1
    assert remote.sdo.upload(0x2000, 0) == b"hello"


def test_a_block_download_that_stops_does_not_swallow_other_requests_for_ever(lab: tuple[Wire, canopen.RemoteNode]) -> None:
    wire, remote = lab
    before = remote.sdo.upload(0x1017, 0)
    assert wire.sdo_raw(struct.pack("<BHBI", 0xC2, 0x1017, 0, 2))[0] == 0xA4
    wire.pass_time(1.1)
    assert remote.sdo.upload(0x1017, 0) == before
