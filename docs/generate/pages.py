"""The generated pages by name, and how those on disk differ from them."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from docs.generate import (
    axis_questions,
    both_machines,
    command_line,
    effects,
    examples,
    fault_table,
    faults,
    file_formats,
    json_answers,
    machine_file,
    machine_schema,
    quirks,
    results,
    thesis_map,
)
from hil.machine.editors import SCHEMA

ROOT = Path(__file__).resolve().parents[2]
GENERATED = ROOT / "docs" / "generated"

GENERATORS = {
    "axis-questions.md": axis_questions.page,
    "both-machines.md": both_machines.page,
    "command-line.md": command_line.page,
    "effects.md": effects.page,
    "examples.md": examples.page,
    "fault-table.md": fault_table.page,
    "faults.md": faults.page,
    "file-formats.md": file_formats.page,
    "json.md": json_answers.page,
    "machine-file.md": machine_file.page,
    Path("..", "..", SCHEMA.relative_to(ROOT)).as_posix(): machine_schema.page,
    "quirks.md": quirks.page,
    "results.md": results.page,
    "thesis-map.md": thesis_map.page,
}
"""File name of a page, from their folder, and the function that writes its text. The schema stands in the package: a wheel has it, too."""


def pages() -> dict[str, str]:
    """Make every page: file name to text."""
    return {name: make() for name, make in GENERATORS.items()}


def differences(wanted: Mapping[str, str], folder: Path = GENERATED) -> list[str]:
    """List the pages of a folder that are stale, missing or orphaned, one line each."""
    found = {name: folder / name for name in wanted if (folder / name).exists()}
    lines = [f"missing: {folder.name}/{name}" for name in wanted if name not in found]
    lines += [f"orphaned: {folder.name}/{path.name}" for path in folder.glob("*.md") if path.name not in wanted]
    lines += [
        f"stale: {folder.name}/{name}" for name, text in wanted.items() if name in found and found[name].read_text(encoding="utf-8") != text
    ]
    return sorted(lines)
