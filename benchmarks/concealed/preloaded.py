"""The tool's command in processes that begin with its modules: they are forked from one that has imported them and nothing else, so that
no case waits for a start of Python and no case sees another one's state.
"""

from __future__ import annotations

import multiprocessing
import os
import tempfile
from dataclasses import dataclass
from pathlib import Path

MODULES = ["hil.cli.register", "hil.cli.diagnose", "hil.diagnosis.diagnose", "hil.diagnosis.files"]

_CONTEXT = multiprocessing.get_context("forkserver")
_CONTEXT.set_forkserver_preload(MODULES)


@dataclass(frozen=True)
class Done:
    """How a command ended: its exit status, None where it was stopped by the time limit, below zero by a signal; and its standard error."""

    exit_status: int | None
    said: str


def isocenter(*arguments: str, limit_s: float | None = None) -> Done:
    """Run `isocenter ARGUMENTS`, without its standard output."""
    with tempfile.TemporaryDirectory() as folder:
        said = Path(folder) / "said"
        process = _CONTEXT.Process(target=_command, args=(arguments, said))
        process.start()
        process.join(limit_s)
        status = process.exitcode
        if status is None:
            process.kill()
            process.join()
        return Done(status, said.read_text(encoding="utf-8", errors="replace") if said.exists() else "")


def _command(arguments: tuple[str, ...], said: Path) -> None:
    from hil.cli import main

    for path, stream in ((os.devnull, 1), (said, 2)):
        opened = os.open(path, os.O_WRONLY | os.O_CREAT, 0o600)
        os.dup2(opened, stream)
        os.close(opened)
    main(list(arguments))
