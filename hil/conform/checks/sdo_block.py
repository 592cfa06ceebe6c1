"""Block transfers, both ways, where the node has them."""

from __future__ import annotations

import binascii
import struct

from drivers.canopen.network import SDO_REQUEST, SDO_RESPONSE
from hil.conform.aborts import BLOCK_SIZE, CHECKSUM, LONGER, NO_OBJECT, READ_ONLY, SEQUENCE, SHORTER, UNKNOWN_COMMAND
from hil.conform.check import Checks, CheckSkippedError
from hil.conform.checks.sdo_segmented import long_object
from hil.conform.device import Device
from hil.conform.transfers import abort_code, head
from hil.conform.wire import ANSWER_S, QUIET_S

CHECKS = Checks("SDO, block")
check = CHECKS.check
_TEST_MS = b"\x21\x03"  # of 1017h
_SMALL_BLOCK = 2


def _request(device: Device, index: int, subindex: int, size: int) -> bytes | None:
    return device.wire.sdo(struct.pack("<BHBBBH", 0xA4, index, subindex, size, 0, 0))


def _begin_upload(device: Device, size: int, least: int = 1) -> bytes:
    """Begin a block upload with so many segments in a block; return the value as another transfer gives it."""
    entry = long_object(device, least)
    value = device.read(entry.index, entry.subindex)
    answer = _request(device, entry.index, entry.subindex, size)
    if abort_code(answer) == UNKNOWN_COMMAND:
        raise CheckSkippedError("the device has no block upload (abort 0504 0001h), which it need not have")
    device.expect(answer is not None and answer[0] & 0xF9 == 0xC0, "C0h to C6h: a block upload")
    assert answer is not None
    device.expect(answer[1:4] == head(0, entry.index, entry.subindex)[1:4], "the request's multiplexer")
    if answer[0] & 2:
        device.expect(int.from_bytes(answer[4:8], "little") == len(value), f"a size of {len(value)}")
    return value


def _block(device: Device, request: bytes, size: int) -> list[bytes]:
    """Send a request and return the segments of the block that follows."""
    answer = device.wire.sdo(request)
    segments: list[bytes] = []
    while answer is not None:
        if answer[0] == 0x80:
            break
        segments.append(answer)
        device.expect(answer[0] & 0x7F == len(segments), f"segment {len(segments)}")
        if answer[0] & 0x80 or len(segments) == size:
            break
        answer = device.wire.sdo_answer(ANSWER_S)
    device.expect(bool(segments), "a block of segments")
    return segments


@check("a block upload with {} segments in a block gives the value and its checksum", "7.2.4.3.15", of=lambda device: [127, 4, 1])
def upload(device: Device, size: int) -> None:
    """Read a text in blocks."""
    value = _begin_upload(device, size)
    data, request = b"", b"\xa3"
    while True:
        segments = _block(device, request, size)
        data += b"".join(segment[1:] for segment in segments)
        acknowledge = bytes((0xA2, len(segments), size))
        if segments[-1][0] & 0x80:
            break
        device.expect(len(data) < len(value) + 7, "the last segment says so")
        request = acknowledge
    end = device.wire.sdo(acknowledge)
    device.expect(end is not None and end[0] & 0xE3 == 0xC1, "C1h to DDh: the end")
    assert end is not None
    device.expect(data[: len(data) - (end[0] >> 2 & 7)] == value, "the value that another transfer gives")
    checksum = binascii.crc_hqx(value, 0)
    device.expect(struct.unpack_from("<H", end, 1)[0] == checksum, f"checksum {checksum:04X}h, low byte first")
    device.wire.send(SDO_REQUEST + device.node_id, b"\xa1".ljust(8, b"\0"))
    device.expect(device.is_alive(), "the next request is answered")


@check("a block upload repeats the segments that were not acknowledged", "7.2.4.3.14")
def repeated(device: Device) -> None:
    """Acknowledge the first segment of two."""
    value = _begin_upload(device, _SMALL_BLOCK, 15)
    first = _block(device, b"\xa3", _SMALL_BLOCK)
    again = _block(device, bytes((0xA2, 1, _SMALL_BLOCK)), _SMALL_BLOCK)
    device.expect(again[0][1:] == first[1][1:] == value[7:14].ljust(7, b"\0"), "the second segment again, as the first")
    device.wire.send(SDO_REQUEST + device.node_id, head(0x80, 0, 0, 0x08000000))
    device.expect(device.is_alive(), "the next request is answered")


@check("a block upload with {} segments in a block is refused", "7.2.4.3.13", of=lambda device: [0, 128, 255])
def block_size(device: Device, size: int) -> None:
    """Ask for a block size that is none."""
    _begin_upload(device, 1)
    device.wire.send(SDO_REQUEST + device.node_id, head(0x80, 0, 0, 0x08000000))
    entry = long_object(device, 1)
    device.expect_code(abort_code(_request(device, entry.index, entry.subindex, size)), (BLOCK_SIZE,), "the request is refused")


@check("a block upload acknowledged beyond its end is refused", "7.2.4.3.14")
def acknowledged_beyond(device: Device) -> None:
    """Acknowledge more segments than have come."""
    _begin_upload(device, _SMALL_BLOCK)
    segments = _block(device, b"\xa3", _SMALL_BLOCK)
    answer = device.wire.sdo(bytes((0xA2, len(segments) + 1, _SMALL_BLOCK)))
    device.expect_code(abort_code(answer), (SEQUENCE, UNKNOWN_COMMAND), "the acknowledgement is refused")


