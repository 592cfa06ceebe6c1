"""Every object of the data sheet: access, size, limits and defaults."""

from __future__ import annotations

import struct
from collections.abc import Iterable

from canopen.objectdictionary import ODVariable, datatypes

from hil.conform.aborts import ABOVE, BELOW, LONGER, NO_DATA, NO_OBJECT, NO_SUBINDEX, READ_ONLY, SHORTER, WRITE_ONLY
from hil.conform.check import Checks, CheckSkippedError
from hil.conform.device import COMMUNICATION, Device, within_limits
from hil.conform.transfers import abort_code

CHECKS = Checks("object dictionary")
check = CHECKS.check
_TRIGGERS = (0x1003, 0x1010, 0x1011)  # reading or writing these has rules of its own
_LAYOUT = "7.4"
_FIXED = datatypes.INTEGER_TYPES + datatypes.FLOAT_TYPES + (datatypes.BOOLEAN,)


def _named(entry: ODVariable) -> str:
    return f"{entry.index:04X}h:{entry.subindex:02X}"


class Named:
    """An entry of the data sheet that is printed as its address."""

    def __init__(self, entry: ODVariable) -> None:
        self.entry = entry

    def __str__(self) -> str:
        """Return the address."""
        return _named(self.entry)


def _fixed_size(entry: ODVariable) -> int:
    """Return the bytes of a value, 0 where a value may have any number."""
    return (len(entry) + 7) // 8 if entry.data_type in _FIXED else 0


def _readable(device: Device) -> Iterable[Named]:
    return [Named(e) for e in device.entries if e.readable and e.index not in _TRIGGERS]


def _constant(device: Device) -> Iterable[Named]:
    return [Named(e) for e in device.entries if e.access_type == "const" and isinstance(e.default, int | str) and str(e.default)]


def _read_only(device: Device) -> Iterable[Named]:
    return [
        Named(e) for e in device.entries if e.readable and not e.writable and e.index not in _TRIGGERS and e.data_type != datatypes.DOMAIN
    ]


def _write_only(device: Device) -> Iterable[Named]:
    return [Named(e) for e in device.entries if not e.readable]


def _short_parameters(device: Device) -> Iterable[Named]:
    return [Named(e) for e in device.parameters() if _fixed_size(e) in (1, 2, 4) and e.index not in _TRIGGERS]


def _limited(device: Device) -> Iterable[Named]:
    return [
        Named(e)
        for e in device.parameters()
        if e.index not in COMMUNICATION and e.data_type in datatypes.INTEGER_TYPES and (_beyond(e, e.max, 1) or _beyond(e, e.min, -1))
    ]


def _beyond(entry: ODVariable, limit: int | None, step: int) -> bytes | None:
    """Return the first value beyond a limit, None where the type ends there."""
    if limit is None:
        return None
    try:
        return (limit + step).to_bytes(_fixed_size(entry), "little", signed=entry.data_type in datatypes.SIGNED_TYPES)
    except OverflowError:
        return None


def _value(entry: ODVariable, data: bytes) -> int | float:
    if entry.data_type in datatypes.FLOAT_TYPES:
        return float(struct.unpack("<f" if len(data) == 4 else "<d", data)[0])
    return int.from_bytes(data, "little", signed=entry.data_type in datatypes.SIGNED_TYPES)


@check("{} is read, with the size of its type and within its limits", _LAYOUT, of=_readable)
def read_by_type(device: Device, named: Named) -> None:
    """Read an entry."""
    entry = named.entry
    data = device.try_read(entry.index, entry.subindex)
    if data == NO_DATA:
        raise CheckSkippedError("the device has no data for it now (abort 0800 0024h)")
    device.expect(isinstance(data, bytes), "a value")
    assert isinstance(data, bytes)
    size = _fixed_size(entry)
    if not size:
        return
    device.expect(len(data) == size, f"{size} bytes")
    if entry.data_type in datatypes.INTEGER_TYPES:
        value = _value(entry, data)
        for given in (entry.default, getattr(entry, "value", None)):
            if isinstance(given, int) and not within_limits(entry, given):
                raise CheckSkippedError(f"the data sheet's own value {given} is beyond its limits")
        device.expect(within_limits(entry, value), f"{entry.min} to {entry.max}, not {value}")


