"""Process data objects: their content, and when they are sent and taken (CiA 301, 7.2.2)."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable

from canopen.objectdictionary import ODVariable

from virtual_bus.canopen.clock import ROUNDING_S
from virtual_bus.canopen.objects import Entry, Objects, Value
from virtual_bus.canopen.port import Port

MAX_SYNCHRONOUS = 240  # transmission types up to this one follow the SYNC
EVENT_DRIVEN = (254, 255)
_SIZE_ERROR, _EXCESS_ERROR, _RPDO_TIMEOUT = 0x8210, 0x8220, 0x8250  # EMCY codes


class Layout:
    """Packing of the mapped entries: with one struct where all are whole bytes, bit by bit otherwise."""

    def __init__(self, entries: list[Entry]) -> None:
        self.entries = entries
        bits = sum(entry.bits for entry in entries)
        self.length = (bits + 7) // 8
        characters = [entry.character for entry in entries]
        form = struct.Struct("<" + "".join(characters)) if all(characters) else None
        self.pack: Callable[[], bytes] = self._pack_bits if form is None else _packer(form, entries)
        """Returns the present values as they go into the frame."""
        self.unpack: Callable[[bytes], tuple[Value, ...]] = self._unpack_bits if form is None else form.unpack_from
        """Returns one value per entry."""

    def _pack_bits(self) -> bytes:
        frame = shift = 0
        for entry in self.entries:
            frame |= (int.from_bytes(entry.encode(entry.value), "little") & ((1 << entry.bits) - 1)) << shift
            shift += entry.bits
        return frame.to_bytes(self.length, "little")

    def _unpack_bits(self, data: bytes) -> tuple[Value, ...]:
        frame = int.from_bytes(data[: self.length], "little")
        values: list[Value] = []
        for entry in self.entries:
            raw = frame & ((1 << entry.bits) - 1)
            frame >>= entry.bits
            values.append(entry.decode(raw.to_bytes((entry.bits + 7) // 8, "little")))
        return tuple(values)


def _packer(form: struct.Struct, entries: list[Entry]) -> Callable[[], bytes]:
    """Return a function that packs the entries' values; the usual numbers of entries without a loop, in a third of its time."""
    pack = form.pack
    match entries:
        case [a]:
            return lambda: pack(a.value)
        case [a, b]:
            return lambda: pack(a.value, b.value)
        case [a, b, c]:
            return lambda: pack(a.value, b.value, c.value)
    return lambda: pack(*[entry.value for entry in entries])


def mapped_entries(objects: Objects, mapping_index: int) -> list[Entry]:
    """Return the entries a mapping object names; dummy types become entries nobody reads."""
    entries = []
    for subindex in range(1, objects.number(mapping_index) + 1):
        index, mapped_subindex, _ = split_mapping(objects.number(mapping_index, subindex))
        entry = objects.get(index, mapped_subindex)
        if entry is None and index < 0x20:
            entry = dummy_entry(index)
        if entry is not None:
            entries.append(entry)
    return entries


def split_mapping(value: int) -> tuple[int, int, int]:
    """Return (index, subindex, bits) of a mapping entry."""
    return value >> 16, value >> 8 & 0xFF, value & 0xFF


def dummy_entry(data_type: int) -> Entry:
    """Return an entry that fills a gap of one basic type in an RPDO."""
    variable = ODVariable(f"Dummy{data_type:04d}", data_type, 0)
    variable.data_type = data_type
    return Entry(variable)


class Rpdo:
    """A receive PDO: applied at the next SYNC, or at once for transmission types 254 and 255."""

    def __init__(self, node: Port, number: int) -> None:
        self._node = node
        self.communication, self.mapping = 0x1400 + number, 0x1600 + number
        self.cob_id = 0
        self.alive = self.synchronous = self._windowed = False
        self._pending: bytes | None = None
        self._timeout_s = 0.0
        self._length_error = 0  # EMCY code of the last frame's length, 0: it was right
        self.deadline_s = math.inf
        self._layout = Layout([])
        self._taken: list[tuple[int, Entry, Callable[[Value], None] | None]] = []  # each entry with its number and its effect

    def forget(self) -> None:
        """Forget what was wrong with the last frame: the communication is reset."""
        self._length_error = 0

    def configure(self, operational: bool) -> None:
        """Take over the dictionary's present settings."""
        objects = self._node.objects
        cob_id = objects.number(self.communication, 1)
        self.cob_id = cob_id & 0x7FF
        self._layout = Layout(mapped_entries(objects, self.mapping))
        self.alive = operational and not cob_id >> 31 and bool(self._layout.entries)
        self.synchronous = objects.number(self.communication, 2) <= MAX_SYNCHRONOUS
        self._windowed = self.synchronous and objects.number(0x1007) > 0
        self._timeout_s = objects.number(self.communication, 5) * 1e-3
        self._taken = [(number, entry, objects.effects.get(entry.key)) for number, entry in enumerate(self._layout.entries)]
        self._pending = None
        self.deadline_s = math.inf

    def receive(self, data: bytes) -> None:
        """Take a frame with this PDO's identifier."""
        if self._windowed and self._node.clock.now_s > self._node.window_closes_s:
            return  # too late for the next SYNC (1007h), and as if it had not come
        length = len(data)
        if length != self._layout.length or self._length_error:
            self._judge_length(length)
            if length < self._layout.length:
                return
        if self._timeout_s:
            node = self._node
            self.deadline_s = deadline_s = node.clock.now_s + self._timeout_s - ROUNDING_S  # `Node.after` written out: every RPDO
            if deadline_s < node.deadline_s:
                node.schedule(deadline_s)
            node.emergency.clear_error(_RPDO_TIMEOUT)
        self._pending = data
        if not self.synchronous:
            self.on_sync()

    def _judge_length(self, length: int) -> None:
        """Report a frame of the wrong length, and the first good one after it."""
        wanted = self._layout.length
        error = _SIZE_ERROR if length < wanted else _EXCESS_ERROR if length > wanted else 0
        if self._length_error and self._length_error != error:
            self._node.emergency.clear_error(self._length_error)
        if error:
            self._node.emergency.raise_error(error)
        self._length_error = error

    def on_sync(self) -> None:
        """Apply what has come and was not applied yet, if anything."""
        if (data := self._pending) is None:
            return
        values = self._layout.unpack(data)
        for number, entry, effect in self._taken:
            entry.value = value = values[number]
            if effect is not None:
                effect(value)
        self._pending = None

    def pending(self, entry: Entry) -> Value | None:
        """Return what the next SYNC will put into this entry; None: nothing."""
        if self._pending is None or entry not in self._layout.entries:
            return None
        return self._layout.unpack(self._pending)[self._layout.entries.index(entry)]

    def expire(self, now_s: float) -> None:
        """Report the PDO as missing when its event timer has run out."""
        if now_s >= self.deadline_s:
            self.deadline_s = math.inf
            self._node.emergency.raise_error(_RPDO_TIMEOUT)
            self._node.commands_lost()


