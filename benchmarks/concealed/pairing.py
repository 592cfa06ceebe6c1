"""Two tools on the same cases: what one answers and the other does not, and whether chance would do that."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from scipy.stats import binomtest

from concealed.judging import Judgement
from concealed.tables import table
from concealed.trees import both, judged

Asked = Callable[[Judgement], bool]

QUESTIONS: tuple[tuple[str, Asked, Asked], ...] = (
    ("no alarm, nothing hidden", lambda each: each.stratum == "null", lambda each: each.answered and not each.alarm),
    ("right, single effects the oracle separates", lambda each: each.stratum == "single" and each.asked, lambda each: each.right),
    ("among three, single", lambda each: each.stratum == "single" and each.asked, lambda each: each.among_three),
    ("family right, single", lambda each: each.stratum == "single" and each.asked, lambda each: bool(each.family_right)),
    ("right, pairs the oracle separates", lambda each: each.stratum == "pair" and each.asked, lambda each: each.right),
    ("among three, pairs", lambda each: each.stratum == "pair" and each.asked, lambda each: each.among_three),
    ("not confidently wrong, something hidden", lambda each: each.stratum in ("single", "pair"), lambda each: not each.wrong),
    ("right channel", lambda each: each.stratum in ("single", "pair") and each.asked, lambda each: bool(each.channel_right)),
    ("alarm, off the catalogue", lambda each: each.stratum == "off" and each.asked, lambda each: each.alarm),
    ("not confidently misnamed, off the catalogue", lambda each: each.stratum == "off" and each.asked, lambda each: not each.confident),
)
"""A question, the cases that it is asked of, and what answers it well."""

SEPARATIONS = (5.0, 10.0, 20.0, 50.0)
"""Edges of the bins of separation [standard deviations]."""


@dataclass(frozen=True)
class Pair:
    """One case as two tools answered it."""

    first: Judgement
    second: Judgement
    machine: str
    colour: str

    @property
    def separation(self) -> str:
        """The bin of the distance to the nearest other name."""
        below = sum(self.first.separation >= edge for edge in SEPARATIONS)
        edges = ("0", *(f"{edge:g}" for edge in SEPARATIONS))
        return f"{edges[below]} to {edges[below + 1]}" if below < len(SEPARATIONS) else f"over {edges[below]}"


GROUPS: dict[str, Callable[[Pair], str]] = {
    "machine": lambda pair: pair.machine,
    "separation": lambda pair: pair.separation,
    "colour": lambda pair: pair.colour,
    "condition": lambda pair: pair.first.condition,
}


def pairs(results: Path, commits: tuple[str, str]) -> list[Pair]:
    """The cases that both commits have answered, judged."""
    return [Pair(judged(first), judged(second), first["machine"], first["colour"]) for first, second in both(results, commits)]


def compare(results: Path, commits: tuple[str, str]) -> dict[str, Any]:
    """Every question over all cases that both have, and over groups of them.

    McNemar's exact test: of the cases where one tool alone answers well, either is as likely by chance.
    """
    answered = pairs(results, commits)
    rows = list(both(results, commits))
    groups = {
        name: {
            value: list(_rows([pair for pair in answered if key(pair) == value], "null", "single", "pair"))
            for value in sorted({key(pair) for pair in answered})
        }
        for name, key in GROUPS.items()
    }
    return {
        "commits": [commit[:8] for commit in commits],
        "cases": len(answered),
        "questions": list(_rows(answered)),
        "groups": groups,
        "explained": [_explained([getattr(pair, name) for pair in answered]) for name in ("first", "second")],
        "seconds": [_middle([row[place].get("processor_s") or row[place]["wall_s"] for row in rows]) for place in (0, 1)],
    }


def _middle(values: Sequence[float]) -> float | None:
    return sorted(values)[len(values) // 2] if values else None


def _explained(judged: Sequence[Judgement]) -> dict[str, int]:
    """How often an answer was given with assurance, and how often that was right, wrong, or half."""
    said = [each for each in judged if each.confident]
    return {
        "said": len(said),
        "right": sum(each.right for each in said),
        "wrong": sum(each.wrong or each.stratum == "off" for each in said),
    }


def _rows(answered: Sequence[Pair], *strata: str) -> Iterable[dict[str, Any]]:
    for question, asked, well in QUESTIONS:
        here = [(well(pair.first), well(pair.second)) for pair in answered if asked(pair.first)]
        if not here or (strata and not question.startswith(("no alarm", "right, ", "not confidently wrong"))):
            continue
        first, second = here.count((True, False)), here.count((False, True))
        yield {
            "question": question,
            "n": len(here),
            "both": here.count((True, True)),
            "first alone": first,
            "second alone": second,
            "neither": here.count((False, False)),
            "p": round(float(binomtest(first, first + second).pvalue), 4) if first + second else 1.0,
        }


def text(document: dict[str, Any]) -> str:
    """What `compare` returns, as tables in Markdown."""
    first, second = document["commits"]
    heads = ("question", "cases", f"{first}", f"{second}", f"{first} alone", f"{second} alone", "p by chance")

    def rows(questions: Iterable[dict[str, Any]], *before: str) -> list[tuple[object, ...]]:
        return [
            (*before, row["question"], row["n"], row["both"] + row["first alone"], row["both"] + row["second alone"],
             row["first alone"], row["second alone"], f"{row['p']:.2g}")
            for row in questions
        ]  # fmt: skip

    parts = [f"{document['cases']} cases that both answered.", table(heads, rows(document["questions"]))]
    for name, groups in document["groups"].items():
        parts.append(table((name, *heads), [row for value, questions in groups.items() for row in rows(questions, value)]))
    for commit, said, seconds in zip(document["commits"], document["explained"], document["seconds"], strict=True):
        parts.append(
            f"{commit}: `explained` {said['said']} times, right {said['right']}, wrong {said['wrong']}; {seconds} s in the median."
        )
    return "\n\n".join(parts)


def write(results: Path, commits: tuple[str, str]) -> str:
    """Write `paired_FIRST_SECOND.json` and return its tables."""
    document = compare(results, commits)
    path = results / f"paired_{commits[0][:8]}_{commits[1][:8]}.json"
    path.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
    return text(document)
