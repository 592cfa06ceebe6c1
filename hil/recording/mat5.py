"""MATLAB's MAT-file format, level 5 (versions 5 to 7): the numeric arrays of a file.

Read here because `scipy.io.loadmat` trusts type codes and sizes: on a damaged file it ends the process with a segmentation fault.

Source: MathWorks, MAT-File Format (level 5). A file is a header of 128 bytes and elements; an element is a tag (type, length) and
its data; an array is an element of elements: flags, dimensions, name, values.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator

import numpy as np

_HEADER_BYTES = 128
_MATRIX, _COMPRESSED = 14, 15
_INT8, _INT32, _UINT32 = 1, 5, 6
_TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
_NUMERIC_CLASSES = range(6, 16)  # double, single, and the integers
_COMPLEX_FLAG = 0x0800
_MOST_INFLATED = 2**28  # of one variable: 33 million numbers, 36 hours at 256 Hz


class Mat5Error(ValueError):
    """Bytes that are no MAT-file of level 5."""


def numeric_arrays(content: bytes) -> dict[str, np.ndarray | None]:
    """Every variable of a file: a real numeric array with its shape, None for anything else (texts, structures, cells, sparse, complex).

    Raises
    ------
    Mat5Error
        What is wrong with the bytes.
    """
    if content.startswith(b"MATLAB 7.3"):
        raise Mat5Error("MATLAB 7.3 (HDF5); save it with -v7")
    order = {b"IM": "<", b"MI": ">"}.get(content[126:_HEADER_BYTES])
    if order is None or not content.startswith(b"MATLAB 5"):
        raise Mat5Error("no MATLAB file of version 5 to 7")
    variables: dict[str, np.ndarray | None] = {}
    for kind, data in _elements(content, _HEADER_BYTES, order):
        if kind == _COMPRESSED:
            inner = next(_elements(_inflated(data), 0, order), None)
            if inner is None:
                raise Mat5Error("damaged: an empty compressed element")
            kind, data = inner
        if kind == _MATRIX:
            name, values = _array(data, order)
            variables[name] = values
    return variables


def _elements(content: bytes, start: int, order: str) -> Iterator[tuple[int, bytes]]:
    """(type, data) of the elements one after the other."""
    while start < len(content):
        if start + 8 > len(content):
            raise Mat5Error(f"damaged: cut off at byte {start}")
        kind, length = struct.unpack_from(order + "II", content, start)
        begin = start + 8
        if kind >> 16:  # the small form: length and type share a word, the data the next
            kind, length, begin = kind & 0xFFFF, kind >> 16, start + 4
            if length > 4:
                raise Mat5Error(f"damaged: a small element of {length} bytes")
        end = begin + length
        if end > len(content):
            raise Mat5Error(f"damaged: cut off, or an element at byte {start} that is too long")
        yield kind, content[begin:end]
        start = start + 8 if begin == start + 4 else end if kind == _COMPRESSED else end + -end % 8


def _inflated(data: bytes) -> bytes:
    inflate = zlib.decompressobj()
    try:
        content = inflate.decompress(data, _MOST_INFLATED)
        if inflate.unconsumed_tail:
            raise Mat5Error(f"a variable of more than {_MOST_INFLATED} bytes, compressed to {len(data)}")
        return content + inflate.flush()
    except zlib.error as problem:
        raise Mat5Error(f"damaged: {problem}") from None


def _array(data: bytes, order: str) -> tuple[str, np.ndarray | None]:
    parts = list(_elements(data, 0, order))
    if len(parts) < 3 or [kind for kind, _ in parts[:3]] != [_UINT32, _INT32, _INT8] or len(parts[0][1]) != 8 or len(parts[1][1]) % 4:
        raise Mat5Error("damaged: an array without flags, dimensions and name")
    flags = struct.unpack_from(order + "I", parts[0][1])[0]
    shape = struct.unpack(f"{order}{len(parts[1][1]) // 4}i", parts[1][1])
    name = parts[2][1].decode("latin-1")
    if flags & 0xFF not in _NUMERIC_CLASSES or flags & _COMPLEX_FLAG:
        return name, None
    kind, values = parts[3] if len(parts) == 4 else (0, b"")
    if kind not in _TYPES:
        raise Mat5Error(f"damaged: variable {name} has values of no known type")
    numbers = np.frombuffer(values[: len(values) - len(values) % np.dtype(_TYPES[kind]).itemsize], dtype=order + _TYPES[kind])
    if min(shape, default=-1) < 0 or np.prod(np.array(shape, dtype=object)) != numbers.size:
        raise Mat5Error(f"damaged: variable {name} of shape {shape} has {numbers.size} values")
    return name, numbers.reshape(shape, order="F")
