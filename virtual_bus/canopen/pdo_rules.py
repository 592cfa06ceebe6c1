"""The CiA 301 procedure for changing a PDO: off, count to zero, entries, count, on. Other orders are refused."""

from __future__ import annotations

from collections.abc import Callable

from virtual_bus.canopen import abort, cob_id
from virtual_bus.canopen.abort import SdoAbortError
from virtual_bus.canopen.objects import Entry, Objects, Value, key_of
from virtual_bus.canopen.pdo import EVENT_DRIVEN, MAX_SYNCHRONOUS, dummy_entry, split_mapping

MAX_PDO_BITS = 64
_BASIC_DUMMY_TYPES = range(0x01, 0x08)


def install(objects: Objects, communication: int, mapping: int, *, receive: bool, changed: Callable[[], None]) -> None:
    """Add the rules of one PDO to the dictionary; `changed` runs after every accepted write."""

    def exists() -> bool:
        return not objects.number(communication, 1) & cob_id.INVALID

    def check_cob_id(value: Value) -> None:
        if not receive and objects.default(communication, 1) & cob_id.NO_RTR and not int(value) & cob_id.NO_RTR:
            raise SdoAbortError(abort.INVALID_VALUE)  # RTR cannot be allowed where the device has none
        cob_id.check_change(objects.number(communication, 1), int(value), exists=exists())

    def check_transmission_type(value: Value) -> None:
        if MAX_SYNCHRONOUS < int(value) < EVENT_DRIVEN[0]:
            raise SdoAbortError(abort.INVALID_VALUE)  # 241 to 251 are reserved, 252 and 253 need RTR, which is not supported

    def check_while_off(value: Value) -> None:
        if exists():
            raise SdoAbortError(abort.INVALID_VALUE)

    def check_count(value: Value) -> None:
        if exists():
            raise SdoAbortError(abort.UNSUPPORTED_ACCESS)
        check_mapping(objects, mapping, int(value), receive=receive)

    def check_entry(value: Value) -> None:
        if exists() or objects.number(mapping):
            raise SdoAbortError(abort.UNSUPPORTED_ACCESS)
        if value:
            mappable_entry(objects, int(value), receive=receive)

    checks = {key_of(communication, 1): check_cob_id, key_of(communication, 2): check_transmission_type, key_of(mapping): check_count}
    if not receive:
        checks |= {key_of(communication, 3): check_while_off, key_of(communication, 6): check_while_off}
    for entry in objects:
        if entry.index == mapping and entry.subindex:
            checks[entry.key] = check_entry
    objects.checks |= checks
    for entry in objects:
        if entry.index in (communication, mapping):
            objects.effects[entry.key] = lambda value: changed()


def check_mapping(objects: Objects, mapping: int, count: int, *, receive: bool) -> None:
    """Refuse a count of entries that makes no PDO.

    Raises
    ------
    SdoAbortError
        The first `count` entries make no PDO.
    """
    if count and objects.get(mapping, count) is None:
        raise SdoAbortError(abort.PDO_LENGTH)
    bits = 0
    for subindex in range(1, count + 1):
        bits += mappable_entry(objects, objects.number(mapping, subindex), receive=receive).bits
    if bits > MAX_PDO_BITS:
        raise SdoAbortError(abort.PDO_LENGTH)


def mappable_entry(objects: Objects, value: int, *, receive: bool) -> Entry:
    """Return the entry that a mapping value names.

    Raises
    ------
    SdoAbortError
        There is no such object, it is too long, or it cannot be mapped in this direction.
    """
    index, subindex, bits = split_mapping(value)
    if bits > MAX_PDO_BITS:
        raise SdoAbortError(abort.PDO_LENGTH)
    if index in _BASIC_DUMMY_TYPES and subindex == 0:
        entry, allowed = dummy_entry(index), receive
    else:
        found = objects.get(index, subindex)
        if found is None:
            raise SdoAbortError(abort.NO_OBJECT)
        entry, allowed = found, found.mappable_in_rpdo if receive else found.mappable_in_tpdo
    if not allowed or not entry.bits or bits != entry.bits:
        raise SdoAbortError(abort.NOT_MAPPABLE)
    return entry
