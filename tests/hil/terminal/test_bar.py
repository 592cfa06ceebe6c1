"""A run on the wall clock has a progress bar that another process draws, from the counter of the recorder's ring."""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from hil.recording import RecorderProcess, read_recording
from hil.terminal.bar import drawn_beside

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="a pseudo-terminal, and the list of children in /proc")

pty = pytest.importorskip("pty")

ROWS = 200


@contextlib.contextmanager
def terminal() -> Iterator[Callable[[str], str]]:
    """Standard error as a terminal's; what is shown there is read until some text has come."""
    shown, end = pty.openpty()
    kept = os.dup(2)
    os.dup2(end, 2)
    seen = b""

    def until(text: str) -> str:
        nonlocal seen
        while text.encode() not in seen:
            seen += os.read(shown, 4096)
        return seen.decode()

    try:
        yield until
    finally:
        os.dup2(kept, 2)
        for handle in (shown, end, kept):
            os.close(handle)


def put(recorder: RecorderProcess, first: int, last: int) -> None:
    for k in range(first, last):
        recorder.put(np.array([k / 256.0]))


def test_it_follows_the_rows_and_ends_with_the_run(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "100")
    with terminal() as shown, RecorderProcess(tmp_path / "run.csv", [("time", "s")], {}) as recorder:
        with drawn_beside(recorder, ROWS, "run.csv"):
            shown("run.csv")
            put(recorder, 0, ROWS // 2)
            assert "run.csv" in shown(" 50 %")
            put(recorder, ROWS // 2, ROWS)
            shown("100 %")
            drawers = [pid for pid in children() if "hil.terminal.bar" in pid[1]]
            assert len(drawers) == 1
        assert not [pid for pid in children() if "hil.terminal.bar" in pid[1]]
    assert read_recording(tmp_path / "run.csv").rows == ROWS


def children() -> list[tuple[int, str]]:
    """(process id, command line) of this process's children."""
    pids = Path(f"/proc/{os.getpid()}/task/{os.getpid()}/children").read_text().split()
    return [(int(pid), Path(f"/proc/{pid}/cmdline").read_text().replace("\0", " ")) for pid in pids]
