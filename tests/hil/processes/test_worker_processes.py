"""What works for a process ends with it, killed or not."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path

import pytest

POOL = """
import multiprocessing, sys
from concurrent.futures import ProcessPoolExecutor
from hil.processes.workers import end_with_the_parent

if __name__ == "__main__":
    with ProcessPoolExecutor(2, multiprocessing.get_context(sys.argv[1]), end_with_the_parent) as pool:
        print(*pool.map(abs, [-3, -4]), flush=True)
        sys.stdin.read()
"""


@pytest.mark.skipif(sys.platform == "win32", reason="no SIGKILL")
@pytest.mark.parametrize("method", ["fork", "spawn"])
def test_workers_of_a_process_that_was_killed_end(method: str, tmp_path: Path) -> None:
    """They hold its output open while they live."""
    script = tmp_path / "pool.py"
    script.write_text(POOL)
    with subprocess.Popen([sys.executable, str(script), method], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as pool:
        assert pool.stdout.readline().split() == ["3", "4"]
        pool.send_signal(signal.SIGKILL)
        out, _ = pool.communicate(timeout=60.0)
    assert out == ""
