"""Setting up a PDO by the procedure of CiA 301, 7.5.2.36 and 7.5.2.38: off, count to zero, entries, count, on."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from canopen.objectdictionary import ODVariable

from hil.conform.check import CheckSkippedError
from hil.conform.device import INVALID, Device, Pdo

_NAMED = {"inhibit": 3, "event": 5, "start": 6}
DUMMY_BYTE = 0x00050008  # eight bits of an RPDO that nobody reads
_MOST = 4  # PDOs of one direction that are looked at: the others have the same rules
CAN_ID = 0x7FF


def mapping_of(entry: ODVariable) -> int:
    """Return the mapping entry of a whole object."""
    return entry.index << 16 | entry.subindex << 8 | len(entry)


def first_pdos(device: Device) -> Iterable[Pdo]:
    """Return the first PDOs of both directions."""
    return device.pdos(receive=True)[:_MOST] + device.pdos(receive=False)[:_MOST]


def first_tpdos(device: Device) -> Iterable[Pdo]:
    """Return the first TPDOs."""
    return device.pdos(receive=False)[:_MOST]


def one(device: Device, *, receive: bool) -> Pdo:
    """Return a PDO of a direction; skip the check where there is none that can be set up."""
    for pdo in device.pdos(receive=receive):
        entry = device.entry(pdo.communication, 1)
        if entry is not None and entry.writable:
            return pdo
    raise CheckSkippedError(f"the data sheet has no {'RPDO' if receive else 'TPDO'} whose COB-ID can be written")


def turn_off(device: Device, pdo: Pdo) -> int:
    """Switch a PDO off and return its COB-ID; skip the check where that is not possible."""
    device.need(pdo.communication, 1)
    cob_id = device.number(pdo.communication, 1)
    device.write(pdo.communication, 1, cob_id | INVALID)
    return cob_id


def free_id(device: Device, pdo: Pdo) -> int:
    """Return the PDO's own identifier where it has an allowed one, else one of the predefined set that no PDO uses."""
    own = device.number(pdo.communication, 1) & CAN_ID
    if 0x181 <= own <= 0x57F:
        return own
    others = [p for p in device.pdos(receive=True) + device.pdos(receive=False)]
    used = {device.number(p.communication, 1) & CAN_ID for p in others}
    return next(can_id for can_id in (0x1E5, 0x1E6, 0x265, 0x266, 0x2E5, 0x365) if can_id not in used)


def mapped_of(device: Device, pdo: Pdo) -> list[int]:
    """Return the mapping entries in force."""
    return [device.number(pdo.mapping, i + 1) for i in range(min(device.number(pdo.mapping), 64))]


def set_up(device: Device, pdo: Pdo, transmission: int, mapped: Sequence[int] | None = None, **times: int) -> int:
    """Set a PDO up and switch it on; return its identifier.

    Parameters
    ----------
    transmission : int
        Type, object sub-index 2.
    mapped : sequence of int, optional
        Mapping entries; None keeps what is mapped.
    **times : int
        `inhibit` [100 us], `event` [ms] and `start`: the SYNC counter's start value.
    """
    turn_off(device, pdo)
    if mapped is not None and list(mapped) != mapped_of(device, pdo):
        device.need(pdo.mapping)
        device.need(pdo.mapping, len(mapped))
        device.write(pdo.mapping, 0, 0)
        for place, value in enumerate(mapped):
            device.write(pdo.mapping, place + 1, value)
        device.write(pdo.mapping, 0, len(mapped))
    if device.number(pdo.communication, 2) != transmission:
        device.need(pdo.communication, 2)
        if device.try_number(pdo.communication, 2, transmission):
            raise CheckSkippedError(f"{pdo} does not take transmission type {transmission}, which it need not support")
    for name, subindex in _NAMED.items():
        there = device.entry(pdo.communication, subindex)
        if there is None or not there.writable:
            if times.get(name):
                raise CheckSkippedError(f"the data sheet has no {pdo}:{subindex:02X} that can be written")
        elif device.number(pdo.communication, subindex) != times.get(name, 0):
            device.write(pdo.communication, subindex, times.get(name, 0))
    can_id = free_id(device, pdo)
    flags = device.number(pdo.communication, 1) & 0x40000000
    device.write(pdo.communication, 1, can_id | flags)
    return can_id


def tpdo(device: Device, transmission: int, mapped: Sequence[int] | None = None, **times: int) -> int:
    """Set up a TPDO that has something to send; return its identifier."""
    pdo = one(device, receive=False)
    if mapped is None and not mapped_of(device, pdo):
        entry = next((e for e in device.entries if e.pdo_mappable and e.readable and len(e) in (8, 16, 32)), None)
        if entry is None:
            raise CheckSkippedError("no TPDO maps anything, and nothing can be mapped")
        mapped = [mapping_of(entry)]
    silence_others(device, pdo)
    return set_up(device, pdo, transmission, mapped, **times)


def dummy_rpdo(device: Device, transmission: int, **times: int) -> int:
    """Set up an RPDO of two bytes that nobody reads; return its identifier. No command object is ever mapped."""
    if 0x0005 not in device.dictionary or device.dictionary[0x0005] is None:
        raise CheckSkippedError("the data sheet allows no dummy entries (0005h) in an RPDO")
    pdo = one(device, receive=True)
    return set_up(device, pdo, transmission, [DUMMY_BYTE, DUMMY_BYTE], **times)


def silence_others(device: Device, kept: Pdo) -> None:
    """Switch the other TPDOs off, which may share an identifier."""
    for pdo in device.pdos(receive=False):
        entry = device.entry(pdo.communication, 1)
        if pdo != kept and entry is not None and entry.writable and not device.number(pdo.communication, 1) & INVALID:
            device.try_number(pdo.communication, 1, device.number(pdo.communication, 1) | INVALID)
