"""Segmented transfers, both ways."""

from __future__ import annotations

from canopen.objectdictionary import ODVariable, datatypes

from drivers.canopen.network import SDO_REQUEST, SDO_RESPONSE
from hil.conform.aborts import LONGER, SHORTER, TOGGLE
from hil.conform.check import Checks, CheckSkippedError
from hil.conform.device import Device
from hil.conform.transfers import abort_code, head
from hil.conform.wire import QUIET_S

CHECKS = Checks("SDO, segmented")
check = CHECKS.check
_TEXTS = (datatypes.VISIBLE_STRING, datatypes.OCTET_STRING, datatypes.DOMAIN, datatypes.UNICODE_STRING)
_TEST_MS = b"\x21\x03"  # of 1017h
_SEGMENT = 7  # bytes


def long_object(device: Device, least: int) -> ODVariable:
    """Return an object of so many bytes that is read in segments, one that leaves the last of them partly unused where there is such a one.

    The check is skipped where no object is that long.
    """
    fitting: ODVariable | None = None
    for entry in device.entries:
        if entry.readable and entry.data_type in _TEXTS:
            value = device.try_read(entry.index, entry.subindex)
            if isinstance(value, bytes) and len(value) >= least:
                if len(value) % _SEGMENT:
                    return entry
                fitting = fitting or entry
    if fitting is not None:
        return fitting
    raise CheckSkippedError(f"no object has {least} bytes or more")


def _begin_upload(device: Device, least: int = 5) -> tuple[ODVariable, int]:
    """Begin a segmented upload; return its object and the size that was told, 0 where none was."""
    entry = long_object(device, least)
    answer = device.wire.sdo(head(0x40, entry.index, entry.subindex))
    device.expect(answer is not None and answer[0] & 0xFE == 0x40, "40h or 41h: a segmented upload")
    assert answer is not None
    device.expect(answer[1:4] == head(0, entry.index, entry.subindex)[1:4], "the request's multiplexer")
    return entry, int.from_bytes(answer[4:8], "little") if answer[0] & 1 else -1


@check("an upload's size is that of its segments, their toggle bit alternates from 0, and the last one says so", "7.2.4.3.7")
def upload(device: Device) -> None:
    """Read a text segment by segment."""
    entry, told = _begin_upload(device)
    size, toggle, last = 0, 0, False
    while not last and size < 65536:
        answer = device.wire.sdo(bytes((0x60 | toggle,)))
        device.expect(answer is not None and answer[0] >> 5 == 0, "a segment")
        assert answer is not None
        device.expect(answer[0] & 0x10 == toggle, f"toggle bit {toggle >> 4}")
        length, last = 7 - (answer[0] >> 1 & 7), bool(answer[0] & 1)
        device.expect(length == 7 or last, "seven bytes in every segment but the last")
        size += length
        device.expect(told < 0 or size <= told, f"the last segment at {told} bytes, as was told")
        toggle ^= 0x10
    device.expect(told in (-1, size), f"{told} bytes, as was told")
    if isinstance(entry.default, str) and entry.access_type == "const" and entry.data_type == datatypes.VISIBLE_STRING:
        device.expect(size >= len(entry.default.rstrip("\0 ")), f"all {len(entry.default)} bytes of the text")
    device.expect(device.is_alive(), "the next request is answered")


@check("an upload segment asked for with the wrong toggle bit is refused", "7.2.4.3.7")
def upload_toggle(device: Device) -> None:
    """Ask for the first segment with the bit set."""
    _begin_upload(device)
    device.expect_code(abort_code(device.wire.sdo(b"\x70")), (TOGGLE,), "the segment is refused")


@check("an upload segment asked for twice with the same toggle bit is refused", "7.2.4.3.7")
def upload_toggle_twice(device: Device) -> None:
    """Ask for the second segment with the bit of the first."""
    _begin_upload(device, 8)
    device.wire.sdo(b"\x60")
    device.expect_code(abort_code(device.wire.sdo(b"\x60")), (TOGGLE,), "the segment is refused")


@check("an upload that the client aborts is over", "7.2.4.3.17")
def upload_aborted(device: Device) -> None:
    """Abort a transfer that is under way."""
    entry, _ = _begin_upload(device)
    since = device.wire.mark()
    device.wire.send(SDO_REQUEST + device.node_id, head(0x80, entry.index, entry.subindex, 0x08000000))
    device.wire.listen(QUIET_S)
    device.expect(not device.wire.heard(SDO_RESPONSE + device.node_id, since), "silence")
    device.expect(abort_code(device.wire.sdo(b"\x60")) != 0, "no segment after the abort")
    device.expect(device.is_alive(), "the next request is answered")


def _begin_download(device: Device, told: int = 2) -> bytes | None:
    device.need(0x1017)
    device.write(0x1017, 0, 0)
    return device.wire.sdo(head(0x21, 0x1017, 0, told))


@check("a segmented download is confirmed, toggle bit by toggle bit, and the value is read back", "7.2.4.3.4")
def download(device: Device) -> None:
    """Write 1017h in two segments of one byte."""
    device.expect(_begin_download(device) == head(0x60, 0x1017, 0), "60 17 10 00")
    for place, request in enumerate((bytes((0x0C, _TEST_MS[0])), bytes((0x1D, _TEST_MS[1])))):
        answer = device.wire.sdo(request)
        device.expect(answer is not None and answer[0] == 0x20 | place << 4, f"{0x20 | place << 4:02X}h")
    device.expect(device.read(0x1017) == _TEST_MS, "the value of both segments")


@check("a download segment with the wrong toggle bit is refused, and nothing is written", "7.2.4.3.4")
def download_toggle(device: Device) -> None:
    """Send the first segment with the bit set."""
    _begin_download(device)
    device.expect_code(abort_code(device.wire.sdo(bytes((0x1B,)) + _TEST_MS)), (TOGGLE,), "the segment is refused")
    device.expect(device.number(0x1017) == 0, "1017h is what it was")


@check("a download that begins with a size of {} for two bytes is refused", "7.2.4.3.3", of=lambda device: [1, 3, 4, 100])
def download_size(device: Device, told: int) -> None:
    """Announce a wrong size, at the latest the segment is refused."""
    code = abort_code(_begin_download(device, told))
    if code == 0:
        data = bytes(min(told, 7))
        code = abort_code(device.wire.sdo(bytes(((7 - len(data)) << 1 | int(told <= 7),)) + data))
    device.expect_code(code, LONGER if told > 2 else SHORTER, f"{told} bytes are refused")
    device.expect(device.number(0x1017) == 0, "1017h is what it was")


@check("a download with more data than was announced is refused, and nothing is written", "7.2.4.3.4")
def download_longer(device: Device) -> None:
    """Announce two bytes and send five."""
    _begin_download(device)
    device.expect_code(abort_code(device.wire.sdo(bytes((0x05,)) + _TEST_MS + b"\0\0\0")), LONGER, "five bytes are refused")
    device.expect(device.number(0x1017) == 0, "1017h is what it was")
