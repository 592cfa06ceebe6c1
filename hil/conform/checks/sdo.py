"""The SDO server: expedited transfers, commands and aborts."""

from __future__ import annotations

import struct

from drivers.canopen.network import SDO_REQUEST, SDO_RESPONSE
from hil.conform.aborts import NO_OBJECT, UNKNOWN_COMMAND
from hil.conform.check import Checks, CheckSkippedError
from hil.conform.device import Device
from hil.conform.transfers import abort_code, head
from hil.conform.wire import QUIET_S

CHECKS = Checks("SDO")
check = CHECKS.check
_TEST_MS = 0x0321  # of 1017h: two different bytes


@check("an expedited upload is answered with its size and its multiplexer", "7.2.4.3.6")
def expedited_upload(device: Device) -> None:
    """Read 1000h by hand."""
    answer = device.wire.sdo(head(0x40, 0x1000, 0))
    device.expect(answer is not None and answer[:4] == bytes.fromhex("43001000"), "43 00 10 00 and four bytes")


@check("an expedited download is answered with its multiplexer, and the value is read back", "7.2.4.3.3")
def expedited_download(device: Device) -> None:
    """Write 1017h by hand."""
    device.need(0x1017)
    device.write(0x1017, 0, 0)
    answer = device.wire.sdo(struct.pack("<BHBHH", 0x2B, 0x1017, 0, _TEST_MS, 0))
    device.expect(answer is not None and answer == bytes.fromhex("6017100000000000"), "60 17 10 00 00 00 00 00")
    device.expect(device.number(0x1017) == _TEST_MS, f"1017h reads {_TEST_MS:04X}h, low byte first")


@check("an expedited download with a sub-index is answered with it", "7.2.4.3.3")
def multiplexer(device: Device) -> None:
    """Write an entry's own value where the sub-index is not zero."""
    entry = next((e for e in device.parameters() if e.subindex and 0x1400 <= e.index < 0x1A00 and len(e) == 8), None)
    if entry is None:
        raise CheckSkippedError("no parameter of one byte with a sub-index")
    own = device.read(entry.index, entry.subindex)
    answer = device.wire.sdo(struct.pack("<BHB", 0x2F, entry.index, entry.subindex) + own)
    if answer is not None and answer[0] == 0x80:
        raise CheckSkippedError(f"{entry.index:04X}h:{entry.subindex:02X} does not take its own value while its PDO is on")
    device.expect(answer is not None and answer[:4] == struct.pack("<BHB", 0x60, entry.index, entry.subindex), "the request's multiplexer")


@check("an expedited download without its size is taken with the size of the object", "7.2.4.3.3")
def size_not_told(device: Device) -> None:
    """Write 1017h without saying how many bytes count."""
    device.need(0x1017)
    device.write(0x1017, 0, 0)
    answer = device.wire.sdo(struct.pack("<BHBI", 0x22, 0x1017, 0, _TEST_MS))
    device.expect(abort_code(answer) == 0, "60 17 10 00")
    device.expect(device.number(0x1017) == _TEST_MS, f"1017h reads {_TEST_MS:04X}h")


@check("an abort carries the multiplexer of the request", "7.2.4.3.17")
def abort_multiplexer(device: Device) -> None:
    """Ask for what is not there and look at the whole answer."""
    answer = device.wire.sdo(head(0x40, 0x1FFF, 0x12))
    device.expect(answer == struct.pack("<BHBI", 0x80, 0x1FFF, 0x12, NO_OBJECT), "80 FF 1F 12 00 00 02 06")


_NO_COMMANDS = ("E0h", "FFh", *(f"{command:02X}h without a transfer" for command in (0x60, 0x00, 0xA1, 0xA2, 0xA3, 0xC1)))


@check("command {}, which is none, is refused", "7.2.4.3.17", of=lambda device: _NO_COMMANDS)
def unknown_command(device: Device, which: str) -> None:
    """Send a command specifier that does not exist or fits nothing."""
    answer = device.wire.sdo(head(int(which[:2], 16), 0x1000, 0))
    device.expect_code(abort_code(answer), (UNKNOWN_COMMAND,), "the request is refused")


@check("a client's abort is not answered", "7.2.4.3.17")
def client_abort(device: Device) -> None:
    """Abort where nothing is under way."""
    since = device.wire.mark()
    device.wire.send(SDO_REQUEST + device.node_id, head(0x80, 0x1000, 0, 0x08000000))
    device.wire.listen(QUIET_S)
    device.expect(not device.wire.heard(SDO_RESPONSE + device.node_id, since), "silence")
    device.expect(device.is_alive(), "the next request is answered")


@check("a new request ends a transfer that is under way", "7.2.4.3.17")
def new_request(device: Device) -> None:
    """Begin a segmented download and ask for something else."""
    device.need(0x1017)
    before = device.number(0x1017)
    device.wire.sdo(head(0x21, 0x1017, 0, 2))
    device.expect(abort_code(device.wire.sdo(head(0x40, 0x1000, 0))) == 0, "the new request is answered")
    device.expect(device.number(0x1017) == before, "1017h is what it was")


@check("a request to another node's server is not answered", "7.2.4")
def foreign_server(device: Device) -> None:
    """Ask the server of another node id."""
    if device.others:
        raise CheckSkippedError("other nodes are on the bus, one of which may be asked")
    since = device.wire.mark()
    device.wire.send(SDO_REQUEST + device.node_id % 127 + 1, head(0x40, 0x1000, 0))
    device.wire.listen(QUIET_S)
    device.expect(not device.wire.heard(SDO_RESPONSE + device.node_id, since), "silence")


@check("1200h tells the identifiers at which the server answers", "7.5.2.33")
def server_parameters(device: Device) -> None:
    """Read 1200h."""
    device.need(0x1200, 1, writable=False)
    for subindex, can_id in ((1, SDO_REQUEST), (2, SDO_RESPONSE)):
        value = device.number(0x1200, subindex)
        device.expect(value & 0x7FF == can_id + device.node_id, f"1200h:{subindex:02X} holds {can_id + device.node_id:03X}h")
