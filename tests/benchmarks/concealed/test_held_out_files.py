"""The tool's files are simulated under the controllers of the held-out recording, which may be softer than the machine file's."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pytest
from places import BENCHMARKS

from hil.machine.load import machine_from_text

FILES = sorted((BENCHMARKS / "concealed" / "machines").glob("*.toml"))


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.stem)
def test_controllers_are_those_of_the_recording_and_all_else_is_the_tools(file: Path) -> None:
    from concealed.running import with_controllers_of

    nominal = file.read_text(encoding="utf-8")
    tuned = re.sub(r"(?m)^mass_kg = ([\d.]+)", lambda match: f"mass_kg = {1.05 * float(match[1])!r}", nominal)
    gains = re.compile(r"(position_sections = \[\n    \[)([\d.]+)")
    softer = gains.sub(lambda match: f"{match[1]}{0.75 * float(match[2])!r}", nominal)
    text = with_controllers_of(softer, tuned)
    found = tomllib.loads(text)
    has_controllers = "controller" in tomllib.loads(nominal)
    assert (softer != nominal) == has_controllers
    assert tuned != nominal
    assert found.pop("controller", None) == tomllib.loads(softer).get("controller")
    assert found == {key: value for key, value in tomllib.loads(tuned).items() if key != "controller"}
    machine_from_text(text, file)  # it loads
