"""The tests in `inside/` run over a real vcan0 and are started by test_vcan.py, in place or in a user-mode kernel; nobody else collects them."""

from __future__ import annotations

import os

import pytest

NOT_PROVEN = pytest.StashKey[str]()

if os.environ.get("ISOCENTER_VCAN") is None:
    collect_ignore = ["inside"]


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
    """One line about what a run without vcan left unproven."""
    line = config.stash.get(NOT_PROVEN, "")
    if line:
        terminalreporter.write_line(line, yellow=True)
