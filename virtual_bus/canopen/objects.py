"""The object dictionary of a running device: values, types, access rights, and the effects of writing them."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator

import canopen
from canopen.objectdictionary import ODVariable, datatypes

from virtual_bus.canopen import abort
from virtual_bus.canopen.abort import SdoAbortError

Value = int | float | bytes

_INTEGER_BITS = {
    **dict(zip((2, 3, 0x10, 4, 0x12, 0x13, 0x14, 0x15), (8, 16, 24, 32, 40, 48, 56, 64), strict=True)),
    **dict(zip((5, 6, 0x16, 7, 0x18, 0x19, 0x1A, 0x1B), (8, 16, 24, 32, 40, 48, 56, 64), strict=True)),
}
_STRUCT_CHARACTERS = {2: "b", 3: "h", 4: "i", 0x15: "q", 5: "B", 6: "H", 7: "I", 0x1B: "Q", 8: "f", 0x11: "d"}
_MAX_STRING_BYTES = 65536  # of a string or domain written over SDO; a small device has no more memory


def key_of(index: int, subindex: int = 0) -> int:
    """Return an object's address as one number."""
    return index << 8 | subindex


class Entry:
    """One variable of the dictionary. `value` is an int, a float, or bytes for strings and domains."""

    __slots__ = (
        "bits",
        "character",
        "data_type",
        "default",
        "high",
        "index",
        "low",
        "mappable_in_rpdo",
        "mappable_in_tpdo",
        "readable",
        "signed",
        "subindex",
        "value",
        "writable",
    )

    def __init__(self, variable: ODVariable) -> None:
        self.index: int = variable.index
        self.subindex: int = variable.subindex
        self.data_type: int = variable.data_type or 0
        self.readable = variable.access_type != "wo"
        self.writable = "w" in variable.access_type
        self.mappable_in_rpdo = variable.pdo_mappable and variable.access_type in ("rw", "rww", "wo")
        self.mappable_in_tpdo = variable.pdo_mappable and variable.access_type in ("rw", "rwr", "ro", "const")
        self.signed = self.data_type in datatypes.SIGNED_TYPES
        self.character: str = _STRUCT_CHARACTERS.get(self.data_type, "")  # "" where struct has no such type
        self.bits = 1 if self.data_type == datatypes.BOOLEAN else _INTEGER_BITS.get(self.data_type, 0)  # 0: not of fixed length
        if self.data_type in datatypes.FLOAT_TYPES:
            self.bits = 32 if self.data_type == datatypes.REAL32 else 64
        self.low: int | None = variable.min if self.is_integer else None
        self.high: int | None = variable.max if self.is_integer else None
        configured = getattr(variable, "value", None)
        self.default: Value = self._initial(configured if configured is not None else variable.default)
        self.value: Value = self.default

    @property
    def is_integer(self) -> bool:
        """Whether the value is an integer or a boolean."""
        return self.data_type in _INTEGER_BITS or self.data_type == datatypes.BOOLEAN

    @property
    def key(self) -> int:
        """The address of the entry as one number."""
        return key_of(self.index, self.subindex)

    def _initial(self, given: object) -> Value:
        if self.is_integer:
            return int(given) if isinstance(given, int) else self._within_limits(0)
        if self.data_type in datatypes.FLOAT_TYPES:
            return float(given) if isinstance(given, int | float) else 0.0
        if isinstance(given, str):
            return given.encode("utf-16-le" if self.data_type == datatypes.UNICODE_STRING else "latin-1", errors="replace")
        return bytes(given) if isinstance(given, bytes | bytearray) else b""

    def _within_limits(self, value: int) -> int:
        """Return the value, or the limit next to it where the data sheet gives no default and does not allow the value."""
        if self.low is not None and self.high is not None and self.low <= self.high:
            return min(max(value, self.low), self.high)
        return value

    def encode(self, value: Value) -> bytes:
        """Return the value as it goes over the wire."""
        if isinstance(value, bytes):
            return value
        if isinstance(value, float):
            return struct.pack("<f" if self.bits == 32 else "<d", value)
        size = (self.bits + 7) // 8
        return (value & ((1 << 8 * size) - 1)).to_bytes(size, "little")

    def decode(self, data: bytes) -> Value:
        """Return the value in `data`.

        Raises
        ------
        SdoAbortError
            The length is wrong for the type.
        """
        if not self.bits:
            if len(data) > _MAX_STRING_BYTES:
                raise SdoAbortError(abort.OUT_OF_MEMORY)
            return bytes(data)
        size = (self.bits + 7) // 8
        if len(data) != size:
            raise SdoAbortError(abort.TOO_LONG if len(data) > size else abort.TOO_SHORT)
        if self.data_type in datatypes.FLOAT_TYPES:
            return float(struct.unpack("<f" if size == 4 else "<d", data)[0])
        return int.from_bytes(data, "little", signed=self.signed)

    def check_limits(self, value: Value) -> None:
        """Refuse a value beyond the data sheet's limits.

        Raises
        ------
        SdoAbortError
            The value is too high or too low.
        """
        if isinstance(value, bytes):
            return  # strings and domains have no limits
        if self.high is not None and value > self.high:
            raise SdoAbortError(abort.VALUE_TOO_HIGH)
        if self.low is not None and value < self.low:
            raise SdoAbortError(abort.VALUE_TOO_LOW)


