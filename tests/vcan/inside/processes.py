"""`isocenter` in processes of its own, forked from one that has run it already.

In a user-mode kernel starting Python and loading what is compiled takes half a minute; a fork has both at once. Emulator and loop are two
processes all the same, with nothing between them but the bus.
"""

from __future__ import annotations

import multiprocessing
import os
import sys
from dataclasses import dataclass
from multiprocessing.process import BaseProcess
from pathlib import Path

from hil.cli import main

TIMEOUT_S = 300.0


@dataclass(frozen=True)
class Done:
    """What a command left behind."""

    returncode: int
    stderr: str


@dataclass(frozen=True)
class Started:
    """A command that runs; what it prints goes to files."""

    process: BaseProcess
    errors: Path

    def wait(self) -> Done:
        """Its end, which it is helped to after `TIMEOUT_S`."""
        self.process.join(TIMEOUT_S)
        if self.process.exitcode is None:
            self.process.kill()
            self.process.join()
        code = self.process.exitcode
        assert code is not None
        return Done(code, self.errors.read_text())

    def end(self) -> None:
        """Asked to stop, as by `kill`."""
        self.process.terminate()
        self.wait()


def start(folder: Path, *arguments: str, output: int | None = None) -> Started:
    """`isocenter ARGUMENTS...` in a process of its own; it prints into `output`, a file descriptor, if there is one."""
    errors = folder / f"errors_{len(list(folder.glob('errors_*')))}"
    errors.touch()
    process = multiprocessing.get_context("fork").Process(target=_isocenter, args=(list(arguments), output, errors))
    process.start()
    return Started(process, errors)


def _isocenter(arguments: list[str], output: int | None, errors: Path) -> None:
    os.setsid()
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    os.dup2(os.open(os.devnull, os.O_WRONLY) if output is None else output, 1)
    os.dup2(os.open(errors, os.O_WRONLY), 2)
    sys.stdin, sys.stdout, sys.stderr = os.fdopen(0), os.fdopen(1, "w", buffering=1), os.fdopen(2, "w", buffering=1)
    main(arguments)


def start_until_ready(folder: Path, *arguments: str) -> tuple[Started, str]:
    """Start a command that says in one line when it is ready, and that line."""
    reader, writer = os.pipe()
    started = start(folder, *arguments, output=writer)
    os.close(writer)
    with open(reader) as said:
        line = said.readline()
    assert line, started.wait().stderr
    return started, line
