"""MATLAB's MAT-file format, level 5 (versions 5 to 7): the numeric arrays and texts of a file, those inside structures and cells too.

Read here because `scipy.io.loadmat` trusts type codes and sizes: on a damaged file it ends the process with a segmentation fault.

Source: MathWorks, MAT-File Format (level 5). A file is a header of 128 bytes and elements; an element is a tag (type, length) and
its data; an array is an element of elements: flags, dimensions, name, values; of a structure the length and the names of its fields, and
an array for each field of each element; of a cell array an array for each cell.
"""

from __future__ import annotations

import itertools
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
_CELL_CLASS, _STRUCT_CLASS, _CHAR_CLASS = 1, 2, 4
_TEXT_TYPES = {1: "latin-1", 2: "latin-1", 4: "utf-16", 16: "utf-8", 17: "utf-16", 18: "utf-32"}
_MOST_INFLATED = 2**28  # of one variable: 33 million numbers, 36 hours at 256 Hz
_MOST_ARRAYS = 100_000  # of one file: a thousand signals with all that Simulink says of each are fewer
_DEEPEST = 32  # structures in structures

Value = np.ndarray | str | None
"""A real numeric array with its shape, a text of one line, or None for anything else."""


class MatError(ValueError):
    """Bytes that are no MAT-file."""


def numeric_arrays(content: bytes) -> dict[str, Value]:
    """Return every variable of a file, None for what is neither numbers nor text (sparse, complex, objects, functions).

    What a structure holds is named as MATLAB names it: `log.time`, `log.signals(2).values`, `runs{3}`.

    Raises
    ------
    MatError
        What is wrong with the bytes.
    """
    order = {b"IM": "<", b"MI": ">"}.get(content[126:_HEADER_BYTES])
    if order is None or not content.startswith(b"MATLAB 5"):
        raise MatError("no MATLAB file of version 4 to 7.3, nor Octave's text")
    variables: dict[str, Value] = {}
    for kind, data in _elements(content, _HEADER_BYTES, order):
        if kind == _COMPRESSED:
            inner = next(_elements(_inflated(data), 0, order), None)
            if inner is None:
                raise MatError("damaged: an empty compressed element")
            kind, data = inner
        if kind == _MATRIX:
            _array(data, order, None, variables, 0)
    return variables


def _elements(content: bytes, start: int, order: str) -> Iterator[tuple[int, bytes]]:
    """(type, data) of the elements one after the other."""
    while start < len(content):
        if start + 8 > len(content):
            raise MatError(f"damaged: cut off at byte {start}")
        kind, length = struct.unpack_from(order + "II", content, start)
        begin = start + 8
        if kind >> 16:  # the small form: length and type share a word, the data the next
            kind, length, begin = kind & 0xFFFF, kind >> 16, start + 4
            if length > 4:
                raise MatError(f"damaged: a small element of {length} bytes")
        end = begin + length
        if end > len(content):
            raise MatError(f"damaged: cut off, or an element at byte {start} that is too long")
        yield kind, content[begin:end]
        start = start + 8 if begin == start + 4 else end if kind == _COMPRESSED else end + -end % 8


def _inflated(data: bytes) -> bytes:
    inflate = zlib.decompressobj()
    try:
        content = inflate.decompress(data, _MOST_INFLATED)
        if inflate.unconsumed_tail:
            raise MatError(f"a variable of more than {_MOST_INFLATED} bytes, compressed to {len(data)}")
        return content + inflate.flush()
    except zlib.error as problem:
        raise MatError(f"damaged: {problem}") from None


def _array(data: bytes, order: str, name: str | None, variables: dict[str, Value], depth: int) -> None:
    """Add the values of an array, or of all that is in it, under `name` (its own where that is None)."""
    if len(variables) >= _MOST_ARRAYS:
        raise MatError(f"more than {_MOST_ARRAYS} arrays; save the variables that matter alone")
    if depth > _DEEPEST:
        raise MatError(f"structures more than {_DEEPEST} deep")
    if not data and name is not None:  # an empty field
        variables[name] = None
        return
    parts = list(itertools.islice(_elements(data, 0, order), 3))
    if len(parts) < 3 or [kind for kind, _ in parts] != [_UINT32, _INT32, _INT8] or len(parts[0][1]) != 8 or len(parts[1][1]) % 4:
        raise MatError("damaged: an array without flags, dimensions and name")
    flags = struct.unpack_from(order + "I", parts[0][1])[0]
    shape = struct.unpack(f"{order}{len(parts[1][1]) // 4}i", parts[1][1])
    name = parts[2][1].decode("latin-1") if name is None else name
    if min(shape, default=-1) < 0:
        raise MatError(f"damaged: variable {name} of shape {shape}")
    count = int(np.prod(np.array(shape, dtype=object)))
    rest = itertools.islice(_elements(data, 0, order), 3, None)
    match flags & 0xFF:
        case kind if kind in _NUMERIC_CLASSES and not flags & _COMPLEX_FLAG:
            variables[name] = _numbers(list(rest), order, name, shape, count)
        case kind if kind == _CHAR_CLASS and count in shape:
            variables[name] = _text(list(rest), name) if count else ""
        case kind if kind == _STRUCT_CLASS:
            _structure(rest, order, name, count, variables, depth)
        case kind if kind == _CELL_CLASS:
            for place, (_, cell) in enumerate(rest, 1):
                _array(cell, order, f"{name}{{{place}}}", variables, depth + 1)
        case _:
            variables[name] = None


def _structure(rest: Iterator[tuple[int, bytes]], order: str, name: str, count: int, variables: dict[str, Value], depth: int) -> None:
    length, names = next(rest, (0, b"")), next(rest, (0, b""))
    width = struct.unpack(order + "i", length[1])[0] if len(length[1]) == 4 else 0
    if length[0] != _INT32 or names[0] != _INT8 or width <= 0 or len(names[1]) % width:
        raise MatError(f"damaged: structure {name} without names of its fields")
    fields = [names[1][k : k + width].split(b"\0")[0].decode("latin-1") for k in range(0, len(names[1]), width)]
    found = 0
    for place, (_, data) in enumerate(rest):
        element, field = divmod(place, len(fields))
        found += 1
        _array(data, order, f"{name}.{fields[field]}" if count == 1 else f"{name}({element + 1}).{fields[field]}", variables, depth + 1)
    if found != count * len(fields):
        raise MatError(f"damaged: structure {name} has {found} values for {count} elements of {len(fields)} fields")


def _numbers(parts: list[tuple[int, bytes]], order: str, name: str, shape: tuple[int, ...], count: int) -> np.ndarray:
    kind, values = parts[0] if len(parts) == 1 else (0, b"")
    if kind not in _TYPES:
        raise MatError(f"damaged: variable {name} has values of no known type")
    numbers = np.frombuffer(values[: len(values) - len(values) % np.dtype(_TYPES[kind]).itemsize], dtype=order + _TYPES[kind])
    if count != numbers.size:
        raise MatError(f"damaged: variable {name} of shape {shape} has {numbers.size} values")
    return numbers.reshape(shape, order="F")


def _text(parts: list[tuple[int, bytes]], name: str) -> str | None:
    kind, letters = parts[0] if len(parts) == 1 else (0, b"")
    if kind not in _TEXT_TYPES:
        return None
    try:
        return letters.decode(_TEXT_TYPES[kind])
    except UnicodeDecodeError:
        raise MatError(f"damaged: text {name}") from None
