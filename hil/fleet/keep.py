"""Results written beside the computing: what ends while some are flushed to the disk is written next, together."""

from __future__ import annotations

import queue
import threading
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple, Self

from hil.fleet.store import remove_results, write_results


class _Result(NamedTuple):
    """What a task found, and the results that it replaces."""

    name: str
    rows: Sequence[Mapping[str, Any]]
    older: Iterable[str]


class Keeper:
    """Writes results in a thread of its own; when its block ends, all are written.

    A flush takes a disk some milliseconds, more than many a task, and as long for many files as for one.

    Raises
    ------
    RecordingError
        A result could not be written: at the next one, or at the end of the block.
    """

    def __init__(self, store: Path) -> None:
        self._store = store
        self._waiting: queue.SimpleQueue[_Result | None] = queue.SimpleQueue()
        self._problem: Exception | None = None
        self._thread = threading.Thread(target=self._write, daemon=True)

    def __enter__(self) -> Self:
        """Begin to write."""
        self._thread.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        """Write what is left."""
        self._waiting.put(None)
        self._thread.join()
        if error is None and self._problem is not None:
            raise self._problem

    def keep(self, name: str, rows: Sequence[Mapping[str, Any]], older: Iterable[str] = ()) -> None:
        """Take a task's rows, to be written under its name, after which `older` results are removed."""
        if self._problem is not None:
            raise self._problem
        self._waiting.put(_Result(name, rows, older))

    def _write(self) -> None:
        ends = False
        while not ends:
            taken = [self._waiting.get()]
            while not self._waiting.empty():
                taken.append(self._waiting.get())
            ends = None in taken
            results = [each for each in taken if each is not None]
            if results and self._problem is None:
                try:
                    write_results(self._store, {each.name: each.rows for each in results})
                    for each in results:
                        remove_results(self._store, each.older)
                except Exception as problem:
                    self._problem = problem
