"""Readers of answers: each makes a value of a text, or says in a ValueError what would be right."""

from __future__ import annotations

import re
from collections.abc import Callable

NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,59}")


def number(low: float | None = None, *, above: bool = False) -> Callable[[str], float]:
    """Return a reader of a number, at least or above `low`."""

    def read(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            raise ValueError("must be a number") from None
        if not abs(value) < float("inf"):
            raise ValueError("must be a finite number")
        if low is not None and (value < low or (above and value == low)):
            raise ValueError(f"must be {'above' if above else 'at least'} {low:g}")
        return value

    return read


def numbers(*counts: int) -> Callable[[str], list[float]]:
    """Return a reader of several numbers with commas between them."""

    def read(text: str) -> list[float]:
        values = [number()(part) for part in text.split(",")]
        if len(values) not in counts:
            raise ValueError(f"must be {' or '.join(map(str, counts))} numbers with commas between them")
        return values

    return read


def whole(low: int, high: int) -> Callable[[str], int]:
    """Return a reader of a whole number."""

    def read(text: str) -> int:
        try:
            value = int(text, 0)
        except ValueError:
            raise ValueError("must be a whole number") from None
        if not low <= value <= high:
            raise ValueError(f"must lie between {low} and {high}")
        return value

    return read


def one_of(*words: str) -> Callable[[str], str]:
    """Return a reader of one of some words."""

    def read(text: str) -> str:
        if text not in words:
            raise ValueError(f"must be {' or '.join(words)}")
        return text

    return read


def name_of(text: str) -> str:
    """Read a name of the machine file."""
    if not NAME.fullmatch(text):
        raise ValueError("must be a name: a letter, then letters, digits and _")
    return text


def names_of(text: str) -> list[str]:
    """Read names with commas between them."""
    names = [name_of(part.strip()) for part in text.split(",")]
    if len(set(names)) < len(names):
        raise ValueError("names must differ")
    return names


def direction(text: str) -> list[float]:
    """Read `x`, `y`, `z`, or three numbers, as a unit vector."""
    values = {"x": [1.0, 0.0, 0.0], "y": [0.0, 1.0, 0.0], "z": [0.0, 0.0, 1.0]}.get(text) or numbers(3)(text)
    length = sum(value * value for value in values) ** 0.5
    if length == 0.0:
        raise ValueError("must have a length")
    return [float(f"{value / length:.12g}") for value in values]
