"""Who the node is: device type, error register, identity object, names."""

from __future__ import annotations

from hil.conform.aborts import NO_SUBINDEX
from hil.conform.check import Checks, CheckSkippedError
from hil.conform.device import Device

CHECKS = Checks("identity")
check = CHECKS.check
_FIELDS = {1: "vendor id", 2: "product code", 3: "revision number", 4: "serial number"}
_RESERVED_REGISTER_BIT = 0x40


@check("1000h, the device type, has four bytes and is the data sheet's", "7.5.2.1")
def device_type(device: Device) -> None:
    """Compare 1000h."""
    value = device.read(0x1000)
    device.expect(len(value) == 4, "four bytes")
    entry = device.entry(0x1000)
    if entry is None or not isinstance(entry.default, int):
        raise CheckSkippedError("the data sheet gives no device type")
    device.expect(int.from_bytes(value, "little") == entry.default, f"{entry.default:08X}h")


@check("1001h, the error register, has one byte, and its reserved bit 6 is clear", "7.5.2.2")
def error_register(device: Device) -> None:
    """Look at 1001h."""
    value = device.read(0x1001)
    device.expect(len(value) == 1 and not value[0] & _RESERVED_REGISTER_BIT, "one byte, bit 6 clear")


@check("1018h:00 tells the highest sub-index: all up to it are there, and none beyond", "7.5.2.21")
def identity_count(device: Device) -> None:
    """Count the entries of 1018h."""
    count = device.number(0x1018)
    device.expect(1 <= count <= len(_FIELDS), "1 to 4")
    for subindex in range(1, count + 1):
        device.expect(isinstance(device.try_read(0x1018, subindex), bytes), f"1018h:{subindex:02X} is there, since 1018h:00 is {count}")
    code = device.try_read(0x1018, count + 1)
    device.expect(code == NO_SUBINDEX, f"1018h:{count + 1:02X} is not there, since 1018h:00 is {count}: abort 0609 0011h")


@check("1018h:{}, of the identity, has four bytes and is the data sheet's", "7.5.2.21", of=lambda device: [f"{s:02d}" for s in _FIELDS])
def identity_field(device: Device, which: str) -> None:
    """Compare a field of 1018h."""
    subindex = int(which)
    entry = device.need(0x1018, subindex, writable=False)
    value = device.read(0x1018, subindex)
    device.expect(len(value) == 4, f"the {_FIELDS[subindex]} has four bytes")
    if entry.default:
        device.expect(int.from_bytes(value, "little") == entry.default, f"{_FIELDS[subindex]} {entry.default:08X}h")


@check("{}, a name of the device, is a text", "7.5.2.8 to 7.5.2.10", of=lambda device: ["1008h", "1009h", "100Ah"])
def names(device: Device, which: str) -> None:
    """Read 1008h to 100Ah."""
    index = int(which[:4], 16)
    device.need(index, writable=False)
    value = device.read(index)
    device.expect(all(32 <= byte < 127 or byte == 0 for byte in value), "visible characters", device.last_exchange())
