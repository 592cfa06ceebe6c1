"""Defects of a node that show as frames that are changed, dropped or answered wrongly."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator

from mutant_machine import Frame, MutantMachine

from virtual_bus.canopen import abort
from virtual_bus.canopen.sdo_block import crc16

Variants = Iterator[tuple[str, Callable[[MutantMachine], None]]]
GENERAL_ERROR = 0x08000000
NMT, LSS_ANSWER, LSS_REQUEST = 0x000, 0x7E4, 0x7E5


def _answers(change: Callable[[MutantMachine, bytes], bytes | None]) -> Callable[[MutantMachine], None]:
    """Change (or, with None, drop) what the SDO server sends."""

    def apply(machine: MutantMachine) -> None:
        def outgoing(can_id: int, data: bytes) -> list[Frame]:
            if can_id != 0x580 + machine.node.node_id:
                return [(can_id, data)]
            changed = change(machine, data)
            return [] if changed is None else [(can_id, changed)]

        machine.outgoing.append(outgoing)

    return apply


def _incoming(
    wanted: Callable[[MutantMachine], int], change: Callable[[MutantMachine, bytes], bytes | None]
) -> Callable[[MutantMachine], None]:
    """Change what comes in with one identifier."""

    def apply(machine: MutantMachine) -> None:
        def incoming(can_id: int, data: bytes) -> list[Frame]:
            if can_id != wanted(machine):
                return [(can_id, data)]
            changed = change(machine, data)
            return [] if changed is None else [(can_id, changed)]

        machine.incoming.append(incoming)

    return apply


def wrong_abort_code() -> Variants:
    pairs = {
        "no object as general error": (abort.NO_OBJECT, GENERAL_ERROR),
        "no subindex as no object": (abort.NO_SUBINDEX, abort.NO_OBJECT),
        "read only as general error": (abort.READ_ONLY, GENERAL_ERROR),
        "write only as no data": (abort.WRITE_ONLY, abort.NO_DATA),
        "too long as invalid value": (abort.TOO_LONG, abort.INVALID_VALUE),
        "toggle as general error": (abort.TOGGLE_BIT, GENERAL_ERROR),
        "too high as too low": (abort.VALUE_TOO_HIGH, abort.VALUE_TOO_LOW),
        "checksum as general error": (abort.CRC_ERROR, GENERAL_ERROR),
        "not mappable as general error": (abort.NOT_MAPPABLE, GENERAL_ERROR),
        "PDO length as general error": (abort.PDO_LENGTH, GENERAL_ERROR),
    }
    for name, (right, wrong) in pairs.items():

        def change(machine: MutantMachine, data: bytes, right: int = right, wrong: int = wrong) -> bytes:
            refused = data[0] == 0x80 and int.from_bytes(data[4:], "little") == right
            return data[:4] + wrong.to_bytes(4, "little") if refused else data

        yield name, _answers(change)


def toggle_not_checked() -> Variants:
    for name, command in (("upload", 3), ("download", 0)):

        def apply(machine: MutantMachine, command: int = command) -> None:
            toggle, running = 0, False

            def outgoing(can_id: int, data: bytes) -> list[Frame]:
                nonlocal toggle, running
                if can_id == 0x580 + machine.node.node_id and data[0] in (0x41, 0x60, 0x80):
                    toggle, running = 0, data[0] != 0x80
                return [(can_id, data)]

            def incoming(can_id: int, data: bytes) -> list[Frame]:
                nonlocal toggle
                if running and can_id == 0x600 + machine.node.node_id and data[0] >> 5 == command:
                    data = bytes((data[0] & 0xEF | toggle,)) + data[1:]
                    toggle ^= 0x10
                return [(can_id, data)]

            machine.outgoing.append(outgoing)
            machine.incoming.append(incoming)

        yield name, apply


def toggle_stuck() -> Variants:
    def upload(machine: MutantMachine, data: bytes) -> bytes:
        return bytes((data[0] & 0xEF,)) + data[1:] if data[0] >> 5 == 0 and not _in_block(machine) else data

    def download(machine: MutantMachine, data: bytes) -> bytes:
        return bytes((0x20,)) + data[1:] if data[0] == 0x30 else data

    yield "upload", _answers(upload)
    yield "download", _answers(download)


def _in_block(machine: MutantMachine) -> bool:
    return type(machine.node._sdo._transfer).__name__.startswith("Block")


def boot_up_missing() -> Variants:
    for name, command in (("after reset node", 0x81), ("after reset communication", 0x82)):

        def apply(machine: MutantMachine, command: int = command) -> None:
            last = [0]

            def incoming(can_id: int, data: bytes) -> list[Frame]:
                if can_id == NMT and len(data) == 2 and data[1] in (0, machine.node.node_id):
                    last[0] = data[0]
                return [(can_id, data)]

            def outgoing(can_id: int, data: bytes) -> list[Frame]:
                silent = can_id == 0x700 + machine.node.node_id and data == b"\0" and last[0] == command
                return [] if silent else [(can_id, data)]

            machine.incoming.append(incoming)
            machine.outgoing.append(outgoing)

        yield name, apply


def byte_order() -> Variants:
    def expedited(size: int) -> Callable[[MutantMachine, bytes], bytes]:
        def change(machine: MutantMachine, data: bytes) -> bytes:
            return data[:4] + data[4 : 4 + size][::-1] + data[4 + size :] if data[0] == 0x43 | (4 - size) << 2 else data

        return change

    def size(machine: MutantMachine, data: bytes) -> bytes:
        return data[:4] + data[:3:-1] if data[0] == 0x41 else data

    def process_data(machine: MutantMachine) -> None:
        def outgoing(can_id: int, data: bytes) -> list[Frame]:
            mine = {tpdo.cob_id for tpdo in machine.node._tpdos}
            return [(can_id, data[::-1] if can_id in mine and can_id >> 7 in (3, 5, 7, 9) else data)]

        machine.outgoing.append(outgoing)

    def multiplexer(machine: MutantMachine, data: bytes) -> bytes:
        return data[:4] + data[:3:-1] if data[0] == 0x80 else data

    yield "two bytes", _answers(expedited(2))
    yield "four bytes", _answers(expedited(4))
    yield "size of a segmented upload", _answers(size)
    yield "process data", process_data
    yield "abort code", _answers(multiplexer)


def segmented_size() -> Variants:
    def told(size: Callable[[int], int]) -> Callable[[MutantMachine, bytes], bytes]:
        def change(machine: MutantMachine, data: bytes) -> bytes:
            return data[:4] + struct.pack("<I", size(int.from_bytes(data[4:], "little"))) if data[0] == 0x41 else data

        return change

    yield "zero", _answers(told(lambda size: 0))
    yield "one too many", _answers(told(lambda size: size + 1))


def segmented_data_cut() -> Variants:
    def last_early(machine: MutantMachine, data: bytes) -> bytes:
        return bytes((data[0] | 1,)) + data[1:] if data[0] >> 5 == 0 and not _in_block(machine) else data

    def last_never(machine: MutantMachine, data: bytes) -> bytes:
        return bytes((data[0] & 0xFE,)) + data[1:] if data[0] >> 5 == 0 and not _in_block(machine) else data

    def unused(machine: MutantMachine, data: bytes) -> bytes:
        return bytes((data[0] & 0xF1,)) + data[1:] if data[0] >> 5 == 0 and data[0] & 1 and not _in_block(machine) else data

    yield "last segment told too early", _answers(last_early)
    yield "last segment never told", _answers(last_never)
    yield "unused bytes not told", _answers(unused)


def _is_block_end(data: bytes) -> bool:
    return data[0] & 0xE3 == 0xC1


def block_checksum() -> Variants:
    def of_upload(change: Callable[[int], int]) -> Callable[[MutantMachine, bytes], bytes]:
        def changed(machine: MutantMachine, data: bytes) -> bytes:
            ends = _is_block_end(data) and getattr(machine.node._sdo._transfer, "_ending", False)
            return data[:1] + struct.pack("<H", change(int.from_bytes(data[1:3], "little"))) + data[3:] if ends else data

        return changed

    def unchecked(machine: MutantMachine, data: bytes) -> bytes:
        transfer = machine.node._sdo._transfer
        if type(transfer).__name__ == "BlockDownload" and transfer._ending and data[0] >> 5 == 6:  # type: ignore[union-attr]
            content = bytes(transfer._data)  # type: ignore[union-attr]
            content = content[: len(content) - (data[0] >> 2 & 7)]
            return data[:1] + struct.pack("<H", crc16(content)) + data[3:]
        return data

    yield "upload, bits inverted", _answers(of_upload(lambda crc: crc ^ 0xFFFF))
    yield "upload, high byte first", _answers(of_upload(lambda crc: (crc & 0xFF) << 8 | crc >> 8))
    yield "upload, always zero", _answers(of_upload(lambda crc: 0))
    yield "download not checked", _incoming(lambda machine: 0x600 + machine.node.node_id, unchecked)


def block_sequence() -> Variants:
    def from_zero(machine: MutantMachine, data: bytes) -> bytes:
        transfer = machine.node._sdo._transfer
        segment = type(transfer).__name__ == "BlockUpload" and not transfer._ending and data[0] != 0xC6  # type: ignore[union-attr]
        return bytes((data[0] & 0x80 | (data[0] & 0x7F) - 1,)) + data[1:] if segment else data

    def acknowledged(machine: MutantMachine, data: bytes) -> bytes:
        return data[:1] + bytes((data[1] + 1,)) + data[2:] if data[0] == 0xA2 else data

    yield "upload counts from zero", _answers(from_zero)
    yield "download acknowledges one too many", _answers(acknowledged)


def broadcast_ignored() -> Variants:
    def ignore(commands: tuple[int, ...]) -> Callable[[MutantMachine, bytes], bytes | None]:
        return lambda machine, data: None if len(data) == 2 and data[1] == 0 and data[0] in commands else data

    yield "every command", _incoming(lambda machine: NMT, ignore((1, 2, 0x80, 0x81, 0x82)))
    yield "start and stop", _incoming(lambda machine: NMT, ignore((1, 2)))


def foreign_nmt_obeyed() -> Variants:
    def obey(machine: MutantMachine, data: bytes) -> bytes:
        return data[:1] + bytes((machine.node.node_id,)) if len(data) == 2 else data

    yield "every command", _incoming(lambda machine: NMT, obey)


def nmt_command_ignored() -> Variants:
    for name, command in (("stop", 2), ("enter pre-operational", 0x80), ("reset communication", 0x82)):
        yield name, _incoming(lambda machine: NMT, lambda machine, data, command=command: None if data[:1] == bytes((command,)) else data)  # type: ignore[misc]


def length_not_checked() -> Variants:
    def fit(machine: MutantMachine, data: bytes, *, longer: bool) -> bytes:
        """An expedited download whose length is wrong is made to fit."""
        if data[0] & 0xE3 != 0x23:
            return data
        entry = machine.node.objects.get(int.from_bytes(data[1:3], "little"), data[3])
        length = 4 - (data[0] >> 2 & 3)
        size = (entry.bits + 7) // 8 if entry is not None else 0
        if not 1 <= size <= 4 or size == length or (length > size) != longer:
            return data
        return bytes((0x23 | (4 - size) << 2,)) + data[1 : 4 + min(size, length)].ljust(7, b"\0")

    request = lambda machine: 0x600 + machine.node.node_id  # noqa: E731
    yield "too long", _incoming(request, lambda machine, data: fit(machine, data, longer=True))
    yield "too short", _incoming(request, lambda machine, data: fit(machine, data, longer=False))


def absent_read_as_zero() -> Variants:
    for name, code in (("object", abort.NO_OBJECT), ("subindex", abort.NO_SUBINDEX)):

        def change(machine: MutantMachine, data: bytes, code: int = code) -> bytes:
            refused = data[0] == 0x80 and int.from_bytes(data[4:], "little") == code
            return bytes((0x43,)) + data[1:4] + bytes(4) if refused else data

        yield name, _answers(change)


def abort_answered() -> Variants:
    def apply(machine: MutantMachine) -> None:
        def incoming(can_id: int, data: bytes) -> list[Frame]:
            if can_id == 0x600 + machine.node.node_id and data[:1] == b"\x80" and machine.node.may_tell:
                machine.say(0x580 + machine.node.node_id, b"\x80" + data[1:4] + struct.pack("<I", abort.UNKNOWN_COMMAND))
            return [(can_id, data)]

        machine.incoming.append(incoming)

    yield "with an abort", apply


def unknown_command_silent() -> Variants:
    def silent(machine: MutantMachine, data: bytes) -> bytes | None:
        return None if data[0] == 0x80 and int.from_bytes(data[4:], "little") == abort.UNKNOWN_COMMAND else data

    yield "every command", _answers(silent)


def wrong_multiplexer() -> Variants:
    def of(commands: Callable[[int], bool], change: Callable[[bytes], bytes]) -> Callable[[MutantMachine, bytes], bytes]:
        return lambda machine, data: data[:1] + change(data[1:4]) + data[4:] if commands(data[0]) and not _in_block(machine) else data

    yield "of an abort, zero", _answers(of(lambda head: head == 0x80, lambda old: bytes(3)))
    yield "of a download, subindex zero", _answers(of(lambda head: head == 0x60, lambda old: old[:2] + b"\0"))
    yield "of an upload, high byte first", _answers(of(lambda head: head & 0xF3 == 0x43, lambda old: old[1::-1] + old[2:]))


def state_told_wrong() -> Variants:
    for name, right, wrong in (("pre-operational as operational", 0x7F, 0x05), ("stopped as 02h", 0x04, 0x02)):

        def apply(machine: MutantMachine, right: int = right, wrong: int = wrong) -> None:
            def outgoing(can_id: int, data: bytes) -> list[Frame]:
                told = can_id == 0x700 + machine.node.node_id and data[0] & 0x7F == right
                return [(can_id, bytes((data[0] & 0x80 | wrong,)) if told else data)]

            machine.outgoing.append(outgoing)

        yield name, apply


def guarding_toggle_stuck() -> Variants:
    for name, bit in (("at 0", 0x00), ("at 1", 0x80)):

        def apply(machine: MutantMachine, bit: int = bit) -> None:
            def outgoing(can_id: int, data: bytes) -> list[Frame]:
                answer = machine.guarded and can_id == 0x700 + machine.node.node_id
                return [(can_id, bytes((data[0] & 0x7F | bit,)) if answer else data)]

            machine.outgoing.append(outgoing)

        yield name, apply


def emergency_wrong() -> Variants:
    def changed(change: Callable[[bytes], bytes | None]) -> Callable[[MutantMachine], None]:
        def apply(machine: MutantMachine) -> None:
            def outgoing(can_id: int, data: bytes) -> list[Frame]:
                target = machine.node.objects.number(0x1014) & 0x7FF
                told = change(data) if can_id == target and len(data) == 8 else data
                return [] if told is None else [(can_id, told)]

            machine.outgoing.append(outgoing)

        return apply

    yield "never sent", changed(lambda data: None)
    yield "register left zero", changed(lambda data: data[:2] + b"\0" + data[3:])
    yield "no error reset", changed(lambda data: None if data[:2] == b"\0\0" else data)
    yield "code high byte first", changed(lambda data: data[1::-1] + data[2:])


def lss_wrong() -> Variants:
    def outgoing(change: Callable[[bytes], bytes | None]) -> Callable[[MutantMachine], None]:
        def apply(machine: MutantMachine) -> None:
            def filtered(can_id: int, data: bytes) -> list[Frame]:
                told = change(data) if can_id == LSS_ANSWER else data
                return [] if told is None else [(can_id, told)]

            machine.outgoing.append(filtered)

        return apply

    def any_serial(machine: MutantMachine, data: bytes) -> bytes:
        return data[:1] + struct.pack("<I", machine.node.objects.number(0x1018, 4)) + data[5:] if data[0] == 0x43 else data

    def accept_node(data: bytes) -> bytes:
        return data[:1] + bytes(7) if data[0] == 0x11 else data

    def swapped(data: bytes) -> bytes:
        return data[:1] + data[4:0:-1] + data[5:] if 0x5A <= data[0] <= 0x5D else data

    yield "identity high byte first", outgoing(swapped)
    yield "any serial number switches", _incoming(lambda machine: LSS_REQUEST, any_serial)
    yield "every node id taken", outgoing(accept_node)
    yield "global switch ignored", _incoming(lambda machine: LSS_REQUEST, lambda machine, data: None if data[0] == 0x04 else data)
    yield "silent", outgoing(lambda data: None)


def short_rpdo_taken() -> Variants:
    def apply(machine: MutantMachine, *, longer: bool) -> None:
        def incoming(can_id: int, data: bytes) -> list[Frame]:
            for rpdo in machine.node._rpdos:
                wrong = len(data) - rpdo._layout.length
                if rpdo.alive and rpdo.cob_id == can_id and longer and wrong > 0:
                    return []
                if rpdo.alive and rpdo.cob_id == can_id and not longer and wrong < 0:
                    data = data.ljust(rpdo._layout.length, b"\0")
            return [(can_id, data)]

        machine.incoming.append(incoming)

    yield "short", lambda machine: apply(machine, longer=False)
    yield "long, dropped", lambda machine: apply(machine, longer=True)
