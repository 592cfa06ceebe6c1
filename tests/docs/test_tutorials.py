"""Every command of a tutorial runs, in order, in an empty folder."""

from __future__ import annotations

import contextlib
import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from places import ROOT

TUTORIALS = sorted(path.stem for path in (ROOT / "docs" / "tutorials").glob("*.md"))
BLOCK = re.compile(r"^```sh\n(.*?)^```", re.DOTALL | re.MULTILINE)
TIMEOUT_S = 1800.0


def commands_of(page: str) -> str:
    """Return the shell blocks of a page, one after the other."""
    return "\n".join(BLOCK.findall(page))


def test_there_are_tutorials_and_their_commands_are_found() -> None:
    assert len(TUTORIALS) == 3
    assert commands_of("text\n```sh\na\nb\n```\n```text\nno\n```\n```sh\nc\n```\n") == "a\nb\n\nc\n"


@pytest.mark.nightly
@pytest.mark.parametrize("name", TUTORIALS)
def test_a_tutorial_runs_from_an_empty_folder(name: str, tmp_path: Path) -> None:
    script = commands_of((ROOT / "docs" / "tutorials" / f"{name}.md").read_text(encoding="utf-8"))
    environment = os.environ | {"PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}", "PYTHONPATH": ""}
    with subprocess.Popen(
        ["bash", "-euo", "pipefail", "-c", script],
        cwd=tmp_path,
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,
    ) as shell:
        try:
            output, _ = shell.communicate(timeout=TIMEOUT_S)
        finally:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(shell.pid, signal.SIGKILL)  # what it started in the background ends with it
    assert shell.returncode == 0, output
