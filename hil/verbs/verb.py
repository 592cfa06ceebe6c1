"""What every verb has: a request, an answer whose fields are its JSON, and a listener who hears meanwhile how far it is.

A verb is one file. Its request and its answer are frozen dataclasses, and every decision and check stands in it. The command line and
`import hil` make the request and show the answer. A verb imports its methods when it is asked, so that naming it costs nothing.
`tests/house/test_verbs.py` lists the verbs that are so; of the others the command line still decides a part.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

EMULATED = "EMULATED: "
"""How a line about an emulated machine begins."""

KEPT = {"json": False}
"""Metadata of an answer's field that is for Python, pictures and pages, and is no key of its JSON."""

RECORDING = "Recording (.mf4, .csv, .parquet, .mcap, .mat)."
EFFECTS = "Effects file (TOML): physics added by name."
POSE = "Start pose, in degrees (mm on a prismatic axis); axes left out stand at 0."
SCAN = "Folder of a scan: its images, when they were exposed, and the panel's description."


@dataclass(frozen=True)
class Option:
    """How a command line asks for a part of a request. Its words stand here alone."""

    help: str
    metavar: str | None
    """What is typed; `MM` and `MS` are read in SI, `LOW:HIGH`, `X,Y,Z` [mm], `NAME,...` and the like as several values."""
    names: tuple[str, ...] = ()
    """As they are typed; without, it is told by its place."""
    kind: type = Path
    is_needed: bool = False
    """Whether a command line must give it."""
    is_several: bool = False
    """Whether it may be given again and again."""
    least: float | None = None
    most: float | None = None
    form: str = ""
    """How its text is read, unless as its metavar says."""
    none: float | None = None
    """Number that is typed for none."""


def option(help: str, metavar: str | None, *names: str, default: object = None, **more: Any) -> Any:  # noqa: ANN401 - as `dataclasses.field`
    """Return the field of a part of a request that is an option, of the default's kind or a file unless `more` parts of `Option` say."""
    kind = Path if default in (None, ()) else type(default)
    return field(default=default, metadata={"option": Option(help, metavar, names, **{"kind": kind, **more})})


def argument(help: str, metavar: str) -> Any:  # noqa: ANN401 - as `dataclasses.field`
    """Return the field of a file, or of `metavar` that ends in `...` of several, that a command line takes by its place."""
    return field(metadata={"option": Option(help, metavar, is_needed=True, is_several=metavar.endswith("..."))})


class Work(Protocol):
    """A piece of work that a listener follows."""

    def done(self, count: int, total: int | None = None) -> None:
        """Say how much of it is done and, where that was not known at first, of how much."""

    def then(self, what: str) -> None:
        """Say what follows it, of which nobody knows how long it takes."""


@dataclass(frozen=True)
class Listener:
    """Listens to nothing but, where a function for that is given, how much is done of work whose size is known."""

    progress: Callable[[int], None] | None = None

    def say(self, line: str) -> None:
        """Hear what a user should know before the answer."""

    @contextmanager
    def working(self, what: str, total: int | None = None) -> Iterator[Work]:
        """Follow work on something for the length of the block; `total` None where nobody knows how much there is to do."""
        yield _Counted(None if total is None else self.progress)


@dataclass(frozen=True)
class _Counted:
    progress: Callable[[int], None] | None

    def done(self, count: int, total: int | None = None) -> None:
        if self.progress is not None:
            self.progress(count)

    def then(self, what: str) -> None:
        pass


NOBODY = Listener()
"""Where nobody listens."""
