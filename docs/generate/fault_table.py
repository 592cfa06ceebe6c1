"""The page of what became of every fault on the C-arm, from benchmarks/results/faults_carm.json."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

from docs.generate.markdown import code, table
from docs.generate.markdown import page as whole

FILE = Path(__file__).resolve().parents[2] / "benchmarks" / "results" / "faults_carm.json"

SAID = 220
"""Characters of what was said; all of it is in the results."""

INTRODUCTION = """
Every fault of the [catalogue](faults.md), injected into the emulated C-arm in a run of its own while {axis} sweeps at
{speed:.2f} {unit}/s: {count} rows. Time and travel of {axis} count from the fault to rest. *Stopped*: the run ended with an
error and every axis is at rest. *Noted*: the run went on and said what it found. *Within tolerance*: it ended as if
nothing had been, and every recorded position is that of a run without the fault, up to the tolerance of the machine file.
*Unnoticed*: it ended as if nothing had been, and is not that. *Cannot be held*: brake and drive are both lost, which was
said at once.

*Budget* is the class of the machine file's `[budgets.{axis}]` that the stop must keep, with time and travel to standstill
and what is allowed. They count from the fault. They count from the stop where tracking error or speed show the fault, travel
then with the tracking error, and where a fault shows only when the run needs what it took away. {over} rows exceed their budget.

Every sentence that a stopped run said about the machine's state is compared with the emulated machine's true motion.
{false} rows said what the truth contradicts.
"""


def page(file: Path = FILE) -> str:
    """Write the page; without results it says only that there are none."""
    if not file.exists():
        return whole("Faults on the C-arm", "There are no results.")
    found = json.loads(file.read_text(encoding="utf-8"))
    rows = found["rows"]
    over, false = sum(not _kept(row) for row in rows), sum(bool(row["contradicted"]) for row in rows)
    introduction = INTRODUCTION.format(
        axis=found["axis"], speed=found["speed"], unit=found["unit"], count=found["faults"], over=over or "No", false=false or "No"
    )
    head = ["fault", "verdict", "rest [s]", f"travel [{found['unit']}]", "budget", "held at the end by", "said"]
    return whole("Faults on the C-arm", introduction, table(head, [_cells(row) for row in found["rows"]]))


def _cells(row: dict[str, Any]) -> list[str]:
    numbers = ["" if row[key] is None else f"{row[key]:.{digits}f}" for key, digits in (("rest_s", 2), ("travel", 3))]
    return [
        code(row["name"]),
        row["verdict"],
        *numbers,
        _budget(row),
        row["ending"].removeprefix("held by "),
        code(_short(row["said"]).replace("`", "'")),
    ]


def _short(said: str) -> str:
    return said if len(said) <= SAID else said[: SAID - 1] + "…"


def _kept(row: dict[str, Any]) -> bool:
    used = row["budget"]
    return used is None or all(
        _number(used[took]) <= used[allowed] for took, allowed in (("time_s", "allowed_s"), ("travel", "allowed_travel"))
    )


def _number(value: float | None) -> float:
    return math.inf if value is None else value


def _budget(row: dict[str, Any]) -> str:
    used = row["budget"]
    if used is None:
        return ""
    time_s, travel = _number(used["time_s"]), _number(used["travel"])
    took = f"{time_s:.2f} of {used['allowed_s']:g} s, {travel:.2f} of {used['allowed_travel']:.2f}"
    return f"{code(used['name'])} {'kept' if _kept(row) else 'exceeded'}: {took}"
