"""What a results page shows of a results file: its command, what was asked, and which figures."""

from __future__ import annotations

from typing import NamedTuple

Path = tuple[str, ...]


class Column(NamedTuple):
    """A figure of every row: its heading with the unit, where it is below the row, and the factor to that unit."""

    heading: str
    path: Path
    factor: float = 1.0


class Figure(NamedTuple):
    """One figure: what it is, where it is in the file, its unit, the factor to that unit, and what was asked of it."""

    name: str
    path: Path
    unit: str = ""
    factor: float = 1.0
    asked: str = ""


class Rows(NamedTuple):
    """A table: a row per key of the object at `path`, or per named key."""

    heading: str
    path: Path
    columns: tuple[Column, ...]
    keys: tuple[str, ...] = ()


class Shown(NamedTuple):
    """A results file of benchmarks/results and what of it is shown."""

    file: str
    title: str
    text: str
    command: str
    figures: tuple[Figure, ...] = ()
    rows: tuple[Rows, ...] = ()
