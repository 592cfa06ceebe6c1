"""The supervisor's process is a safety device: it starts without a compiler, and nothing in it waits for one."""

from __future__ import annotations

import subprocess
import sys


def test_the_process_imports_no_compiler() -> None:
    asked = "import sys, drivers.supervisor.process; print('numba' in sys.modules, 'llvmlite' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", asked], capture_output=True, text=True, timeout=60, check=True)
    assert done.stdout.split() == ["False", "False"]