@check("{} holds the constant of the data sheet", _LAYOUT, of=_constant)
def constants(device: Device, named: Named) -> None:
    """Compare an entry of access const with its default."""
    entry = named.entry
    data = device.read(entry.index, entry.subindex)
    if isinstance(entry.default, int):
        device.expect(_value(entry, data) == entry.default, f"{entry.default:X}h")
    elif isinstance(entry.default, str) and entry.data_type == datatypes.VISIBLE_STRING:
        device.expect(data.rstrip(b"\0 ") == entry.default.encode("latin-1", "replace").rstrip(b"\0 "), repr(entry.default))


@check("{} cannot be written: read only", "7.2.4.3.17", of=_read_only)
def read_only(device: Device, named: Named) -> None:
    """Write an entry's own value to an entry that is read only."""
    entry = named.entry
    data = device.try_read(entry.index, entry.subindex)
    size = _fixed_size(entry) or 1
    own = data[:4] if isinstance(data, bytes) and data else bytes(min(size, 4))
    if len(own) < size:
        answer = device.wire.sdo(struct.pack("<BHBI", 0x21, entry.index, entry.subindex, size))
    else:
        answer = device.wire.sdo(struct.pack("<BHB", 0x23 | (4 - len(own)) << 2, entry.index, entry.subindex) + own)
    if answer is not None and answer[0] != 0x80:
        device.must_reset()  # a transfer that should not be is under way
    device.expect_code(abort_code(answer), (READ_ONLY,), "a write is refused")


@check("{} cannot be read: write only", "7.2.4.3.17", of=_write_only)
def write_only(device: Device, named: Named) -> None:
    """Read an entry that is write only."""
    code = device.try_read(named.entry.index, named.entry.subindex)
    device.expect_code(code if isinstance(code, int) else 0, (WRITE_ONLY,), "a read is refused")


@check("{} takes no value that is too long or too short", "7.2.4.3.17", of=_short_parameters)
def length(device: Device, named: Named) -> None:
    """Write an entry's own value with a byte too many, and one too few."""
    entry = named.entry
    own = device.read(entry.index, entry.subindex)
    size = _fixed_size(entry)
    device.expect(len(own) == size, f"{size} bytes")
    if size < 4:
        device.expect_code(device.try_write(entry.index, entry.subindex, own + b"\0"), LONGER, f"{size + 1} bytes are refused")
    if size > 1:
        device.expect_code(device.try_write(entry.index, entry.subindex, own[:-1]), SHORTER, f"{size - 1} bytes are refused")
    device.expect(device.read(entry.index, entry.subindex) == own, "the value is what it was")


@check("{} takes no value beyond its limits", "7.2.4.3.17", of=_limited)
def limits(device: Device, named: Named) -> None:
    """Write the first values beyond the limits."""
    entry = named.entry
    for limit, step, codes in ((entry.max, 1, ABOVE), (entry.min, -1, BELOW)):
        data = _beyond(entry, limit, step)
        if data is not None:
            code = device.try_write(entry.index, entry.subindex, data)
            device.expect_code(code, codes, f"{(limit or 0) + step} is refused")


def _absent_objects(device: Device) -> Iterable[str]:
    candidates = (0x1FFF, 0x2FFE, 0x5FFF, 0x9FFF, 0x0000, 0x0FFF)
    return [f"{index:04X}h" for index in candidates if not device.has_object(index)]


@check("{}, which the data sheet does not have, is neither read nor written", "7.2.4.3.17", of=_absent_objects)
def absent_object(device: Device, which: str) -> None:
    """Ask for an object that is not there."""
    index = int(which[:4], 16)
    code = device.try_read(index)
    device.expect_code(code if isinstance(code, int) else 0, (NO_OBJECT,), "a read is refused")
    answer = device.wire.sdo(struct.pack("<BHBI", 0x2F, index, 0, 0))
    device.expect_code(abort_code(answer), (NO_OBJECT,), "a write is refused")


def _absent_subindices(device: Device) -> Iterable[str]:
    found = []
    for index in (0x1000, 0x1001, 0x1018, 0x1017, 0x1800, 0x1A00, 0x1400, 0x1600, 0x1003):
        subindices = [entry.subindex for entry in device.entries if entry.index == index]
        if subindices:
            found.append(f"{index:04X}h:{max(subindices) + 1:02X}")
    return found


@check("{}, a sub-index that the data sheet does not have, is not read", "7.2.4.3.17", of=_absent_subindices)
def absent_subindex(device: Device, which: str) -> None:
    """Ask for a sub-index that is not there."""
    code = device.try_read(int(which[:4], 16), int(which[-2:], 16))
    device.expect_code(code if isinstance(code, int) else 0, (NO_SUBINDEX,), "a read is refused")
