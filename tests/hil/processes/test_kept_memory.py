"""Memory that is given back is taken again without the kernel."""

from __future__ import annotations

import ctypes
import subprocess
import sys

import pytest

TAKEN = """
import ctypes
import resource
import numpy as np
from hil.processes.kept_memory import keep_memory
ctypes.CDLL(None).prctl(41, 1, 0, 0, 0)  # PR_SET_THP_DISABLE: of huge pages few would do
if {keep}:
    keep_memory()
for _ in range(3):
    np.ones(5_000_000)  # 40 MB
began = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
for _ in range(50):
    np.ones(5_000_000).sum()
print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - began)
"""


def faults(keep: bool) -> int:
    """Pages that the kernel hands to fifty arrays of 40 MB, one after another."""
    command = [sys.executable, "-c", TAKEN.format(keep=keep)]
    return int(subprocess.run(command, capture_output=True, text=True, check=True).stdout)


def takes_any_size() -> bool:
    """Asked of another process: what it takes stays."""
    command = [sys.executable, "-c", "import ctypes; raise SystemExit(1 - ctypes.CDLL(None).mallopt(-3, 1 << 30))"]
    return subprocess.run(command, check=False).returncode == 0


@pytest.mark.slow
@pytest.mark.skipif(not sys.platform.startswith("linux") or not hasattr(ctypes.CDLL(None), "mallopt"), reason="of glibc")
def test_an_array_that_is_given_back_costs_the_next_one_no_pages() -> None:
    pages = 50 * 40_000_000 // 4096
    assert faults(keep=False) > 0.5 * pages
    if not takes_any_size():
        pytest.skip("the C library keeps no arrays of more than 32 MB")
    assert faults(keep=True) < 0.01 * pages
