"""What a check is: a group, words, the clause that asks for it, and a function that passes, fails or is skipped."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from hil.conform.wire import Frame

CIA_301 = "CiA 301, "
PASSED, FAILED, SKIPPED = "pass", "fail", "skip"


class CheckFailedError(Exception):
    """The node did not do what the clause asks for; never leaves this room."""

    def __init__(self, expected: str, frames: Sequence[Frame] = ()) -> None:
        super().__init__(expected)
        self.expected, self.frames = expected, tuple(frames)


class CheckSkippedError(Exception):
    """The check cannot be made on this node, and why; never leaves this room."""


@dataclass(frozen=True)
class Check:
    """One check, or, with `of`, one for each of the things that it returns; then `words` has their place."""

    group: str
    words: str
    clause: str
    run: Callable[..., None]
    of: Callable[..., Iterable[Any]] | None = None
    writes: bool = False


@dataclass(frozen=True)
class Result:
    """What became of a check."""

    group: str
    check: str
    clause: str
    result: str
    expected: str = ""
    reason: str = ""
    frames: tuple[Frame, ...] = field(default=())


class Checks:
    """The checks of one file, in their order."""

    def __init__(self, group: str) -> None:
        self.group = group
        self.all: list[Check] = []

    def check(
        self, words: str, clause: str, *, of: Callable[..., Iterable[Any]] | None = None, writes: bool = False
    ) -> Callable[[Callable[..., None]], Callable[..., None]]:
        """Declare a check.

        Parameters
        ----------
        words : str
            What is right; `{}` stands for each of `of`.
        clause : str
            Of CiA 301, unless it names another document.
        of : callable, optional
            What of the device is checked one by one.
        writes : bool
            It alters stored or application parameters, so it is made only when asked for.
        """

        def declare(run: Callable[..., None]) -> Callable[..., None]:
            named = clause if clause.startswith("CiA") else CIA_301 + clause
            self.all.append(Check(self.group, words, named, run, of, writes))
            return run

        return declare
