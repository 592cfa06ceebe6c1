"""The procedure that changes what a PDO carries, and what a mapping may not be."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from canopen.objectdictionary import ODVariable

from hil.conform.aborts import (
    BAD_VALUE,
    CANNOT_MAP,
    MAPPED_LENGTH,
    NOT_MAPPABLE,
    NOT_NOW,
    NOT_STORED,
    PDO_LENGTH,
    READ_ONLY,
    UNSUPPORTED,
)
from hil.conform.check import Checks, CheckSkippedError
from hil.conform.device import INVALID, Device, Pdo
from hil.conform.pdo_setup import CAN_ID, DUMMY_BYTE, first_pdos, free_id, mapped_of, mapping_of, turn_off

CHECKS = Checks("PDO mapping")
check = CHECKS.check
_MOST_BITS = 64


def _allowed(entry: ODVariable, pdo: Pdo) -> bool:
    kinds = ("rw", "rww", "wo") if pdo.receive else ("rw", "rwr", "ro", "const")
    return bool(entry.pdo_mappable) and entry.access_type in kinds and len(entry) in (8, 16, 32, 64)


def _candidates(device: Device, pdo: Pdo) -> list[ODVariable]:
    return [entry for entry in device.entries if _allowed(entry, pdo)]


def _clear(device: Device, pdo: Pdo) -> None:
    """Switch a PDO off and empty its mapping; skip the check where that is fixed."""
    for subindex in (0, 1):
        device.need(pdo.mapping, subindex)
    turn_off(device, pdo)
    code = device.try_number(pdo.mapping, 0, 0)
    if code in (READ_ONLY, UNSUPPORTED):
        raise CheckSkippedError(f"{pdo.mapping:04X}h is fixed")
    device.expect(code == 0, f"{pdo.mapping:04X}h:00 takes 0 while the PDO is off")


def _refused(device: Device, pdo: Pdo, entries: Sequence[int], codes: Sequence[int], what: str) -> None:
    """Write a mapping that must be refused, at an entry or at the latest at the count."""
    for place, value in enumerate(entries):
        code = device.try_number(pdo.mapping, place + 1, value)
        if code:
            device.expect_code(code, codes, what)
            return
    device.expect_code(device.try_number(pdo.mapping, 0, len(entries)), codes, what)


@check("{}: its mapping is written while it is off, and it goes on with it", "7.5.2.36 and 7.5.2.38", of=first_pdos)
def procedure(device: Device, pdo: Pdo) -> None:
    """Write the mapping that is there by the procedure."""
    before = mapped_of(device, pdo)
    flags = device.number(pdo.communication, 1) & 0x40000000
    _clear(device, pdo)
    if not before:
        candidates = _candidates(device, pdo)
        if not candidates or pdo.receive:
            raise CheckSkippedError("nothing is mapped")
        before = [mapping_of(candidates[0])]
    for place, value in enumerate(before):
        code = device.try_number(pdo.mapping, place + 1, value)
        device.expect_code(code, (0,), f"entry {place + 1} takes {value:08X}h")
    device.expect_code(device.try_number(pdo.mapping, 0, len(before)), (0,), f"the count takes {len(before)}")
    device.write(pdo.communication, 1, free_id(device, pdo) | flags)
    device.expect(mapped_of(device, pdo) == before, "the mapping is read back")


@check("{}: its mapping is not written while it is on", "7.5.2.36 and 7.5.2.38", of=first_pdos)
def while_on(device: Device, pdo: Pdo) -> None:
    """Write count and entry of a PDO that is on."""
    _clear(device, pdo)
    device.must_reset()
    device.reset()
    before = mapped_of(device, pdo)
    cob_id = device.number(pdo.communication, 1)
    if cob_id & INVALID:
        if not before:
            raise CheckSkippedError("nothing is mapped")
        device.write(pdo.communication, 1, free_id(device, pdo) | cob_id & ~(INVALID | CAN_ID))
    what = "while the PDO is on: refused"
    device.expect_code(device.try_number(pdo.mapping, 0, 0), (*NOT_NOW, READ_ONLY, *BAD_VALUE), f"{pdo.mapping:04X}h:00 {what}")
    if before:
        code = device.try_number(pdo.mapping, 1, before[0])
        device.expect_code(code, (*NOT_NOW, READ_ONLY, *BAD_VALUE), f"{pdo.mapping:04X}h:01 {what}")


@check("{}: an entry is not written while the count is not zero", "7.5.2.36 and 7.5.2.38", of=first_pdos)
def while_counted(device: Device, pdo: Pdo) -> None:
    """Write an entry of a mapping that counts."""
    before = mapped_of(device, pdo)
    if not before:
        raise CheckSkippedError("nothing is mapped")
    _clear(device, pdo)
    for place, value in enumerate(before):
        device.write(pdo.mapping, place + 1, value)
    device.write(pdo.mapping, 0, len(before))
    code = device.try_number(pdo.mapping, 1, before[0])
    device.expect_code(code, (*NOT_NOW, *BAD_VALUE), f"{pdo.mapping:04X}h:01 with a count of {len(before)}: refused")


@check("{}: an object that is not there is not mapped", "7.5.2.36 and 7.5.2.38", of=first_pdos)
def absent(device: Device, pdo: Pdo) -> None:
    """Map an object and a sub-index that do not exist."""
    _clear(device, pdo)
    _refused(device, pdo, [0x1FFF0008], CANNOT_MAP, "1FFFh:00 is refused")
    candidates = _candidates(device, pdo)
    if candidates:
        entry = candidates[0]
        beyond = max(e.subindex for e in device.entries if e.index == entry.index) + 1
        _clear(device, pdo)
        _refused(device, pdo, [entry.index << 16 | beyond << 8 | len(entry)], CANNOT_MAP, f"{entry.index:04X}h:{beyond:02X} is refused")


@check("{}: an object that may not be mapped is not", "7.5.2.36 and 7.5.2.38", of=first_pdos)
def not_mappable(device: Device, pdo: Pdo) -> None:
    """Map the device type, and an object of the wrong direction."""
    _clear(device, pdo)
    _refused(device, pdo, [0x10180120], CANNOT_MAP, "1018h:01 is refused")
    wrong = next((e for e in device.entries if pdo.receive and e.pdo_mappable and e.access_type == "ro" and len(e) in (8, 16, 32)), None)
    if wrong is not None:
        _clear(device, pdo)
        _refused(device, pdo, [mapping_of(wrong)], CANNOT_MAP, f"{wrong.index:04X}h:{wrong.subindex:02X}, which is read only, is refused")


@check("{}: an object is not mapped with another length than its own", "7.5.2.36 and 7.5.2.38", of=first_pdos)
def wrong_length(device: Device, pdo: Pdo) -> None:
    """Map an object with twice and half its bits."""
    candidates = [entry for entry in _candidates(device, pdo) if len(entry) in (16, 32)]
    if not candidates:
        raise CheckSkippedError("no object of two or four bytes can be mapped")
    for bits in (2 * len(candidates[0]), len(candidates[0]) // 2):
        _clear(device, pdo)
        _refused(device, pdo, [mapping_of(candidates[0]) & ~0xFF | bits], MAPPED_LENGTH, f"{bits} bits are refused")


@check("{}: more than 64 bits are not mapped", "7.5.2.36 and 7.5.2.38", of=first_pdos)
def too_many_bits(device: Device, pdo: Pdo) -> None:
    """Map an object as often as it takes."""
    candidates = sorted(_candidates(device, pdo), key=len, reverse=True)
    places = sum(1 for e in device.entries if e.index == pdo.mapping and e.subindex)
    if not candidates or len(candidates[0]) * places <= _MOST_BITS:
        raise CheckSkippedError("there are not enough entries for more than 64 bits")
    _clear(device, pdo)
    entry = candidates[0]
    count = _MOST_BITS // len(entry) + 1
    _refused(device, pdo, [mapping_of(entry)] * count, (PDO_LENGTH, *NOT_NOW), f"{count * len(entry)} bits are refused")


@check("{}: 64 bits are mapped", "7.5.2.36 and 7.5.2.38", of=first_pdos)
def all_bits(device: Device, pdo: Pdo) -> None:
    """Map an object as often as fits."""
    places = sum(1 for e in device.entries if e.index == pdo.mapping and e.subindex)
    fitting = [entry for entry in _candidates(device, pdo) if len(entry) * places >= _MOST_BITS]
    if not fitting:
        raise CheckSkippedError("there are not enough entries for 64 bits")
    _clear(device, pdo)
    count = _MOST_BITS // len(fitting[0])
    for place in range(count):
        device.write(pdo.mapping, place + 1, mapping_of(fitting[0]))
    code = device.try_number(pdo.mapping, 0, count)
    if code in (PDO_LENGTH, NOT_MAPPABLE) and count > 1 and _many_refused(device, pdo, mapping_of(fitting[0])):
        raise CheckSkippedError("the device maps no object twice, which it need not")
    device.expect_code(code, (0,), f"a count of {count}, {_MOST_BITS} bits, is taken")


def _many_refused(device: Device, pdo: Pdo, value: int) -> bool:
    """Return whether an object is not even mapped twice."""
    _clear(device, pdo)
    for place in (1, 2):
        device.write(pdo.mapping, place, value)
    return device.try_number(pdo.mapping, 0, 2) != 0


@check("{}: a count beyond its entries is refused", "7.5.2.36 and 7.5.2.38", of=first_pdos)
def count_beyond(device: Device, pdo: Pdo) -> None:
    """Count one more than there are."""
    _clear(device, pdo)
    places = sum(1 for e in device.entries if e.index == pdo.mapping and e.subindex)
    code = device.try_number(pdo.mapping, 0, places + 1)
    device.expect_code(code, (PDO_LENGTH, *CANNOT_MAP, *BAD_VALUE, NOT_STORED), f"a count of {places + 1} is refused")


def _with_times(device: Device) -> Iterable[Pdo]:
    return [pdo for pdo in device.pdos(receive=False)[:4] if device.entry(pdo.communication, 3) is not None]


@check("{}:03, the inhibit time, is not changed while the PDO is on", "7.5.2.37", of=_with_times)
def inhibit_while_on(device: Device, pdo: Pdo) -> None:
    """Write an inhibit time."""
    device.need(pdo.communication, 3)
    flags = turn_off(device, pdo) & 0x40000000
    device.write(pdo.communication, 3, 100)
    device.write(pdo.communication, 1, free_id(device, pdo) | flags)
    device.expect_code(device.try_number(pdo.communication, 3, 200), (*NOT_NOW, *BAD_VALUE), "another time is refused")


@check("{}:02 takes no reserved transmission type", "7.5.2.35 and 7.5.2.37", of=first_pdos)
def reserved_types(device: Device, pdo: Pdo) -> None:
    """Write types 241 and 251."""
    device.need(pdo.communication, 2)
    turn_off(device, pdo)
    for kind in (241, 251):
        code = device.try_number(pdo.communication, 2, kind)
        device.expect_code(code, BAD_VALUE, f"type {kind} is refused")


def _dummies(device: Device) -> Iterable[Pdo]:
    return device.pdos(receive=True)[:1] if 0x0005 in device.dictionary else []


@check("{}: a dummy entry of the data sheet fills a gap", "7.5.2.36", of=_dummies)
def dummy(device: Device, pdo: Pdo) -> None:
    """Map eight bits that nobody reads."""
    _clear(device, pdo)
    device.expect_code(device.try_number(pdo.mapping, 1, DUMMY_BYTE), (0,), "0005h:00 of 8 bits is taken")
    device.expect_code(device.try_number(pdo.mapping, 0, 1), (0,), "a count of 1 is taken")
