"""What a page shows. Values only: build.py makes the page of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

from hil.pages.chart import Charts

Kind = Literal["good", "bad", "unsure", "plain"]


@dataclass(frozen=True)
class Verdict:
    """The answer in one plain sentence, and which kind of answer it is; `plain` for what is neither good nor bad."""

    text: str
    kind: Kind = "plain"


@dataclass(frozen=True)
class Text:
    """A paragraph; `heading` is a line above it."""

    text: str
    heading: str = ""


@dataclass(frozen=True)
class Bullets:
    """A list; `heading` is a line above it."""

    items: Sequence[str]
    heading: str = ""


@dataclass(frozen=True)
class Table:
    """A table of text.

    Parameters
    ----------
    head : sequence of str
    rows : sequence of sequences of str
        As many cells as the head; a cell may have several lines.
    numbers : frozenset of int
        Columns that are set flush right.
    kinds : sequence of Kind, optional
        Of each row, shown at its left edge and in words for those who do not see it.
    caption : str, optional
    """

    head: Sequence[str]
    rows: Sequence[Sequence[str]]
    numbers: frozenset[int] = frozenset()
    kinds: Sequence[Kind] = ()
    caption: str = ""

    def __post_init__(self) -> None:
        """Check that every row is as long as the head."""
        for row in self.rows:
            if len(row) != len(self.head):
                raise ValueError(f"table with the columns {', '.join(self.head)}: a row of {len(row)} cells")


@dataclass(frozen=True)
class Picture:
    """A still picture (PNG), the words in its place, and the line below it."""

    png: bytes
    alt: str
    caption: str = ""


Block = Text | Bullets | Table | Picture | Charts


@dataclass(frozen=True)
class Section:
    """A part of a page; folded, it shows its title until it is opened."""

    title: str
    blocks: Sequence[Block]
    is_folded: bool = False


@dataclass(frozen=True)
class Page:
    """A page: title, verdict and next command on top, then its sections, and what it was made from.

    Parameters
    ----------
    title : str
    verdict : Verdict
    next_command : str
        What to type next; "" for none.
    next_reason : str
        What that brings.
    facts : mapping of str to str
        Machine, files and what else says where the page comes from; date and version are added.
    sections : sequence of Section
    is_emulated : bool
        What is shown was recorded on an emulated machine: every view says so.
    """

    title: str
    verdict: Verdict
    sections: Sequence[Section] = ()
    next_command: str = ""
    next_reason: str = ""
    facts: Mapping[str, str] = field(default_factory=dict)
    is_emulated: bool = False
