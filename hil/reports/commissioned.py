"""The page of `isocenter commission`: whether the machine is commissioned, what each step found, and what to do next."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from hil.machine import Machine
from hil.pages import Page, Section, Table, Verdict
from hil.pages.contents import Kind
from hil.reports.made_from import files_fact, machine_fact

StepLine = tuple[str, bool, Sequence[str], Sequence[Path]]
"""A step: its name, whether it has passed, what it found, and the files it left."""


def commissioned_page(
    machine: Machine, verdict: Verdict, steps: Sequence[StepLine], next_command: tuple[str, str], folder: Path, emulated: bool
) -> Page:
    """Return the page of a commissioning; the next command comes with what it brings."""
    rows = [(name, "\n".join(said), "\n".join(path.name for path in files)) for name, _, said, files in steps]
    kinds: list[Kind] = ["good" if ok else "bad" for _, ok, _, _ in steps]
    recordings = [path for _, _, _, files in steps for path in files]
    return Page(
        f"Commissioning of {machine.name}",
        verdict,
        [Section("Step by step", [Table(("step", "what was found", "files"), rows, kinds=kinds)])],
        *next_command,
        facts={"Machine": machine_fact(machine), "Files": files_fact(recordings), "Folder": str(folder)},
        is_emulated=emulated,
    )
