"""What the page for the safety engineer says of a fault is what the kept table of faults says of it."""

from __future__ import annotations

import json
import re

import pytest
from places import ROOT

PAGE = (ROOT / "docs" / "explanation" / "safety.md").read_text(encoding="utf-8")
TABLE = json.loads((ROOT / "benchmarks" / "results" / "faults_carm.json").read_text(encoding="utf-8"))
KEPT = {row["name"]: row for row in TABLE["rows"]}
LINES = [line.split("|")[1:-1] for line in PAGE.splitlines() if line.startswith("| ") and "`" in line]
SHOWN = [(part.strip(), name) for part, _, shown in LINES for name in re.findall(r"`([\w/=.-]+)`", shown)]


def test_every_part_of_the_bench_has_a_fault() -> None:
    assert {part for part, _ in SHOWN} >= {"drive", "I/O device", "supervisor", "loop", "none"}


@pytest.mark.parametrize(("part", "name"), SHOWN)
def test_a_fault_on_the_page_ended_as_the_page_says(part: str, name: str) -> None:
    row = KEPT[name]
    assert row["verdict"] == ("cannot be held" if part == "none" else "stopped")
    assert part == "none" or row["ending"].startswith("held")
    assert part != "none" or row["said"].startswith("KEEP AWAY")
    assert row["contradicted"] == []


def test_all_processes_killed_at_once_leave_the_arm_at_rest_within_the_time_on_the_page() -> None:
    killed = json.loads((ROOT / "benchmarks" / "results" / "killed_together.json").read_text(encoding="utf-8"))
    row = killed["rows"]["loop, poller, recorder, supervisor"]
    speed, time_s = re.search(r"killed at ([\d.]+) rad/s.*?within ([\d.]+) s", PAGE, re.DOTALL).groups()  # type: ignore[union-attr]
    assert row["at_rest"]
    assert killed["speed_rad_s"] == float(speed)
    assert 0.9 * float(time_s) < row["rest_s"] < float(time_s)
