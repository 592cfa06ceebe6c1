"""Octave's text format, which its `save` writes unless told otherwise: what `mat5` gives, under the same names.

Source: Octave 7, libinterp/corefcn/ls-oct-text.cc and ov-*.cc. A variable is a line `# name: NAME`, a line `# type: TYPE`, and what the
type needs; structures and cells have their parts as further variables. Values of arrays stand by rows in two dimensions, else one a line,
by columns.
"""

from __future__ import annotations

import re

import numpy as np

from hil.recording.mat5 import MatError, Value

MARK = b"# Created by Octave"
"""First bytes of such a file."""

_NUMBERS = re.compile(r"(?:float |bool |u?int(?:8|16|32|64) )?matrix|null_matrix")
_SINGLE = re.compile(r"(?:(?:float|u?int(?:8|16|32|64)) )?scalar|bool")
_RANGE = re.compile(r"(?:\w+_)?range")
_TEXT = re.compile(r"(?:sq_|null_|null_sq_)?string")
_NAME = "# name: "
_DEEPEST = 32
_MOST_NUMBERS = 2**28
"""Of a range, which says how many it has in one line."""


def octave_arrays(content: bytes) -> dict[str, Value]:
    """Return every variable of a file, None for what is neither numbers nor text; MatError names the line that is wrong."""
    reader = _Reader(content.decode("utf-8", errors="replace").splitlines())
    try:
        while reader.next_name() is not None:
            reader.add("", 0)
    except (ValueError, IndexError) as problem:
        if isinstance(problem, MatError):
            raise
        raise MatError(f"damaged: line {min(reader.at, len(reader.lines))} of Octave's text format is not what its type needs") from None
    return reader.variables


class _Reader:
    """Adds what is in the lines to `variables`."""

    def __init__(self, lines: list[str]) -> None:
        self.lines = lines
        self.at = 0
        self.variables: dict[str, Value] = {}

    def next_name(self) -> str | None:
        """Go to the next variable; return its name, None at the end."""
        while self.at < len(self.lines) and not self.lines[self.at].startswith(_NAME):
            self.at += 1
        return self.lines[self.at].removeprefix(_NAME) if self.at < len(self.lines) else None

    def add(self, under: str, depth: int) -> None:
        """Add the next variable; `under` ends in `{` for the cell of a number that stands behind it, in `.` for a field."""
        if depth > _DEEPEST:
            raise MatError(f"structures more than {_DEEPEST} deep")
        own = self.next_name()
        self.at += 1
        name = under if under.endswith("}") else under + (own or "")
        kind = self._said("type")
        if _NUMBERS.fullmatch(kind):
            self.variables[name] = self._matrix()
        elif _SINGLE.fullmatch(kind):
            self.variables[name] = _floats(self._line(), (1, 1))
        elif _RANGE.fullmatch(kind):
            self.variables[name] = self._range()
        elif _TEXT.fullmatch(kind):
            self.variables[name] = self._text()
        elif kind == "cell":
            count = int(np.prod(self._shape()))
            for place in range(1, count + 1):
                self.add(f"{name}{{{place}}}", depth + 1)
        elif kind == "scalar struct":
            self._shape()
            for _ in range(int(self._said("length"))):
                self.add(f"{name}.", depth + 1)
        elif kind == "struct":
            self._structures(name, depth)
        else:
            self.variables[name] = None  # complex, sparse, functions, objects: up to the next name

    def _structures(self, name: str, depth: int) -> None:
        """Add an array of structures: each field is a cell, of which element k is `name(k).field`."""
        self._shape()
        for _ in range(int(self._said("length"))):
            field = self.next_name()
            self.at += 1
            if self._said("type") != "cell":
                raise MatError(f"damaged: line {self.at}: a field of the structures {name} is no cell")
            count = int(np.prod(self._shape()))
            for place in range(1, count + 1):
                kept, self.variables = self.variables, {}
                self.add("{1}", depth + 1)
                inner, self.variables = self.variables, kept
                element = f"{name}.{field}" if count == 1 else f"{name}({place}).{field}"
                self.variables |= {element + part.removeprefix("{1}"): value for part, value in inner.items()}

    def _line(self) -> str:
        self.at += 1
        return self.lines[self.at - 1]

    def _said(self, what: str) -> str:
        """Return what a line `# what: ...` says."""
        line = self._line()
        if not line.startswith(f"# {what}:"):
            raise MatError(f"damaged: line {self.at}: {line[:40]!r} where `# {what}:` would be right")
        return line.partition(":")[2].strip()

    def _shape(self) -> tuple[int, ...]:
        if self.lines[self.at].startswith("# ndims:"):
            self.at += 1
            shape = tuple(int(word) for word in self._line().split())
        else:
            shape = int(self._said("rows")), int(self._said("columns"))
        if min(shape, default=-1) < 0:
            raise MatError(f"damaged: line {self.at}: a shape of {shape}")
        return shape

    def _matrix(self) -> np.ndarray:
        by_columns = self.lines[self.at].startswith("# ndims:")
        shape = self._shape()
        count = int(np.prod(np.array(shape, dtype=object)))
        first, taken = self.at, count if by_columns else shape[0] if count else 0
        self.at += taken
        words = " ".join(self.lines[first : self.at])
        return _floats(words, shape, "F" if by_columns else "C")

    def _range(self) -> np.ndarray:
        self.at += 1  # `# base, limit, increment`
        base, limit, step = (float(word) for word in self._line().split()[:3])
        count = int(np.floor((limit - base) / step + 1e-10)) + 1 if step else 0
        if not 0 <= count <= _MOST_NUMBERS:
            raise MatError(f"damaged: line {self.at}: a range of {float(count):.3g} numbers")
        return base + step * np.arange(count)

    def _text(self) -> str | None:
        lines = []
        for _ in range(int(self._said("elements"))):
            length = int(self._said("length"))
            lines.append(self._line() if length else "")
        return "\n".join(lines) if len(lines) < 2 else None


def _floats(words: str, shape: tuple[int, ...], order: str = "C") -> np.ndarray:
    values = np.array(["nan" if word == "NA" else word for word in words.split()], dtype=np.float64)
    return values.reshape(shape, order="F" if order == "F" else "C")
