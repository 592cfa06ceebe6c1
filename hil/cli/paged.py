"""The option `--page` of commands that answer with numbers and charts."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hil.files.writable import can_be_written, not_an_input

if TYPE_CHECKING:
    from hil.pages import Page
    from hil.terminal.output import Answer

PageOption = Annotated[
    Path | None,
    typer.Option("--page", metavar="HTML", help="Write a page as well: the answer in a sentence, what to do next, charts to zoom into."),
]


def check_page(path: Path | None) -> None:
    """Refuse a place that cannot be written to, or is no page's, before the work is done."""
    can_be_written(path, suffixes=(".html", ".htm"))


def check_drawn(figure: Path | None, page: Path | None, inputs: Sequence[Path]) -> None:
    """Refuse places of a picture and a page that cannot be written to, or are read, before the work is done."""
    can_be_written(figure)
    check_page(page)
    if figure is not None:
        not_an_input(figure, *inputs)


def write_paged(answer: Answer, page: Page, path: Path) -> None:
    """Write a page and say what comes next."""
    from hil.pages import write_page

    write_page(page, path)
    answer.say(f"{path}: page")
    if page.next_command:
        answer.say(f"next: {page.next_command}")
