"""What a data sheet that bends the rules is read as, and the lines that were: the sections of the file with their line numbers."""

from __future__ import annotations

from collections.abc import Mapping

from canopen.objectdictionary import datatypes

LINES_SHOWN = 3
"""Lines of one kind of repair that are named; the rest is counted."""


class Section(dict[str, str]):
    """The keys of one section, with the lines of the file that they stand in.

    Parameters
    ----------
    line : int
        Of its head.
    keys : mapping of str to str, optional
    """

    def __init__(self, line: int, keys: Mapping[str, str] | None = None) -> None:
        super().__init__(keys or {})
        self.line = line
        self._lines: dict[str, int] = {}

    def put(self, key: str, value: str, line: int) -> None:
        """Set a key that stands in a line."""
        self[key] = value
        self._lines[key] = line

    def line_of(self, key: str) -> int:
        """Return the line of a key; that of the head where the file does not have it."""
        return self._lines.get(key, self.line)


Sections = dict[str, Section]


class Repairs:
    """Repairs by what was done, with their lines."""

    def __init__(self) -> None:
        self._lines: dict[str, list[int]] = {}

    def add(self, words: str, line: int) -> None:
        """Keep a repair of a line."""
        lines = self._lines.setdefault(words, [])
        if line not in lines[-1:]:
            lines.append(line)

    def __bool__(self) -> bool:
        """Return whether anything was repaired."""
        return bool(self._lines)

    def __str__(self) -> str:
        """Return all repairs in one line."""
        return "; ".join(f"{_lines_in_words(lines)}: {words}" for words, lines in self._lines.items())


def _lines_in_words(lines: list[int]) -> str:
    shown = ", ".join(map(str, lines[:LINES_SHOWN]))
    more = f" and {len(lines) - LINES_SHOWN} more" if len(lines) > LINES_SHOWN else ""
    return f"line{'s' if len(lines) > 1 else ''} {shown}{more}"


_U8, _U16, _U32 = datatypes.UNSIGNED8, datatypes.UNSIGNED16, datatypes.UNSIGNED32
_WHOLE: dict[int, int] = {0x1000: _U32, 0x1001: _U8, 0x1005: _U32, 0x1006: _U32, 0x1007: _U32, 0x100C: _U16, 0x100D: _U8, 0x1014: _U32,
                          0x1015: _U16, 0x1017: _U16, 0x1019: _U8}  # fmt: skip
_ELEMENTS: dict[int, int] = {0x1003: _U32, 0x1010: _U32, 0x1011: _U32, 0x1016: _U32, 0x1018: _U32, 0x1029: _U8}
_PDO_COMMUNICATION: dict[int, int] = {1: _U32, 2: _U8, 3: _U16, 5: _U16, 6: _U8}

RECORDS: dict[int, dict[int, int]] = {
    0x20: {0: _U8, **_PDO_COMMUNICATION, 4: _U8},
    0x21: {0: _U32},
    0x22: {0: _U32, 3: _U8},
    0x23: {0: _U32},
}
"""Types of the elements of CiA 301's records (7.4.7: PDO communication and mapping, SDO parameters, identity); at 0 that of all others."""


def standard_type(index: int, subindex: int) -> int | None:
    """Return the data type that CiA 301 (7.5.2) gives an object of the communication profile; None where it gives none."""
    if index in _WHOLE:
        return _WHOLE[index] if subindex == 0 else None
    kind = index & 0xFE00
    if index in _ELEMENTS or kind in (0x1400, 0x1600, 0x1800, 0x1A00):
        if subindex == 0:
            return None if index == 0x1003 else _U8
        if index in _ELEMENTS:
            return _ELEMENTS[index]
        return _PDO_COMMUNICATION.get(subindex) if kind in (0x1400, 0x1800) else _U32
    return None
