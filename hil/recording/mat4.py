"""MATLAB's MAT-file format, level 4 (version 4 and `save -v4`): full numeric matrices and texts.

Source: MathWorks, MAT-File Format (level 4). A matrix is a header of five 32-bit words (MOPT, rows, columns, imaginary, length of the
name), the name, and the values by columns. The decimal digits of MOPT are the machine, 0, the type of the values and the kind of matrix.
"""

from __future__ import annotations

import struct

import numpy as np

from hil.recording.mat5 import MatError, Value

_WORDS = 5
_HEADER_BYTES = 4 * _WORDS
_ORDERS = {0: "<", 1: ">"}
_TYPES = ("f8", "f4", "i4", "i2", "u2", "u1")
_FULL, _TEXT, _SPARSE = 0, 1, 2
_MOST_NAME = 256  # bytes; MATLAB's own names have at most 63 letters


def is_level_4(content: bytes) -> bool:
    """Return whether a file begins with a matrix of level 4: one of the first four bytes is 0, where other levels have a text."""
    return _header(content, 0) is not None


def level_4_arrays(content: bytes) -> dict[str, Value]:
    """Return every variable of a file, None for complex and sparse ones; MatError says what is wrong with the bytes."""
    variables: dict[str, Value] = {}
    for name, (what, values) in _matrices(content).items():
        if what == _TEXT and values is not None:
            variables[name] = bytes(np.clip(values, 0, 255).astype(np.uint8).tobytes()).decode("latin-1") if len(values) == 1 else None
        else:
            variables[name] = None if what == _SPARSE else values
    return variables


def level_4_matrices(content: bytes) -> dict[str, np.ndarray]:
    """Return every real full matrix of a file, those of letters as their codes; MatError as `level_4_arrays`."""
    return {name: values for name, (what, values) in _matrices(content).items() if values is not None and what != _SPARSE}


def _matrices(content: bytes) -> dict[str, tuple[int, np.ndarray | None]]:
    """Return the kind of every matrix of a file and its values, None for complex ones."""
    matrices: dict[str, tuple[int, np.ndarray | None]] = {}
    place = 0
    while place < len(content):
        header = _header(content, place)
        if header is None:
            raise MatError(f"damaged: no matrix at byte {place}")
        order, kind, what, rows, columns, imaginary, length = header
        start = place + _HEADER_BYTES
        name = content[start : start + length].split(b"\0")[0].decode("latin-1")
        dtype = np.dtype(order + _TYPES[kind])
        size = rows * columns * dtype.itemsize
        begin = start + length
        place = begin + size * (2 if imaginary else 1)
        if place > len(content):
            raise MatError(f"damaged: cut off in variable {name} of {rows} x {columns}")
        values = np.frombuffer(content[begin : begin + size], dtype=dtype).reshape((rows, columns), order="F")
        matrices[name] = what, None if imaginary else values
    return matrices


def _header(content: bytes, place: int) -> tuple[str, int, int, int, int, int, int] | None:
    """Return byte order, type, kind, rows, columns, whether complex, and bytes of the name; None if there is no header of level 4."""
    words = content[place : place + _HEADER_BYTES]
    if len(words) < _HEADER_BYTES:
        return None
    for machine, order in _ORDERS.items():
        mopt, rows, columns, imaginary, length = struct.unpack(f"{order}{_WORDS}i", words)
        thousands, rest = divmod(mopt, 1000)
        hundreds, rest = divmod(rest, 100)
        kind, what = divmod(rest, 10)
        fits = thousands == machine and hundreds == 0 and kind < len(_TYPES) and what in (_FULL, _TEXT, _SPARSE)
        if mopt >= 0 and fits and min(rows, columns) >= 0 and imaginary in (0, 1) and 0 < length <= _MOST_NAME:
            return order, kind, what, rows, columns, imaginary, length
    return None
