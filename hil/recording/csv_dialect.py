"""How tools write tables as text: encodings, comments above the header, what separates cells, rows of units, and how numbers are marked."""

from __future__ import annotations

import codecs
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import datetime

import numpy as np

from hil.errors import RecordingError
from hil.recording.channels import KINDS

SEPARATORS = ";\t|"
"""In order of preference; commas separate where none of these is in the header: no channel's name has one of them in it."""

MISSING = frozenset({"", "NA", "N/A", "#N/A", "<NA>", "NULL", "null", "None", "-", "--"})
"""What tools write where a number is missing, beside NaN."""

_UNITS = frozenset(unit for kind in KINDS for unit in kind.units if unit)
_UTF_16 = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
_COMMENT = re.compile(r"[#%]")
_SPACES = "'\u2019 \u00a0\u2009\u202f"
_GROUPED = re.compile(rf"[+-]?\d{{1,3}}(?:(?P<mark>[,.{_SPACES}])\d{{3}})(?:(?P=mark)\d{{3}})*(?:(?P<point>[.,])\d*)?(?:[eE][+-]?\d+)?")
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
    return units if _UNITS.intersection(units) and not any(is_number(unit) for unit in units if unit not in ("-", "1")) else None


@dataclass
class Numbers:
    """Reads the cells of one file, in which one mark stands for decimals and another one for thousands, if any."""

    _decimals: set[str] = field(default_factory=set)
    _thousands: set[str] = field(default_factory=set)

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
