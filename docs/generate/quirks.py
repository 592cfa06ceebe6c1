"""The page of quirks: what drives do that the standard does not have, and what becomes of a C-arm with each."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from docs.generate.markdown import block, code, table
from docs.generate.markdown import page as whole
from virtual_bus.quirks.quirk import Quirk
from virtual_bus.quirks.registry import quirks

FILE = Path(__file__).resolve().parents[2] / "benchmarks" / "results" / "quirks_carm.json"
WAYS = {"torque": "torque mode", "velocity": "velocity mode", "search": "homing at a switch"}

INTRODUCTION = """
Drives bend CiA 301 and CiA 402 in ways that their users report. Each *quirk* of this page is one such way, put on a drive of
the emulated machine from power-on, to see beforehand what a bench does with it. The link is the report, the manual or the
maintainer's answer.
"""

OUTCOMES = """
`python benchmarks/quirks.py` brought the C-arm up with each quirk on roll's drive, homed, ran and stopped it: in torque mode, homed
where it stands; in velocity mode, homed at a limit switch; where units and modes matter also for a run in velocity mode. *Carried*: as
with a drive of the standard. *Refused*: it ended with the words of the last column and every axis at rest. {counts}.
"""


def page(file: Path = FILE) -> str:
    """Write the page."""
    found: dict[str, Any] = json.loads(file.read_text(encoding="utf-8")) if file.exists() else {"rows": {}, "verdicts": {}}
    counts = "Trials: " + ", ".join(f"{count} {verdict}" for verdict, count in sorted(found["verdicts"].items()))
    parts = [
        INTRODUCTION,
        "## Put on a quirk",
        block(
            "isocenter faults quirks\n"
            "isocenter run scan -m carm -b lockstep: --axis roll --from 15 --to -15 --speed 23 --quirk roll_drive:sdo_late -o run.mf4\n"
            "isocenter emulate carm --bus udp: --quirk roll_drive:mode_display_late --quirk propeller_drive:boot_up_twice",
            "sh",
        ),
        "## What becomes of each",
        OUTCOMES.format(counts=counts),
    ]
    for group in dict.fromkeys(quirk.group for quirk in quirks().values()):
        chosen = [quirk for quirk in quirks().values() if quirk.group == group]
        parts.append(f"### {group[0].upper()}{group[1:]}")
        parts.append(table(("quirk", "the drive", "report", "outcome", "said"), _rows(chosen, found["rows"])))
    return whole("Quirks of drives", *parts)


def _rows(chosen: list[Quirk], rows: dict[str, Any]) -> Iterator[tuple[str, ...]]:
    for quirk in chosen:
        outcomes: dict[str, dict[str, str]] = rows.get(quirk.name, {})
        verdicts: dict[str, list[str]] = {}
        for way, outcome in outcomes.items():
            verdicts.setdefault(outcome["verdict"], []).append(WAYS[way])
        told = " · ".join(verdict if len(verdicts) == 1 else f"{', '.join(ways)}: {verdict}" for verdict, ways in verdicts.items())
        words = dict.fromkeys(outcome["said"] for outcome in outcomes.values() if outcome["said"])
        said = " · ".join(code(each.replace("`", "'")) for each in words)
        yield code(quirk.name), quirk.does, f"[{where(quirk.source)}]({quirk.source})", told, said


def where(address: str) -> str:
    """Return the repository and number of an issue, or the host of a manual."""
    parts = address.removeprefix("https://").split("/")
    return f"{parts[2]} #{parts[4]}" if parts[0] == "github.com" else parts[0].removeprefix("www.")
