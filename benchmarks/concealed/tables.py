"""The tables of a file of scores, as docs/generated/results.md shows them."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

Case = dict[str, Any]


def tables_of(path: Path) -> str:
    """The tables of a file of scores as `score` writes it."""
    try:
        return text(json.loads(path.read_text(encoding="utf-8")))
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise SystemExit(f"{path}: no file of scores as `score` writes it ({type(error).__name__}: {error})") from None


def text(scores: dict[str, Any]) -> str:
    """Bars, strata, kinds, and the cases that were missed, in Markdown."""
    parts = [_bars(scores["bars"]), _strata(scores["strata"]), _inside(scores["kinds"]), _outside(scores["kinds"]), _missed(scores)]
    if scores["cases_judged"]:
        seconds = np.median([case["seconds"] for case in scores["cases_judged"]])
        parts.append(f"{scores['cases']} cases; {seconds:.1f} s each in the median")
    return "\n\n".join(part for part in parts if part)


def _row(*cells: object) -> str:
    return f"| {' | '.join(map(str, cells))} |"


def table(heads: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """A table in Markdown."""
    return "\n".join([_row(*heads), "|" + "---|" * len(heads), *(_row(*row) for row in rows)])


def _bars(bars: Sequence[Case]) -> str:
    return table(("bar", "measured", "95 % interval", "asked", "met"), [_bar(bar) for bar in bars])


def _bar(bar: Case) -> tuple[object, ...]:
    asked = bar["asked"].replace("<=", "≤").replace(">=", "≥")
    met = "–" if not bar["n"] or bar["met"] is None else "yes" if bar["met"] else "no"
    interval = ""
    if "bins" in bar:
        right, said = (", ".join(f"{each[key]:.2f}" for each in bar["bins"]) for key in ("right", "confidence"))
        measured = f"right {right} where {said} was said" if bar["bins"] else f"too few, {bar['n']}"
    elif not bar["n"]:
        measured = "none"
    elif "ci95" in bar:
        measured = f"{bar['hits']} of {bar['n']}, {100 * bar['value']:.1f} %"
        low, high = bar["ci95"]
        interval = f"{100 * low:.1f} to {100 * high:.1f} %"
        if "upper_bound" in bar:
            interval += f", upper {100 * bar['upper_bound']:.1f} %"
    else:
        measured = f"{bar['value']:.2f} of {bar['n']}"
    return bar["bar"], measured, interval, asked, met


def _strata(strata: Sequence[Case]) -> str:
    heads = ("stratum", "condition", "cases", "alarms", "name asked", "right", "confidently wrong")
    return table(heads, [[row[key] for key in ("stratum", "condition", "n", "alarms", "asked", "right", "wrong")] for row in strata])


def _inside(kinds: Sequence[Case]) -> str:
    rows = [
        [row["kind"], *(row[key] or "" for key in ("asked", "right", "among_three", "confident")), _instead(row), row["nothing"] or ""]
        for row in kinds
        if row["stratum"] == "single"
    ]
    heads = ("hidden", "name asked", "right", "among three", "confidently another", "called instead", "nothing")
    return table(heads, rows) if rows else ""


def _outside(kinds: Sequence[Case]) -> str:
    rows = [
        [row["kind"], *(row[key] or "" for key in ("asked", "confident")), _instead(row), row["nothing"] or ""]
        for row in kinds
        if row["stratum"] == "off"
    ]
    return table(("off the catalogue", "judged", "confidently misnamed", "called", "nothing"), rows) if rows else ""


def _instead(row: Case) -> str:
    return ", ".join(f"{name or 'no name'}{f' {count}' if count > 1 else ''}" for name, count in row["instead"].items())


def _missed(scores: dict[str, Any]) -> str:
    """Every case that counts against a bar, by its number."""
    cases = scores["cases_judged"]
    inside = [case for case in cases if case["stratum"] in ("single", "pair")]

    def listed(title: str, some: Sequence[Case], said: Callable[[Case], str]) -> str:
        return f"- **{title}**, {len(some)}: {'; '.join(map(said, some))}" if some else f"- **{title}**, none"

    lines = [
        listed("Alarms", [case for case in cases if case["stratum"] == "null" and (case["alarm"] or not case["answered"])], _alarm),
        listed("Confidently wrong", [case for case in inside if case["wrong"]], _answer),
        listed("Off the catalogue, misnamed", [case for case in cases if case["stratum"] == "off" and case["confident"]], _answer),
    ]
    for stratum in ("single", "pair"):
        some = [case for case in inside if case["stratum"] == stratum and case["asked"] and not case["right"]]
        lines.append(listed(f"{stratum.capitalize()}s missed", some, _answer))
    without = [case for case in inside if case["ambiguous"] and not case["holds_truth"]]
    sets = [
        f"{name} {_numbers(some)}"
        for name, some in (("asked", [c for c in without if c["asked"]]), ("of others", [c for c in without if not c["asked"]]))
        if some
    ]
    lines.append(f"- **Sets without the truth**, {len(without)}: {'; '.join(sets)}" if sets else "- **Sets without the truth**, none")
    intervals, channels = [c for c in inside if not all(c["covered"])], [c for c in cases if c["channel_right"] is False]
    lines.append(f"- **Intervals missed**: {_numbers(intervals)}. **Channels**: {_numbers(channels)}")
    return "\n".join(lines)


def _numbers(cases: Sequence[Case]) -> str:
    return ", ".join(str(case["number"]) for case in cases) or "none"


def _alarm(case: Case) -> str:
    return f"{case['machine']}, {_said(case)} ({case['number']})"


def _answer(case: Case) -> str:
    hidden = " with ".join(kind.split("@")[0] for kind in case["kinds"])
    at = "" if case["stratum"] == "off" else f" at {_distance(case):.1f},"
    three = ", among three" if case["among_three"] and not case["right"] else ""
    return f"{hidden}{at} {_said(case)}{three} ({case['number']})"


def _said(case: Case) -> str:
    """What it was called, and the verdict."""
    called = f"called {' with '.join(name.split('@')[0] for name in case['findings'])}, " if case["findings"] else ""
    return f"{called}`{case['verdict']}`" if case["answered"] else "no answer"


def _distance(case: Case) -> float:
    """From what is nearest, another name or nothing [standard deviations]."""
    return min(float(case["detectability"]), float(case["separation"]))
