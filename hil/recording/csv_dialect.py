"""How tools write tables as text: encodings, comments above the header, what separates cells, rows of units, and how numbers are marked."""

from __future__ import annotations

import codecs
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import datetime

import numpy as np

from hil.errors import RecordingError
from hil.recording.channels import is_unit

SEPARATORS = ";\t|"
"""In order of preference; commas separate where none of these is in the header: no channel's name has one of them in it."""

MISSING = frozenset({"", "NA", "N/A", "#N/A", "<NA>", "NULL", "null", "None", "-", "--"})
"""What tools write where a number is missing, beside NaN."""

_UTF_16 = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
_COMMENT = re.compile(r"[#%]")
_SPACES = "'\u2019 \u00a0\u2009\u202f"
_GROUPED = re.compile(rf"[+-]?\d{{1,3}}(?:(?P<mark>[,.{_SPACES}])\d{{3}})(?:(?P=mark)\d{{3}})*(?:(?P<point>[.,])\d*)?(?:[eE][+-]?\d+)?")
_EITHER = re.compile(r"[+-]?[1-9]\d{0,2}[,.]\d{3}")
"""With one mark, of decimals or of thousands: nobody groups a number below one, nor writes more than three digits before a mark."""
_TIME_OF_DAY = re.compile(r"\d\d:\d\d")


def decoded(content: bytes, *, strict: bool) -> tuple[str, list[str]]:
    """Return a file's text, and how it was read where that was not plain.

    Parameters
    ----------
    content : bytes
    strict : bool
        UTF-8 alone is right.

    Raises
    ------
    UnicodeDecodeError
        It is no text.
    """
    if not strict and content.startswith(_UTF_16):
        return content.decode("utf-16"), []
    try:
        return content.decode("utf-8-sig"), []
    except UnicodeDecodeError:
        if strict or b"\0" in content:
            raise
    try:
        text = content.decode("cp1252")
    except UnicodeDecodeError:
        return content.decode("utf-8-sig"), []  # raises: no text of either
    return text, ["is no UTF-8 text, and was read in Windows' code page 1252"]


@dataclass(frozen=True)
class Layout:
    """A table in a text: what separates its cells, where it begins, and how many of the text's lines are above that."""

    delimiter: str
    text: str
    skipped: int


def laid_out(text: str, *, strict: bool) -> Layout:
    """Find the table in a text: below a spreadsheet's line `sep=;`, and below comments.

    The last comment is the header where numbers follow it and it has as many cells.
    """
    lines = text.splitlines(keepends=True)
    first = lines[0].strip("\r\n") if lines else ""
    if re.fullmatch(rf"sep=[{SEPARATORS},]", first):
        return Layout(first[-1], "".join(lines[1:]), 1)
    skipped = 0
    while not strict and skipped < len(lines) and _COMMENT.match(lines[skipped]):
        skipped += 1
    header = lines[skipped] if skipped < len(lines) else ""
    if skipped and all(is_number(cell) for cell in header.strip("\r\n").split(_delimiter(header))):
        above = _COMMENT.sub("", lines[skipped - 1], count=1).lstrip()
        if above.count(_delimiter(above)) == header.count(_delimiter(above)):
            return Layout(_delimiter(above), above + "".join(lines[skipped:]), skipped - 1)
    return Layout(_delimiter(header), "".join(lines[skipped:]) if skipped else text, skipped)


def _delimiter(header: str) -> str:
    return next((mark for mark in SEPARATORS if mark in re.sub(r'"[^"]*"', "", header)), ",")


def is_number(cell: str) -> bool:
    """Return whether a cell is a number, with a decimal point or comma."""
    try:
        float(cell.strip().replace(",", "."))
    except ValueError:
        return False
    return True


