"""Memory that is given back is taken again without the kernel."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

TAKEN = """
import resource
import numpy as np
from hil.diagnosis.kept_memory import keep_memory
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
    """Pages that the kernel hands to fifty arrays of 40 MB, one after another; huge ones are off, of which few would do."""
    small_pages = {**os.environ, "NUMPY_MADVISE_HUGEPAGE": "0"}
    command = [sys.executable, "-c", TAKEN.format(keep=keep)]
    return int(subprocess.run(command, capture_output=True, text=True, check=True, env=small_pages).stdout)


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="of glibc")
def test_an_array_that_is_given_back_costs_the_next_one_no_pages():
    pages = 50 * 40_000_000 // 4096
    assert faults(keep=False) > 0.5 * pages
    assert faults(keep=True) < 0.01 * pages
