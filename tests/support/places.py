"""Where things lie that tests read: this repository, and what may lie beside it."""

from __future__ import annotations

from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
"""This checkout."""

SUPPORT = Path(__file__).parent
"""Modules that tests of several folders use."""

BENCHMARKS = ROOT / "benchmarks"
CONCEALED_MACHINES = BENCHMARKS / "concealed" / "machines"
EDS_FILES = ROOT / "drivers" / "canopen" / "eds_files"

DATA = ROOT.parent / "shared" / "data"
"""Recordings and device files of others, read in place."""


def needs_data(folder: str, what: str) -> pytest.MarkDecorator:
    """Skip a test, saying so, where a folder of `DATA` is absent.

    Parameters
    ----------
    folder : str
        Below `DATA`.
    what : str
        What would be in it, for the reason.
    """
    return pytest.mark.skipif(not (DATA / folder).exists(), reason=f"{what} not beside the repository (../shared/data/{folder})")
