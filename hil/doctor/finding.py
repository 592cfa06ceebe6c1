"""What a check found: one line, and how bad it is."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal, get_args

Level = Literal["ok", "look", "bad", "not known"]
LEVELS: tuple[Level, ...] = get_args(Level)


@dataclass(frozen=True)
class Finding:
    """One check's answer.

    Parameters
    ----------
    level : str
        ok; look: the loop runs, and could run better; bad: it does not, or not for long; not known: this system does not say.
    check : str
        What was looked at.
    found : str
    advice : str
        What would be right or what to do; '' where nothing is.
    """

    level: Level
    check: str
    found: str
    advice: str = ""

    def __str__(self) -> str:
        """Return the line for a person."""
        return f"{self.level + ':':10s} {self.check}: {self.found}{f'; {self.advice}' if self.advice else ''}"


def unknown(check: str, why: str) -> Finding:
    """Return the finding of a check that this system does not answer."""
    return Finding("not known", check, why)


def text_of(path: Path) -> str | None:
    """Return a small file's text without the last line end; None where it cannot be read."""
    try:
        return path.read_text(encoding="utf-8", errors="replace").strip()
    except OSError:
        return None


def number_of(path: Path) -> int | None:
    """Return the whole number that a file holds; None where it holds none."""
    text = text_of(path)
    try:
        return None if text is None else int(text, 0)
    except ValueError:
        return None