class Tpdo:
    """A transmit PDO.

    It is sent on every n-th SYNC, at the next SYNC after an event (type 0), or on events (254, 255) within inhibit and event time.
    """

    def __init__(self, node: Port, number: int) -> None:
        self._node = node
        self.communication, self.mapping = 0x1800 + number, 0x1A00 + number
        self.cob_id = 0
        self.alive = self.synchronous = False
        self._type = 0
        self._start = 0  # SYNC counter value of the first transmission
        self._counted = 0
        self._inhibit_s = self._event_s = 0.0
        self._not_before_s = -math.inf
        self._next_event_s = math.inf
        self._last: bytes | None = None  # what was sent last: a difference is an event
        self.deadline_s = math.inf
        self._layout = Layout([])

    def configure(self, operational: bool) -> None:
        """Take over the dictionary's present settings."""
        objects = self._node.objects
        cob_id = objects.number(self.communication, 1)
        was_alive = self.alive
        self.cob_id = cob_id & 0x7FF
        self._layout = Layout(mapped_entries(objects, self.mapping))
        self.alive = operational and not cob_id >> 31 and bool(self._layout.entries)
        self._type = objects.number(self.communication, 2)
        self.synchronous = self._type <= MAX_SYNCHRONOUS
        self._inhibit_s = objects.number(self.communication, 3) * 1e-4
        self._event_s = objects.number(self.communication, 5) * 1e-3
        self._start = objects.number(self.communication, 6) if objects.number(0x1019) else 0
        if not (was_alive and self.alive):
            self._counted, self._last, self._not_before_s = 0, None, -math.inf
        timed = self.alive and self._event_s and not self.synchronous
        self._next_event_s = self._node.after(self._event_s) if timed else math.inf
        self._set_deadline()

    @property
    def sender(self) -> Callable[[int | None], None]:
        """What a SYNC comes to, as this PDO is configured: it takes the SYNC's counter, with the latched values in the dictionary."""
        if self._type != 1 or self._start:
            return self._send_in_turn
        node, cob_id, pack = self._node, self.cob_id, self._layout.pack
        return lambda counter: node.emit(cob_id, pack())

    def _send_in_turn(self, counter: int | None) -> None:
        if self._type == 0:
            data = self._layout.pack()
            if data != self._last:
                self._send(data)
            return
        if self._start and not self._counted and counter != self._start:
            return
        if self._counted % self._type == 0 if self._start else (self._counted + 1) % self._type == 0:
            self._send(self._layout.pack())
        self._counted += 1

    def rehearse(self) -> None:
        """Pack what is in the dictionary without sending it."""
        self._layout.pack()

    def check_event(self) -> None:
        """Send when a mapped value has changed since the last transmission and the inhibit time allows."""
        data = self._layout.pack()
        if data == self._last:
            return
        if self._node.clock.now_s >= self._not_before_s:
            self._send(data)
        else:
            self._set_deadline()
            self.deadline_s = min(self.deadline_s, self._not_before_s)
            self._node.schedule(self.deadline_s)

    def expire(self, now_s: float) -> None:
        """Send when the inhibit time is over with an event pending, or the event timer has run out."""
        if not self.alive or self.synchronous:
            self.deadline_s = math.inf
        elif now_s >= self._next_event_s:
            self._send(self._layout.pack())
        elif now_s >= self.deadline_s:
            self._set_deadline()
            self.check_event()

    def _send(self, data: bytes) -> None:
        self._last = data
        self._not_before_s = self._node.after(self._inhibit_s)
        if self._event_s and not self.synchronous:
            self._next_event_s = self._node.after(max(self._event_s, self._inhibit_s))
        self._set_deadline()
        self._node.emit(self.cob_id, data)

    def _set_deadline(self) -> None:
        self.deadline_s = self._next_event_s
        if self.deadline_s < math.inf:
            self._node.schedule(self.deadline_s)
