"""One input and what became of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

RIGHT, WAY_OUT, WRONG = "right", "refused with the way out", "wrong"


class Outcome(NamedTuple):
    """What became of an input: one of the three words, and what was said or was wrong."""

    what: str
    said: str = ""


@dataclass(frozen=True)
class Input:
    """One input: `judge` makes it in an empty folder, reads it, and compares it with what went in."""

    name: str
    kind: str
    tool: str
    judge: Callable[[Path], Outcome]


def refused(said: str, *words: str) -> Outcome:
    """Judge a refusal: one line with these words, and no guess that ends in a question mark."""
    lacking = [word for word in words if word not in said]
    if "\n" in said or lacking or said.rstrip().endswith("?"):
        return Outcome(WRONG, f"lacks {lacking}: {said}")
    return Outcome(WAY_OUT, said)
