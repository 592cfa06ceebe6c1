"""The tests in `inside/` run over a real vcan0. Only test_vcan.py starts them, in place or in a user-mode kernel."""

from __future__ import annotations

import os

import pytest

if os.environ.get("ISOCENTER_VCAN") is None:
    collect_ignore = ["inside"]


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """One line about what a run without vcan left unproven; some about what was measured of a run with it."""
    for report in terminalreporter.stats.get("skipped", []):
        reason = report.longrepr[2] if isinstance(report.longrepr, tuple) else ""
        if "not proven:" in reason:
            terminalreporter.write_line(reason.removeprefix("Skipped: "), yellow=True)
    for report in terminalreporter.getreports("passed"):
        for name, line in report.user_properties:
            if name == "over vcan0":
                terminalreporter.write_line(f"{name} {line}")
