"""The tool's command in processes that begin with its modules: they are forked from one that has imported them and nothing else, so that
no case waits for a start of Python and no case sees another one's state.
"""

from __future__ import annotations

import multiprocessing
import os
import sys
import tempfile
import time
from dataclasses import dataclass
from functools import cache
from multiprocessing.context import ForkServerContext
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]

MODULES = ("hil.cli.register", "hil.cli.diagnose", "hil.diagnosis.diagnose", "hil.diagnosis.files")
"""With what these import, all that a diagnosis needs; a name that is none would be passed over without a word."""

OTHER_TOOL, SERVER_LOST = 254, 255
"""Exit statuses that are no command's: the modules are another checkout's, and what processes are forked from has ended."""


@dataclass(frozen=True)
class Done:
    """How a command ended: its exit status, None where it was stopped by the time limit, below zero by a signal; its standard error; and
    how long it took.
    """

    exit_status: int | None
    said: str
    seconds: float


@cache
def context() -> ForkServerContext:
    """Processes that have the tool's modules. There are none where processes cannot fork."""
    found = multiprocessing.get_context("forkserver")
    found.set_forkserver_preload(list(MODULES))
    return found


def isocenter(*arguments: str, limit_s: float | None = None) -> Done:
    """Run `isocenter ARGUMENTS`, without its standard output.

    Raises
    ------
    ChildProcessError
        The command was not run.
    """
    with tempfile.TemporaryDirectory() as folder:
        said = Path(folder) / "said"
        process = context().Process(target=_command, args=(arguments, said))
        process.start()
        begun = time.monotonic()  # the modules are there
        try:
            process.join(limit_s)
            status = process.exitcode
        finally:
            process.kill()
            process.join()
        done = Done(status, said.read_text(encoding="utf-8", errors="replace") if said.exists() else "", time.monotonic() - begun)
    if status in (OTHER_TOOL, SERVER_LOST):
        raise ChildProcessError(done.said or "the process with the tool's modules has ended: run the benchmark again")
    return done


def _command(arguments: tuple[str, ...], said: Path) -> None:
    for path, stream in ((os.devnull, 1), (said, 2)):
        opened = os.open(path, os.O_WRONLY | os.O_CREAT, 0o600)
        os.dup2(opened, stream)
        os.close(opened)
    sys.argv = ["isocenter", *arguments]
    sys.path[:] = [folder for folder in sys.path if Path(folder).resolve() != ROOT / "benchmarks"]

    import hil
    from hil.cli import main

    if Path(hil.__file__).resolve().parents[1] != ROOT:
        print(f"{hil.__file__} is not of {ROOT}: run the benchmark in that folder", file=sys.stderr)
        sys.exit(OTHER_TOOL)
    main(list(arguments))
