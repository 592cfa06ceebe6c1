"""How a command answers: text for a person, JSON for a program, never both on one stream."""

from __future__ import annotations

import dataclasses
import json
import math
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hil.errors import UnusableInputError
from hil.files.writable import refuse_unwritable

if TYPE_CHECKING:
    from matplotlib.figure import Figure

JsonOption = Annotated[
    str | None,
    typer.Option("--json", metavar="FILE", help="Write the answer as JSON to FILE; - for standard output, and nothing else goes there."),
]


class Answer:
    """One command's answer. Text goes to standard output, or to standard error when JSON has taken standard output."""

    def __init__(self, json_to: str | None) -> None:
        if json_to is not None and json_to != "-":
            refuse_unwritable(Path(json_to), f"--json {json_to}")
        from rich.console import Console  # not for --help

        self._json_to = json_to
        self.said: list[str] = []
        self.console = Console(stderr=json_to == "-", highlight=False, soft_wrap=True)

    def say(self, text: object = "") -> None:
        """Print for a person, and keep it for a page."""
        self.said.append(str(text))
        self.console.print(text, markup=False)

    def write(self, document: object) -> None:
        """Write the JSON document, where one was asked for."""
        if self._json_to is None:
            return
        text = json.dumps(plain(document), indent=2, ensure_ascii=False)
        if self._json_to == "-":
            sys.stdout.write(text + "\n")
        else:
            Path(self._json_to).write_text(text + "\n", encoding="utf-8")

    def write_at_once(self, document: object) -> None:
        """Write the document in one line, for a program that waits for it while the command goes on."""
        if self._json_to is None:
            return
        text = json.dumps(plain(document), ensure_ascii=False) + "\n"
        if self._json_to == "-":
            sys.stdout.write(text)
            sys.stdout.flush()
        else:
            Path(self._json_to).write_text(text, encoding="utf-8")


def plain(value: object) -> object:
    """Return the value in JSON's own types: arrays as lists, dataclasses as objects, NaN and infinities as null."""
    if isinstance(value, dict):
        return {str(key): plain(entry) for key, entry in value.items()}
    if isinstance(value, (list, tuple, set)):
        return [plain(entry) for entry in value]
    if hasattr(value, "tolist"):  # NumPy's arrays and numbers, known without importing it
        return plain(value.tolist())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if isinstance(value, Path):
        return str(value)
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return plain({each.name: getattr(value, each.name) for each in dataclasses.fields(value) if each.metadata.get("json", True)})
    return value


def save_figure(figure: Figure, path: Path) -> None:
    """Write a picture.

    Raises
    ------
    UnusableInputError
        The file cannot be written, or its suffix is no picture's.
    """
    try:
        figure.savefig(path, dpi=130)
    except (OSError, ValueError) as error:
        raise UnusableInputError(f"{path}: cannot be written: {getattr(error, 'strerror', None) or error}") from None
