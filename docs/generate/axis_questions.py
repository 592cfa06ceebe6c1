"""The page "What is wrong with my axis?": symptom, plot, commands and answer of ten questions, from benchmarks/results."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from docs.generate.markdown import block
from docs.generate.markdown import page as whole
from docs.generate.quirks import where

FILE = Path(__file__).resolve().parents[2] / "benchmarks" / "results" / "axis_questions.json"

INTRODUCTION = """
Ten questions that people ask of motors and joints, each of the kind of a public report (the link). Here the axis is the shipped
turntable, emulated, and the file `truth.toml` is what it has beside its machine file, so the right answer is known. Three repeats of a
sinusoidal *jog* are recorded, and a fourth recording of another motion is held out. The plots show the first recording and what the
machine file alone makes of the same reference: look for the shape of the difference. The answer is what `diagnose` printed, right or not.
`geared.toml` is the turntable with a gear that gives way between motor and table (200 kNm/rad).
`python benchmarks/axis_questions.py --work WORK` makes all of it again, these files too.
"""


def page(file: Path = FILE) -> str:
    """Write the page."""
    found: dict[str, dict[str, Any]] = json.loads(file.read_text(encoding="utf-8")) if file.exists() else {}
    parts = [INTRODUCTION]
    for name, each in found.items():
        first, *_, simulation, diagnosis = each["commands"]
        repeated = "# again with --seed 2, 3: r2.mf4, r3.mf4; another amplitude and period: held-out.mf4"
        parts += [
            f"## {each['asks']}",
            f"[{where(each['source'])}]({each['source']}). What the emulated axis has:",
            block(each["truth"], "toml"),
            f"```{{figure}} ../figures/axis-{name}.png\n:alt: {each['shows']}\n:width: 100%\n\n{each['shows']}.\n```",
            block("\n".join([first, repeated, simulation, diagnosis]), "sh"),
            block("\n".join(each["said"]), "text"),
        ]
    return whole("What is wrong with my axis?", *parts)