@check("a block upload of what is not there is refused", "7.2.4.3.17")
def absent(device: Device) -> None:
    """Ask for an absent object in blocks."""
    _begin_upload(device, 1)
    device.wire.send(SDO_REQUEST + device.node_id, head(0x80, 0, 0, 0x08000000))
    device.expect_code(abort_code(_request(device, 0x1FFF, 0, 4)), (NO_OBJECT,), "the request is refused")


def _begin_download(device: Device, told: int = 2, command: int = 0xC6) -> None:
    """Begin a block download of 1017h, with checksum and size unless the command says otherwise."""
    device.need(0x1017)
    device.write(0x1017, 0, 0)
    answer = device.wire.sdo(head(command, 0x1017, 0, told))
    if abort_code(answer) == UNKNOWN_COMMAND:
        raise CheckSkippedError("the device has no block download (abort 0504 0001h), which it need not have")
    if told == len(_TEST_MS):
        device.expect(
            answer is not None and answer[:4] in (head(0xA4, 0x1017, 0)[:4], head(0xA0, 0x1017, 0)[:4]), "A4h or A0h, multiplexer"
        )
        assert answer is not None
        device.expect(1 <= answer[4] <= 127, "1 to 127 segments in a block")


def _end(device: Device, data: bytes, checksum: int) -> bytes | None:
    device.expect(device.wire.sdo(bytes((0x81,)) + data) is not None, "the segment is acknowledged")
    device.expect(device.wire.log[-1].data[:2] == b"\xa2\x01", "A2 01: one segment")
    return device.wire.sdo(struct.pack("<BH", 0xC1 | (7 - len(data)) << 2, checksum))


@check("a block download is confirmed, and the value is read back", "7.2.4.3.11")
def download(device: Device) -> None:
    """Write 1017h in a block of one segment."""
    for value in (_TEST_MS, _TEST_MS[::-1]):
        _begin_download(device)
        answer = _end(device, value, binascii.crc_hqx(value, 0))
        device.expect(answer is not None and answer[0] == 0xA1, "A1h: the end")
        device.expect(device.read(0x1017) == value, "the value of the segment")


@check("a block download by a client without checksums is taken", "7.2.4.3.9")
def download_without_checksum(device: Device) -> None:
    """Begin with the bit cc clear, and end without a checksum."""
    _begin_download(device, command=0xC2)
    answer = _end(device, _TEST_MS, 0)
    device.expect(answer is not None and answer[0] == 0xA1, "A1h: the end")
    device.expect(device.read(0x1017) == _TEST_MS, "the value of the segment")


@check("a block download that does not tell its size is taken", "7.2.4.3.9")
def download_without_size(device: Device) -> None:
    """Begin with the bit s clear."""
    _begin_download(device, command=0xC4)
    answer = _end(device, _TEST_MS, binascii.crc_hqx(_TEST_MS, 0))
    device.expect(answer is not None and answer[0] == 0xA1, "A1h: the end")
    device.expect(device.read(0x1017) == _TEST_MS, "the value of the segment")


@check("a block download with a wrong checksum is refused, and nothing is written", "7.2.4.3.11")
def download_checksum(device: Device) -> None:
    """End a block download with a checksum that is not its own."""
    _begin_download(device)
    if not device.wire.log[-1].data[0] & 4:
        raise CheckSkippedError("the device does not check checksums (bit sc), which it need not")
    device.expect_code(abort_code(_end(device, _TEST_MS, binascii.crc_hqx(_TEST_MS, 0) ^ 0x5A5A)), (CHECKSUM,), "the end is refused")
    device.expect(device.number(0x1017) == 0, "1017h is what it was")


@check("a block download acknowledges what came before a missing segment", "7.2.4.3.10")
def download_gap(device: Device) -> None:
    """Send the second segment, which is the last, without the first."""
    _begin_download(device)
    answer = device.wire.sdo(bytes((0x82,)) + _TEST_MS)
    device.expect(answer is not None and answer[0] in (0xA2, 0x80), "A2 00, or an abort")
    assert answer is not None
    if answer[0] == 0xA2:
        device.expect(answer[1] == 0, "A2 00: no segment")
    device.wire.send(SDO_REQUEST + device.node_id, head(0x80, 0x1017, 0, 0x08000000))
    since = device.wire.mark()
    device.wire.listen(QUIET_S)
    device.expect(not device.wire.heard(SDO_RESPONSE + device.node_id, since), "silence after the client's abort")
    device.expect(device.number(0x1017) == 0, "1017h is what it was")


@check("a block download that announces {} bytes for two is refused", "7.2.4.3.9", of=lambda device: [1, 3, 100])
def download_size(device: Device, told: int) -> None:
    """Announce a wrong size; the end of the transfer is the last place to refuse it."""
    _begin_download(device, told)
    code = abort_code(bytes(device.wire.log[-1].data).ljust(8, b"\0"))
    if code == 0:
        data = bytes(min(told, 7))
        code = abort_code(_end(device, data, binascii.crc_hqx(data, 0)))
    device.expect_code(code, LONGER if told > 2 else SHORTER, f"{told} bytes are refused")
    device.expect(device.number(0x1017) == 0, "1017h is what it was")


@check("a block download to what is read only is refused", "7.2.4.3.17")
def download_read_only(device: Device) -> None:
    """Begin a block download of 1000h."""
    _begin_download(device)
    device.wire.send(SDO_REQUEST + device.node_id, head(0x80, 0x1017, 0, 0x08000000))
    device.expect_code(abort_code(device.wire.sdo(head(0xC6, 0x1000, 0, 4))), (READ_ONLY,), "the request is refused")