def row_of_units(cells: Sequence[str]) -> list[str] | None:
    """Return the units of a row below the header; None where the row is not one of units.

    Such a row has no number in it, and a unit that a channel can have.
    """
    units = [re.sub(r"^[\[(](.*)[\])]$", r"\1", cell.strip()) for cell in cells]
    return units if any(map(is_unit, units)) and not any(is_number(unit) for unit in units if unit not in ("-", "1")) else None


@dataclass
class Numbers:
    """Reads the cells of one file, in which one mark stands for decimals and another one for thousands, if any.

    A cell such as `1,234` may be either: it is read with decimals, and `thousands` says in the end whether that was right.
    """

    _thousands: set[str] = field(default_factory=set)
    _decimals: set[str] = field(default_factory=set)
    either: dict[str, str] = field(default_factory=dict)  # comma or point -> the first cell in which it may be of decimals or of thousands

    def number(self, cell: str) -> float:
        """Return a cell's number, NaN where it is missing; ValueError if it is none.

        A single comma or point marks decimals; several of one kind, or one before the other, mark thousands.
        """
        cell = cell.strip()
        if cell in MISSING:
            return np.nan
        marks = [mark for mark in cell if mark in ",." or mark in _SPACES]
        if not marks:
            return float(cell)
        if len(marks) == 1 and marks[0] in ",." and marks[0] not in self._thousands:
            value = float(cell.replace(",", "."))
            if marks[0] not in self._decimals:
                if _EITHER.fullmatch(cell):
                    self.either.setdefault(marks[0], cell)
                else:
                    self._decimals.update(marks)
            return value
        grouped = _GROUPED.fullmatch(cell)
        if grouped is None or grouped["mark"] == grouped["point"]:
            raise ValueError(cell)
        self._thousands.add(grouped["mark"])
        if grouped["point"]:
            self._decimals.add(grouped["point"])
        cell = cell.replace(grouped["mark"], "")
        return float(cell.replace(",", "."))

    def thousands(self, delimiter: str) -> set[str]:
        """Return the marks that were read as of decimals and are of thousands, by what the other cells have told.

        Where commas separate the cells, points are of decimals unless a cell tells otherwise.

        Raises
        ------
        RecordingError
            Nothing tells, or what tells contradicts itself.
        """
        found = set()
        for mark, cell in self.either.items():
            other = "." if mark == "," else ","
            if mark in self._decimals:
                continue
            if mark in self._thousands or (other in self._decimals and not self._thousands):
                found.add(mark)
            elif self._thousands or (mark == "." and delimiter == "," and other not in self.either):
                self._decimals.add(mark)
            else:
                one, thousand = float(cell.replace(",", ".")), int(cell.replace(mark, ""))
                raise RecordingError(
                    f"{cell!r} is {one:g} or {thousand}, and no number in the table says which; one like '0{mark}5' would, or one like "
                    f"'1{mark}000{other}0'; or leave out the marks between thousands"
                )
        self.check()
        return found

    def check(self) -> None:
        """Raise RecordingError if a mark has stood for two things, or two for one."""
        if len(self._decimals) > 1:
            raise RecordingError("decimal commas and points in one file; one of them would be right")
        if both := self._decimals & self._thousands:
            raise RecordingError(
                f"{'commas' if ',' in both else 'points'} mark decimals and thousands in one file; one of them would be right"
            )


class Clock:
    """Reads a column of times of day as seconds since the first."""

    def __init__(self) -> None:
        self._first: datetime | None = None

    def seconds(self, cell: str) -> float:
        """Return the seconds of a time such as `2026-01-05 12:00:00.004` or `12:00:00.004`; ValueError if it is none."""
        cell = cell.strip().replace(",", ".")
        time = datetime.fromisoformat(f"1970-01-01 {cell}" if _TIME_OF_DAY.match(cell) else cell)
        self._first = self._first or time
        if (time.tzinfo is None) != (self._first.tzinfo is None):
            raise ValueError(cell)
        return (time - self._first).total_seconds()
