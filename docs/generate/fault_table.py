"""The page of what became of every fault on the C-arm, from benchmarks/results/faults_carm.json."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from docs.generate.markdown import code, table
from docs.generate.markdown import page as whole

FILE = Path(__file__).resolve().parents[2] / "benchmarks" / "results" / "faults_carm.json"

INTRODUCTION = """
Every fault of the [catalogue](faults.md), injected into the emulated C-arm in a run of its own while {axis} sweeps at
{speed:.2f} {unit}/s: {count} rows. Time and travel of {axis} count from the fault to rest. *Stopped*: the run ended with an
error and every axis is at rest. *Noted*: the run went on and said what it found. *Unnoticed*: it ended as if nothing had
been. *Cannot be held*: brake and drive are both lost, which was said at once.
"""


def page(file: Path = FILE) -> str:
    """Write the page; without results it says only that there are none."""
    if not file.exists():
        return whole("Faults on the C-arm", "There are no results.")
    found = json.loads(file.read_text(encoding="utf-8"))
    introduction = INTRODUCTION.format(axis=found["axis"], speed=found["speed"], unit=found["unit"], count=found["faults"])
    head = ["fault", "verdict", "rest [s]", f"travel [{found['unit']}]", "held at the end by", "said"]
    return whole("Faults on the C-arm", introduction, table(head, [_cells(row) for row in found["rows"]]))


def _cells(row: dict[str, Any]) -> list[str]:
    numbers = ["" if row[key] is None else f"{row[key]:.{digits}f}" for key, digits in (("rest_s", 2), ("travel", 3))]
    return [code(row["name"]), row["verdict"], *numbers, row["ending"].removeprefix("held by "), code(row["said"].replace("`", "'"))]