class Objects:
    """All entries of one device.

    Hooks
    -----
    `checks[key](value)` runs before a write over the bus and may raise SdoAbortError; `effects[key](value)` runs after any write that
    came over the bus; `readings[key]()` gives the value for a read, or raises; `changed(entry)` runs when an SDO has changed a value.
    """

    def __init__(self, dictionary: canopen.ObjectDictionary) -> None:
        self.entries: dict[int, Entry] = {}
        self._indices: set[int] = set()
        for index, item in dictionary.items():
            if index < 0x1000:
                continue  # dummies of the PDO mapping are no objects
            for variable in [item] if isinstance(item, ODVariable) else item.values():
                self.add(variable)
        self.checks: dict[int, Callable[[Value], None]] = {}
        self.effects: dict[int, Callable[[Value], None]] = {}
        self.readings: dict[int, Callable[[], Value]] = {}
        self.changed: Callable[[Entry], None] = lambda entry: None

    def add(self, variable: ODVariable) -> None:
        """Add an object, or a subindex of one."""
        entry = Entry(variable)
        self.entries[entry.key] = entry
        self._indices.add(entry.index)

    def take_defaults(self, before: canopen.ObjectDictionary, dictionary: canopen.ObjectDictionary) -> None:
        """Take the defaults that differ between two readings of the data sheet, which are those that hold the node id."""
        old, new = Objects(before), Objects(dictionary)
        for key, entry in new.entries.items():
            if key in self.entries and entry.default != old.entries[key].default:
                self.entries[key].default = entry.default

    def __contains__(self, index: int) -> bool:
        """Return whether the device has an object of this index."""
        return index in self._indices

    def __iter__(self) -> Iterator[Entry]:
        """Iterate over all entries."""
        return iter(self.entries.values())

    def find(self, index: int, subindex: int = 0) -> Entry:
        """Return an entry.

        Raises
        ------
        SdoAbortError
            There is no such object or no such subindex.
        """
        entry = self.entries.get(index << 8 | subindex)
        if entry is None:
            raise SdoAbortError(abort.NO_SUBINDEX if index in self._indices else abort.NO_OBJECT)
        return entry

    def get(self, index: int, subindex: int = 0) -> Entry | None:
        """Return an entry, or None."""
        return self.entries.get(index << 8 | subindex)

    def number(self, index: int, subindex: int = 0, otherwise: int = 0) -> int:
        """Return an integer's present value, or `otherwise` where the device has no such object."""
        entry = self.entries.get(index << 8 | subindex)
        return entry.value if entry is not None and isinstance(entry.value, int) else otherwise

    def default(self, index: int, subindex: int = 0) -> int:
        """Return an integer's default; 0 where the device has no such object."""
        entry = self.get(index, subindex)
        return entry.default if entry is not None and isinstance(entry.default, int) else 0

    def read(self, index: int, subindex: int) -> bytes:
        """Return what an SDO upload transfers."""
        entry = self.find(index, subindex)
        if not entry.readable:
            raise SdoAbortError(abort.WRITE_ONLY)
        reading = self.readings.get(entry.key)
        return entry.encode(reading() if reading else entry.value)

    def writable_entry(self, index: int, subindex: int) -> Entry:
        """Return the entry that an SDO download may write to."""
        entry = self.find(index, subindex)
        if not entry.writable:
            raise SdoAbortError(abort.READ_ONLY)
        return entry

    def write(self, index: int, subindex: int, data: bytes) -> None:
        """Write as an SDO download does: rights, length, limits, the device's own checks, the value, its effects."""
        entry = self.writable_entry(index, subindex)
        value = entry.decode(data)
        entry.check_limits(value)
        if check := self.checks.get(entry.key):
            check(value)
        before, entry.value = entry.value, value
        if value != before:
            self.changed(entry)
        if effect := self.effects.get(entry.key):
            effect(value)
