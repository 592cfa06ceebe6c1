"""The tool's files are simulated under the controllers of the held-out recording, which may be softer than the machine file's."""

from __future__ import annotations

import re
import tomllib

import pytest
from conftest import BENCHMARKS

FILES = sorted((BENCHMARKS / "concealed" / "machines").glob("*.toml"))


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.stem)
def test_all_controllers_are_those_of_the_recording(file):
    from concealed.running import _with_controllers_of

    tuned = file.read_text(encoding="utf-8")
    numbers = re.compile(r"(position_sections = \[\n    \[)([\d.]+)")
    softer = numbers.sub(lambda match: f"{match[1]}{0.75 * float(match[2])!r}", tuned)
    parsed = tomllib.loads(tuned).get("controller", {})
    in_rows = re.compile(r"^position_sections = \[$.*?^\]$", re.DOTALL | re.MULTILINE)
    on_a_line = in_rows.sub(lambda match: f"position_sections = {tomllib.loads(match[0])['position_sections']}", tuned)
    found = tomllib.loads(_with_controllers_of(softer, tuned))
    assert found == tomllib.loads(softer)
    assert tomllib.loads(_with_controllers_of(softer, on_a_line)) == tomllib.loads(softer)
    assert (found != tomllib.loads(tuned)) == bool(parsed)
