"""The page of results: the figures of benchmarks/results that `docs.generate.shown` names, each with its command.

A results file that is not there is left out with its section. A figure that a file does not have is an error: the declaration is stale.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Sequence
from pathlib import Path

from docs.generate.markdown import block, table
from docs.generate.markdown import page as whole
from docs.generate.shown import PROOF, PROOF_COMMAND, PROOF_TEXT, SHOWN
from docs.generate.shown.kinds import Figure, Rows, Shown

FOLDER = Path(__file__).resolve().parents[2] / "benchmarks" / "results"

INTRODUCTION = """
This page gathers measured figures, each with the command that measures it. They are read from `benchmarks/results`;
times depend on the computer and on its load. `benchmarks/README.md` says how to run a benchmark.
"""


class StaleDeclarationError(LookupError):
    """A results file lacks a figure that the page is to show."""


def page(folder: Path = FOLDER) -> str:
    """Write the page from a folder of results."""
    parts = [INTRODUCTION, *_proof(folder)]
    for shown in SHOWN:
        if (folder / shown.file).exists():
            parts += _section(shown, json.loads((folder / shown.file).read_text(encoding="utf-8")))
    return whole("Results", *parts)


def figure(document: object, path: Sequence[str], file: str) -> object:
    """Return what stands at a path of keys; "-1" is the last entry of a list."""
    for key in path:
        if isinstance(document, list) and document and key == "-1":
            document = document[-1]
            continue
        if not isinstance(document, dict) or key not in document:
            raise StaleDeclarationError(f"benchmarks/results/{file}: no {' / '.join(path)}; see docs/generate/shown")
        document = document[key]
    return document


def shown_value(value: object, factor: float = 1.0) -> str:
    """Write a figure with three digits; counts and words as they are."""
    if value is None:
        return "none"
    if isinstance(value, bool) or not isinstance(value, int | float):
        return str(value)
    if isinstance(value, int) and factor == 1.0:
        return str(value)
    if not math.isfinite(value):
        return "none"
    size = abs(value * factor)
    if size == 0.0:
        return "0"
    return f"{value * factor:.3g}" if 1e-3 <= size < 1e3 else (f"{value * factor:.0f}" if 1e3 <= size < 1e6 else f"{value * factor:.1e}")


def _section(shown: Shown, document: object) -> Iterator[str]:
    yield f"## {shown.title}"
    yield shown.text
    yield block(shown.command, "sh")
    if shown.figures:
        has_asked = any(each.asked for each in shown.figures)
        header = ("figure", "measured", "asked") if has_asked else ("figure", "measured")
        yield table(header, (_figure(each, document, shown.file)[: len(header)] for each in shown.figures))
    for rows in shown.rows:
        yield _rows(rows, document, shown.file)


def _figure(each: Figure, document: object, file: str) -> tuple[str, str, str]:
    return each.name, f"{shown_value(figure(document, each.path, file), each.factor)} {each.unit}".strip(), each.asked


def _rows(rows: Rows, document: object, file: str) -> str:
    """Write a table; keys that are not declared are all those with one of the columns at least, their other cells empty."""
    inside = figure(document, rows.path, file)
    keys = rows.keys or tuple(inside if isinstance(inside, dict) else ())
    lines = [(key, *(_cell(inside, (key, *column.path), column.factor, file, bool(rows.keys)) for column in rows.columns)) for key in keys]
    return table((rows.heading, *(column.heading for column in rows.columns)), (line for line in lines if any(line[1:])))


def _cell(document: object, path: Sequence[str], factor: float, file: str, required: bool) -> str:
    try:
        return shown_value(figure(document, path, file), factor)
    except StaleDeclarationError:
        if required:
            raise
        return ""


def _proof(folder: Path) -> Iterator[str]:
    if not (folder / PROOF).exists():
        return
    document = json.loads((folder / PROOF).read_text(encoding="utf-8"))
    yield "## The proof of the diagnosis"
    yield f"{PROOF_TEXT.strip()} {document['cases']} machines were diagnosed."
    yield block(PROOF_COMMAND, "sh")
    yield table(("figure", "measured", "of", "95 % interval", "asked", "met"), (_bar(bar) for bar in document["bars"]))


def _bar(bar: dict[str, object]) -> tuple[str, ...]:
    interval = bar.get("ci95")
    low_high = f"{_percent(interval[0])} to {_percent(interval[1])}" if isinstance(interval, list) else ""
    counted = f"{bar['hits']} of {bar['n']}" if "hits" in bar else str(bar["n"])
    met = {True: "yes", False: "no"}.get(bar["met"], "")  # type: ignore[call-overload]
    value = bar.get("value")
    is_median = "median" in str(bar["asked"])
    return str(bar["bar"]), shown_value(value) if is_median else _percent(value), counted, low_high, str(bar["asked"]), met


def _percent(value: object) -> str:
    return f"{100.0 * value:.1f} %" if isinstance(value, float) and math.isfinite(value) else ""
