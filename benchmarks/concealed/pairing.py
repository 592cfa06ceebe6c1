"""Two tools on the same cases: what one answers and the other does not, and whether chance would do that."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from scipy.stats import binomtest

from concealed.judging import Judgement, judge
from concealed.making import Places, seal
from concealed.tables import table

QUESTIONS: tuple[tuple[str, Callable[[Judgement], bool], Callable[[Judgement], bool]], ...] = (
    ("no alarm, nothing hidden", lambda each: each.stratum == "null", lambda each: each.answered and not each.alarm),
    ("right, single effects the oracle separates", lambda each: each.stratum == "single" and each.asked, lambda each: each.right),
    ("among three, the same", lambda each: each.stratum == "single" and each.asked, lambda each: each.among_three),
    ("right, pairs the oracle separates", lambda each: each.stratum == "pair" and each.asked, lambda each: each.right),
    ("among three, the same", lambda each: each.stratum == "pair" and each.asked, lambda each: each.among_three),
    ("not confidently wrong, something hidden", lambda each: each.stratum in ("single", "pair"), lambda each: not each.wrong),
    ("alarm, off the catalogue", lambda each: each.stratum == "off" and each.asked, lambda each: each.alarm),
    ("not confidently misnamed, off the catalogue", lambda each: each.stratum == "off" and each.asked, lambda each: not each.confident),
)
"""A question, the cases that it is asked of, and what answers it well."""


def pair(places: Places, first: Path, second: Path, results: Path) -> str:
    """Judge two files of answers on the cases that both have; write `paired_SEEDS.json` and return its table as text.

    McNemar's exact test: of the cases where one tool alone answers well, either is as likely by chance.
    """
    answers = [_answers(path) for path in (first, second)]
    numbers = sorted(set(answers[0]) & set(answers[1]))
    judged = [tuple(_judged(places, rows[number]) for rows in answers) for number in numbers]
    rows = [_row(question, judged, asked, well) for question, asked, well in QUESTIONS]
    commits = [sorted({rows[number]["commit"] for number in numbers}) for rows in answers]
    document = {"seeds": places.seeds, "cases": numbers, "commits": commits, "questions": rows}
    (results / f"paired_{places.seeds}.json").write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
    return table_of(document)


def table_of(document: dict[str, Any]) -> str:
    """The table of what `pair` wrote, in Markdown."""
    heads = ("question", "cases", "well by both", "earlier alone", "today alone", "by neither", "p by chance")
    keys = ("question", "n", "both", "first alone", "second alone", "neither")
    return table(heads, [(*(row[key] for key in keys), f"{row['p']:.2g}") for row in document["questions"]])


def _answers(path: Path) -> dict[int, dict[str, Any]]:
    try:
        return {row["number"]: row for row in map(json.loads, path.read_text(encoding="utf-8").splitlines())}
    except (OSError, ValueError, KeyError) as error:
        raise SystemExit(f"{path}: no file of answers as `run` writes it ({type(error).__name__}: {error})") from None


def _judged(places: Places, answer: dict[str, Any]) -> Judgement:
    path = places.truth(answer["number"])
    if not path.exists() or seal(path) != answer["truth_sha256"]:
        raise SystemExit(f"{path}: the truth that was sealed when case {answer['number']} was answered is not here")
    return judge(answer, json.loads(path.read_text(encoding="utf-8")))


def _row(
    question: str,
    judged: Sequence[tuple[Judgement, ...]],
    asked: Callable[[Judgement], bool],
    well: Callable[[Judgement], bool],
) -> dict[str, Any]:
    both = [(well(first), well(second)) for first, second in judged if asked(first)]
    first, second = both.count((True, False)), both.count((False, True))
    return {
        "question": question,
        "n": len(both),
        "both": both.count((True, True)),
        "first alone": first,
        "second alone": second,
        "neither": both.count((False, False)),
        "p": float(binomtest(first, first + second).pvalue) if first + second else 1.0,
    }
