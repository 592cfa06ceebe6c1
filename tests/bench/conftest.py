"""The command line as a fixture."""

from __future__ import annotations

import pytest
from command_line import Isocenter, runner


@pytest.fixture
def isocenter(capsys: pytest.CaptureFixture[str]) -> Isocenter:
    return runner(capsys)
