"""The page *What is wrong with my axis?*, from docs/examples/wrong_axis and what the product's commands answered."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path
from typing import Any

from docs.generate.markdown import block, table
from docs.generate.markdown import page as whole

ROOT = Path(__file__).resolve().parents[2]
CASES = ROOT / "docs" / "examples" / "wrong_axis" / "cases.toml"
RESULTS = ROOT / "benchmarks" / "results" / "wrong_axis.json"
FIGURE = "../figures/wrong_axis.svg"

INTRODUCTION = """
Ten questions that people have asked in public about a motor or a joint, each made into an emulated recording whose answer is
known: what one sees, which command to ask, and what it answers, right or wrong. The link is the question.
"""

RECORDED = """
Every case is a turntable that has what its machine file lacks. It is recorded as in [Find what a simulation leaves
out](../tutorials/find-missing-physics.md), and asked in the same words each time:
"""

PICTURE = """
Each panel draws, against the angle, the command, or by how much the link encoder is ahead of the motor's: the axis of the
question (blue) over a sound one (grey).
"""


def page(cases: Path = CASES, results: Path = RESULTS) -> str:
    """Write the page."""
    asked = tomllib.loads(cases.read_text(encoding="utf-8"))["case"]
    rows = json.loads(results.read_text(encoding="utf-8"))["cases"] if results.exists() else []
    answers = {row["name"]: row for row in rows}
    jog = "isocenter run jog -m turntable -b lockstep: --effects hidden.toml"
    record = "\n".join(
        [
            f"for n in 1 2 3; do {jog} --amplitude 3.4 --period 10 --periods 1 --seed $n -o r$n.mf4; done",
            f"{jog} --amplitude 2.6 --period 8 --periods 1 --seed 11 -o held-out.mf4",
            "isocenter diagnose turntable r1.mf4 r2.mf4 r3.mf4 --held-out held-out.mf4 -o found",
        ]
    )
    parts = [INTRODUCTION, RECORDED, block(record, "sh"), PICTURE, f"![The symptoms of ten cases]({FIGURE})"]
    parts.append(table(("question", "it was", "the answer"), [_row(case, answers.get(case["name"])) for case in asked]))
    for case in asked:
        if (answer := answers.get(case["name"])) is not None:
            parts += [f"## {_title(case)}", _text(case), block(answer["said"], "text"), _judgement(case, answer)]
    return whole("What is wrong with my axis?", *parts)


def _title(case: dict[str, Any]) -> str:
    words = str(case["name"]).replace("_", " ")
    return words[0].upper() + words[1:]


def _row(case: dict[str, Any], answer: dict[str, Any] | None) -> tuple[str, ...]:
    judged = "not asked" if answer is None else _judgement(case, answer)
    return f"[{case['question']}]({case['source']})", f"`{case['hidden']['name']}`", judged


def _text(case: dict[str, Any]) -> str:
    numbers = ", ".join(f"`{key}` = {value:g}" for key, value in case["hidden"].items() if key not in ("name", "at"))
    return (
        f"*{case['question']}* ([asked here]({case['source']})) {case['symptom']} Hidden: "
        f"[`{case['hidden']['name']}`](effects.md) at `{case['hidden']['at']}`, {numbers}."
    )


def _judgement(case: dict[str, Any], answer: dict[str, Any]) -> str:
    """Return whether the answer is right, in words."""
    named, true = answer["named"], case["hidden"]["name"]
    if not named:
        return "Nothing was named."
    others = [f"`{name}`" for name in named if name != true]
    if true not in named:
        return f"Wrong: {', '.join(others)} instead of `{true}`."
    return "Right." if not others else f"Right, with {', '.join(others)} beside it."
