"""Defects of a node that lie in its object dictionary: checks that are missing, settings that have no or the wrong effect."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial

from mutant_machine import MutantMachine

from virtual_bus.canopen import abort, cob_id
from virtual_bus.canopen.abort import SdoAbortError
from virtual_bus.canopen.nmt import NmtState
from virtual_bus.canopen.objects import Value, key_of
from virtual_bus.canopen.pdo import Tpdo
from virtual_bus.canopen.pdo_rules import MAX_PDO_BITS

Variants = Iterator[tuple[str, Callable[[MutantMachine], None]]]
_COB_IDS = {"RPDO": (0x1400, 1), "TPDO": (0x1800, 1), "EMCY": (0x1014, 0), "SYNC": (0x1005, 0), "TIME": (0x1012, 0)}


def _leave_check_out(machine: MutantMachine, place: tuple[int, int], unless: Callable[[int], bool]) -> None:
    """Take a value without its check, unless it is one that is still looked at."""
    key = key_of(*place)
    check = machine.node.objects.checks.get(key)

    def looked_at(value: Value) -> None:
        if check is not None and unless(int(value)):
            check(value)

    machine.node.objects.checks[key] = looked_at


def cob_id_taken_while_valid() -> Variants:
    for name in ("RPDO", "TPDO", "EMCY"):
        strict = lambda value: cob_id.is_restricted(value & cob_id.CAN_ID) or bool(value & cob_id.EXTENDED)  # noqa: E731
        yield name, partial(_leave_check_out, place=_COB_IDS[name], unless=strict)


def restricted_cob_id_taken() -> Variants:
    for name, place in _COB_IDS.items():
        lax = lambda value: not cob_id.is_restricted(value & cob_id.CAN_ID)  # noqa: E731
        yield name, partial(_leave_check_out, place=place, unless=lax)


def heartbeat_factor() -> Variants:
    for factor in (10.0, 0.1, 2.0, 1.25, 0.0):

        def apply(machine: MutantMachine, factor: float = factor) -> None:
            producer = machine.node._producer
            period = property(lambda self: self._node.objects.number(0x1017) * 1e-3 * factor)
            producer.__class__ = type("Scaled", (type(producer),), {"_period_s": period})

        yield f"{factor:g}", apply


def pdo_in_pre_operational() -> Variants:
    for name, parts in (("sent", "_tpdos"), ("taken", "_rpdos")):

        def apply(machine: MutantMachine, parts: str = parts) -> None:
            for pdo in getattr(machine.node, parts):

                def configure(operational: bool, configure: Callable[[bool], None] = pdo.configure) -> None:
                    configure(operational or machine.node.state is NmtState.PRE_OPERATIONAL)

                pdo.configure = configure

        yield name, apply


def sdo_in_stopped() -> Variants:
    def apply(machine: MutantMachine) -> None:
        node = machine.node

        def listen() -> None:
            node.routes[0x600 + node.node_id] = node._on_sdo

        node.on_routes = listen

    yield "answered", apply


def transmission_type_ignored() -> Variants:
    def replaced(wrong: Callable[[int], int]) -> Callable[[MutantMachine], None]:
        def apply(machine: MutantMachine) -> None:
            for tpdo in machine.node._tpdos:

                def configure(operational: bool, tpdo: Tpdo = tpdo, configure: Callable[[bool], None] = tpdo.configure) -> None:
                    entry = machine.node.objects.find(tpdo.communication, 2)
                    right, entry.value = int(entry.value), wrong(int(entry.value))
                    configure(operational)
                    entry.value = right

                tpdo.configure = configure  # type: ignore[method-assign]

        return apply

    def at_once(machine: MutantMachine) -> None:
        for rpdo in machine.node._rpdos:

            def configure(operational: bool, rpdo: object = rpdo, configure: Callable[[bool], None] = rpdo.configure) -> None:
                configure(operational)
                rpdo.synchronous = False  # type: ignore[attr-defined]

            rpdo.configure = configure  # type: ignore[method-assign]

    yield "every SYNC", replaced(lambda kind: 1 if 1 < kind <= 240 else kind)
    yield "0 as 1", replaced(lambda kind: kind or 1)
    yield "254 as 1", replaced(lambda kind: 1 if kind >= 254 else kind)
    yield "n as n + 1", replaced(lambda kind: kind + 1 if 1 < kind < 240 else kind)
    yield "RPDO at once", at_once


def wrong_mapping_taken() -> Variants:
    def lax(allowed: frozenset[int]) -> Callable[[MutantMachine], None]:
        """Take a mapping that is refused with one of these codes."""

        def apply(machine: MutantMachine) -> None:
            objects = machine.node.objects
            for key, check in list(objects.checks.items()):
                if 0x1600 <= key >> 8 < 0x1C00 and not 0x1800 <= key >> 8 < 0x1A00:

                    def looked_at(value: Value, check: Callable[[Value], None] = check) -> None:
                        try:
                            check(value)
                        except SdoAbortError as refusal:
                            if refusal.code not in allowed:
                                raise

                    objects.checks[key] = looked_at

        return apply

    yield "wrong length or not mappable", lax(frozenset({abort.NOT_MAPPABLE}))
    yield f"more than {MAX_PDO_BITS} bits", lax(frozenset({abort.PDO_LENGTH}))
    yield "absent object", lax(frozenset({abort.NO_OBJECT, abort.NO_SUBINDEX}))
    yield "while the PDO is on", lax(frozenset({abort.UNSUPPORTED_ACCESS}))


def read_only_written() -> Variants:
    for name, indices in (
        ("everything", range(0x1000, 0x10000)),
        ("identity", range(0x1018, 0x1019)),
        ("application", range(0x2000, 0xA000)),
    ):

        def apply(machine: MutantMachine, indices: range = indices) -> None:
            for entry in machine.node.objects:
                entry.writable = entry.writable or entry.index in indices

        yield name, apply


def range_not_checked() -> Variants:
    for name, attributes in (("high", ("high",)), ("low", ("low",)), ("both", ("high", "low"))):

        def apply(machine: MutantMachine, attributes: tuple[str, ...] = attributes) -> None:
            for entry in machine.node.objects:
                for attribute in attributes:
                    setattr(entry, attribute, None)

        yield name, apply


def _set(machine: MutantMachine, index: int, subindex: int, change: Callable[[int], int]) -> None:
    entry = machine.node.objects.find(index, subindex)
    entry.default = entry.value = change(int(entry.value))


def identity_count() -> Variants:
    yield "one too few", partial(_set, index=0x1018, subindex=0, change=lambda count: count - 1)
    yield "one too many", partial(_set, index=0x1018, subindex=0, change=lambda count: count + 1)


def value_differs() -> Variants:
    yield "product code", partial(_set, index=0x1018, subindex=2, change=lambda code: code ^ 0x100)
    yield "default of a parameter", partial(_set, index=0x2104, subindex=0, change=lambda value: value + 1)
    yield "constant", partial(_set, index=0x2113, subindex=0, change=lambda value: value + 1)


def _after_configure(machine: MutantMachine, change: Callable[[Tpdo], None]) -> None:
    for tpdo in machine.node._tpdos:

        def configure(operational: bool, tpdo: Tpdo = tpdo, configure: Callable[[bool], None] = tpdo.configure) -> None:
            configure(operational)
            change(tpdo)

        tpdo.configure = configure  # type: ignore[method-assign]


def sync_counter() -> Variants:
    def no_start(tpdo: Tpdo) -> None:
        tpdo._start = 0

    def lax(machine: MutantMachine) -> None:
        machine.node.objects.checks.pop(key_of(0x1019), None)

    yield "start value ignored", partial(_after_configure, change=no_start)
    yield "1019h takes every value", lax


def inhibit_time_ignored() -> Variants:
    def none(tpdo: Tpdo) -> None:
        tpdo._inhibit_s = 0.0

    def milliseconds(tpdo: Tpdo) -> None:
        tpdo._inhibit_s *= 10.0

    yield "no pause", partial(_after_configure, change=none)
    yield "in milliseconds", partial(_after_configure, change=milliseconds)
    yield "EMCY", lambda machine: machine.without_effect(0x1015)


def event_time() -> Variants:
    def apply(machine: MutantMachine, factor: float) -> None:
        for tpdo in machine.node._tpdos:

            def configure(operational: bool, tpdo: Tpdo = tpdo, configure: Callable[[bool], None] = tpdo.configure) -> None:
                entry = machine.node.objects.find(tpdo.communication, 5)
                right, entry.value = int(entry.value), round(int(entry.value) * factor)
                configure(operational)
                entry.value = right

            tpdo.configure = configure  # type: ignore[method-assign]

    yield "ignored", partial(apply, factor=0.0)
    yield "doubled", partial(apply, factor=2.0)


def rpdo_deadline_ignored() -> Variants:
    def apply(machine: MutantMachine) -> None:
        for rpdo in machine.node._rpdos:
            machine.without_effect(rpdo.communication, 5)

    yield "every RPDO", apply


def life_guarding_ignored() -> Variants:
    yield "life time factor", lambda machine: machine.without_effect(0x100D)


def heartbeat_consumer_ignored() -> Variants:
    def apply(machine: MutantMachine) -> None:
        for entry in [entry for entry in machine.node.objects if entry.index == 0x1016 and entry.subindex]:
            machine.without_effect(0x1016, entry.subindex)

    yield "every entry", apply


def error_behaviour_ignored() -> Variants:
    yield "always pre-operational", lambda machine: machine.without_effect(0x1029, 1)

    def lax(machine: MutantMachine) -> None:
        machine.node.objects.checks.pop(key_of(0x1029, 1), None)

    yield "every value taken", lax


def error_history() -> Variants:
    def not_cleared(machine: MutantMachine) -> None:
        entry = machine.node.objects.find(0x1003)

        def keep(value: Value) -> None:
            entry.value = sum(1 for e in machine.node.objects if e.index == 0x1003 and e.subindex and e.value)

        machine.node.objects.effects[key_of(0x1003)] = keep

    def lax(machine: MutantMachine) -> None:
        machine.node.objects.checks.pop(key_of(0x1003), None)

    yield "cleared by any value", lax
    yield "not cleared", not_cleared


def signature_not_checked() -> Variants:
    for index in (0x1010, 0x1011):

        def apply(machine: MutantMachine, index: int = index) -> None:
            for entry in [entry for entry in machine.node.objects if entry.index == index and entry.subindex]:
                machine.node.objects.checks.pop(entry.key, None)

        yield f"{index:X}h", apply


def reset_keeps_settings() -> Variants:
    def apply(machine: MutantMachine) -> None:
        memory = machine.node._memory
        reset = memory.reset

        def kept(indices: range) -> None:
            if indices.start != 0x1000 or indices.stop != 0x2000:
                reset(indices)

        memory.reset = kept  # type: ignore[method-assign]

    yield "all of 1000h to 1FFFh", apply
