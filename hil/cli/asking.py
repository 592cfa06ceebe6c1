"""How a command asks a verb: progress and remarks go to the terminal, and what is wrong with a request is told by its options."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, TypeVar

import typer

from hil.cli.shared import names_of
from hil.errors import RequestError
from hil.terminal.output import Answer
from hil.terminal.progress import Bars, progress
from hil.verbs.verb import Listener, Work

if TYPE_CHECKING:
    from rich.progress import TaskID

Request = TypeVar("Request")
Found = TypeVar("Found")


def ask(
    verb: Callable[[Request, Listener], Found],
    request: Request,
    answer: Answer,
    options: Mapping[str, str] | None = None,
    told_as: Callable[[str], Exception] = typer.BadParameter,
) -> Found:
    """Return what a verb answers.

    Parameters
    ----------
    options : mapping, optional
        Those that are not called as their part of the request.
    told_as : callable
        Makes the error of options that do not go together, or ask for a choice that there is not; typer's points to the help as well.
    """
    with by_options({**names_of(type(request)), **(options or {})}, told_as):
        return verb(request, Terminal(answer=answer))


@contextmanager
def by_options(options: Mapping[str, str] | None = None, told_as: Callable[[str], Exception] = typer.BadParameter) -> Iterator[None]:
    """Tell an error of a request by the options that made it."""
    try:
        yield
    except RequestError as error:
        named = options or {}
        raise told_as(error.calling(lambda part: f"--{named.get(part, part).replace('_', '-')}")) from None


@dataclass(frozen=True)
class Terminal(Listener):
    """Says remarks in the answer and shows work as bars or lines; a bar of unknown length is gone when its work is done."""

    answer: Answer = field(kw_only=True)

    def say(self, line: str) -> None:
        """Print a remark."""
        self.answer.say(line)

    @contextmanager
    def working(self, what: str, total: int | None = None) -> Iterator[Work]:
        """Show work on something."""
        with progress(stays=total is not None) as bars:
            yield _Bar(bars, bars.add_task(what, total=total))


@dataclass(frozen=True)
class _Bar:
    bars: Bars
    task: TaskID

    def done(self, count: int, total: int | None = None) -> None:
        self.bars.update(self.task, completed=count, total=total)

    def then(self, what: str) -> None:
        self.bars.add_task(what, total=None)
