"""Any two commits of the tool on the same cases: each is built from git, and answers what the other answers.

The cases are made once, by this tree. Machines without much to simulate come first; within them, and of the C-arm, the order is drawn by
lot, so that whatever has been answered so far is a fair sample of all.
"""

from __future__ import annotations

import json
import os
import random
import shutil
import subprocess
import sys
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from concealed.judging import Judgement, judge
from concealed.making import SHIPPED, Places, case_of, make
from concealed.running import JSON_KEPT, TIME_LIMIT_S

ROOT = Path(__file__).resolve().parents[2]
LOT = 76
"""Seed of the order of the cases."""

ROW = ("number", "commit", "machine", "colour", "exit_status", "wall_s", "processor_s", "memory_MB", "judged")


def commit_of(name: str) -> str:
    """The full commit that a name stands for.

    Raises
    ------
    SystemExit
        Git knows no such commit.
    """
    done = subprocess.run(["git", "rev-parse", "--verify", f"{name}^{{commit}}"], cwd=ROOT, capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(f"{name}: no commit of this repository; `git log --oneline` lists them")
    return done.stdout.strip()


def built(commit: str, work: Path) -> Path:
    """A checkout of the commit in `work`, made where there is none."""
    folder = work / "trees" / commit[:8]
    if not folder.exists():
        making = folder.with_name(f"{folder.name}.part")
        shutil.rmtree(making, ignore_errors=True)
        subprocess.run(["git", "clone", "-q", "--shared", "--no-checkout", str(ROOT), str(making)], check=True)
        subprocess.run(["git", "checkout", "-q", commit], cwd=making, check=True)
        making.rename(folder)
    return folder


def order(places: Places, numbers: Sequence[int], carm: int | None = None) -> list[int]:
    """The cases without the C-arm by lot, then so many of those with it (all by default)."""
    drawn = sorted(numbers)
    random.Random(LOT).shuffle(drawn)
    with_it = {number for number in drawn if case_of(places, number).machine == SHIPPED}
    return [each for each in drawn if each not in with_it] + [each for each in drawn if each in with_it][:carm]


class Answering:
    """A running server of one tree."""

    def __init__(self, tree: Path) -> None:
        environment = os.environ | {"PYTHONPATH": str(tree), "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
        server = Path(__file__).with_name("answering.py")
        self._process = subprocess.Popen(
            [sys.executable, "-P", str(server)], cwd=tree, env=environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        self._line()

    def _line(self) -> dict[str, Any]:
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        if not line:
            raise RuntimeError(f"the tree's process ended with status {self._process.wait()}")
        return dict(json.loads(line))

    def __call__(self, *arguments: str, limit_s: float = TIME_LIMIT_S) -> dict[str, Any]:
        """Run the command; its exit status is None where it took longer than the limit."""
        assert self._process.stdin is not None
        self._process.stdin.write(json.dumps({"arguments": arguments, "limit_s": limit_s}) + "\n")
        self._process.stdin.flush()
        return self._line()

    def close(self) -> None:
        """End the server."""
        assert self._process.stdin is not None
        self._process.stdin.close()
        self._process.wait()


_servers: dict[Path, Answering] = {}


def answer(places: Places, commits: tuple[str, ...], answered: dict[str, frozenset[int]], number: int) -> list[dict[str, Any]]:
    """The case's answers by the trees that have not answered it: a row each, judged by its truth."""
    make(places, number)
    case, drawn = places.case(number), case_of(places, number)
    truth = json.loads(places.truth(number).read_text(encoding="utf-8"))
    rows = []
    for commit in commits:
        if number in answered[commit]:
            continue
        tree, out = built(commit, places.work), places.work / "answers" / commit[:8] / f"{number}"
        if tree not in _servers:
            _servers[tree] = Answering(tree)
        shutil.rmtree(out, ignore_errors=True)
        out.mkdir(parents=True)
        runs = sorted(str(path) for path in case.glob("run_*.csv"))
        held_out = str(case / "held_out.csv")
        done = _servers[tree]("diagnose", str(case / "machine.toml"), *runs, "--held-out", held_out, "-o", str(out), "--jobs", "1")
        row = {"number": number, "commit": commit, "machine": drawn.machine, "colour": drawn.colour, **done}
        written = out / "diagnosis.json"
        if written.exists():
            found = json.loads(written.read_text(encoding="utf-8"))
            row["diagnosis"] = {key: found[key] for key in JSON_KEPT if key in found}
        row["judged"] = asdict(judge(row, truth))
        for path in out.iterdir():
            if path.name not in ("diagnosis.json", "effects.toml", "machine.toml"):
                path.unlink() if path.is_file() else shutil.rmtree(path)
        rows.append(row)
    return rows


def kept(results: Path, commit: str) -> Path:
    """Where a commit's judged answers are kept."""
    return results / f"answers_{commit[:8]}.jsonl"


def answers(results: Path, commit: str) -> dict[int, dict[str, Any]]:
    """By case, the answers of a commit."""
    path = kept(results, commit)
    lines = path.read_text(encoding="utf-8").splitlines() if path.exists() else []
    return {row["number"]: row for row in map(json.loads, lines)}


def in_short(row: dict[str, Any]) -> dict[str, Any]:
    """A row as it is kept in the results: how the command ended and what the judge says; the whole answer stays in the work folder."""
    short = {key: row[key] for key in ROW if key in row}
    judged = {
        key: round(value, 3) if isinstance(value, float) else value
        for key, value in row["judged"].items()
        if key not in ("number", "machine", "seconds", "overlap") and value not in (None, (), [], {})
    }
    return short | {"judged": judged, "commit": row["commit"][:8]}


def judged(row: dict[str, Any]) -> Judgement:
    """The judgement of a kept row."""
    empty = {"kinds": (), "findings": (), "covered": (), "channel_right": None, "overlap": {}, "removed": None}
    empty |= {"removed_by_its_own_word": None, "number": row["number"], "machine": row["machine"], "seconds": row["wall_s"]}
    return Judgement(**{**empty, **row["judged"]})


def both(results: Path, commits: tuple[str, str]) -> Iterator[tuple[dict[str, Any], dict[str, Any]]]:
    """The rows of the cases that both have answered."""
    first, second = (answers(results, commit) for commit in commits)
    for number in sorted(set(first) & set(second)):
        yield first[number], second[number]
