"""Conversion of process data objects to integers and back, precomputed for use in every tick.

CiA 301 packs mapped objects one after the other, least significant bit first, little endian; at most 64 bits. Mappings of whole 8, 16, 32
and 64-bit objects go through one precompiled `struct`, any other widths through shifts of one 64-bit integer.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from drivers.errors import ProtocolError

MAX_BITS = 64
_FORMATS = {
    (8, False): "B",
    (8, True): "b",
    (16, False): "H",
    (16, True): "h",
    (32, False): "I",
    (32, True): "i",
    (64, False): "Q",
    (64, True): "q",
}

SIGNED_OBJECTS = frozenset(
    {0x2100, 0x2101, 0x6060, 0x6061, 0x6062, 0x6064, 0x606C, 0x6071, 0x6074, 0x6077, 0x6078, 0x607A, 0x60B0, 0x60B1, 0x60B2, 0x60FF, 0x6030}
)
"""Objects of CiA 402 and 406 and of a CANopen IMU that are two's complement; all other mapped objects are read as unsigned."""


@dataclass(frozen=True)
class PdoCodec:
    """The codec of one mapping.

    Parameters
    ----------
    bits : tuple of int
        Width of each mapped object, in order; together at most 64.
    signed : tuple of bool
        Whether each is two's complement.
    """

    bits: tuple[int, ...]
    signed: tuple[bool, ...]
    size: int = field(init=False)  # bytes
    unpack_whole: Callable[[bytes | bytearray], tuple[int, ...]] = field(init=False, repr=False, compare=False)  # `size` bytes
    _struct: struct.Struct | None = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Check the widths and precompile the layout."""
        if not self.bits or any(width < 1 for width in self.bits) or sum(self.bits) > MAX_BITS:
            raise ProtocolError(f"a PDO maps 1 to {MAX_BITS} bits in objects of at least 1 bit; this one maps {list(self.bits)}")
        formats = [_FORMATS.get(key) for key in zip(self.bits, self.signed, strict=True)]
        packed = None if None in formats else struct.Struct("<" + "".join(f for f in formats if f))
        object.__setattr__(self, "size", (sum(self.bits) + 7) // 8)
        object.__setattr__(self, "_struct", packed)
        object.__setattr__(self, "unpack_whole", self.unpack if packed is None else packed.unpack)

    @classmethod
    def of(cls, entries: Sequence[tuple[int, int, int]]) -> PdoCodec:
        """Make the codec of mapping entries (index, subindex, bits), signs by `SIGNED_OBJECTS`."""
        return cls(tuple(bits for _, _, bits in entries), tuple(index in SIGNED_OBJECTS for index, _, _ in entries))

    def unpack(self, data: bytes | bytearray) -> tuple[int, ...]:
        """Return the mapped values of a frame's data; bytes beyond the mapping are ignored, as CiA 301 allows.

        Raises
        ------
        ProtocolError
            The frame is shorter than the mapping.
        """
        if len(data) < self.size:
            raise ProtocolError(f"PDO of {len(data)} bytes where {self.size} are mapped")
        if self._struct is not None:
            return self._struct.unpack_from(data)
        word = int.from_bytes(data[: self.size], "little")
        values = []
        for width, signed in zip(self.bits, self.signed, strict=True):
            value = word & (1 << width) - 1
            values.append(value - (1 << width) if signed and value >> width - 1 else value)
            word >>= width
        return tuple(values)

    def pack(self, *values: int) -> bytes:
        """Return the mapped values as frame data.

        Raises
        ------
        ProtocolError
            A value does not fit its width.
        """
        try:
            if self._struct is not None:
                return self._struct.pack(*values)
        except struct.error as error:
            raise ProtocolError(f"values {values} do not fit PDO widths {self.bits}: {error}") from error
        word = shift = 0
        for value, width, signed in zip(values, self.bits, self.signed, strict=True):
            low, high = (-(1 << width - 1), (1 << width - 1) - 1) if signed else (0, (1 << width) - 1)
            if not low <= value <= high:
                raise ProtocolError(f"value {value} does not fit {width} bits")
            word |= (value & (1 << width) - 1) << shift
            shift += width
        return word.to_bytes(self.size, "little")
