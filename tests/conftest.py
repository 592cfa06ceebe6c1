"""What all tests share: small matrices on one thread. Several workers' BLAS threads spinning against each other cost a hundredfold.

Files that take longest come first, so that no worker is left alone with one of them at the end.
"""

import os
from pathlib import Path

import pytest

for _variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")

LONGEST = ("vcan", "observers", "calibration", "diagnosis", "concealed")
"""Folders, the one with the longest single file first: 4 min of a busy machine for the kernel that brings vcan."""


def _place(item: pytest.Item) -> int:
    folder = Path(item.path).relative_to(Path(__file__).parent).parts[0]
    return LONGEST.index(folder) if folder in LONGEST else len(LONGEST)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Longest folders first, in the order of collection within each."""
    items.sort(key=_place)
