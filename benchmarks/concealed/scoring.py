"""The score: every bar with its interval, by stratum, and detection and naming over detectability."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import asdict
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from concealed.curves import draw_curves
from concealed.intervals import calibration, clopper_pearson, upper_bound
from concealed.judging import Judgement, judge
from concealed.making import Places, seal
from concealed.tables import text
from concealed.truth.catalogue import INSIDE

EDGES = (0.0, 2.5, 5.0, 7.5, 10.0, 15.0, 20.0, 30.0, 50.0, 100.0, np.inf)
"""Detectability's bins [standard deviations]."""


NOT_ASKED = "not asked"


def score(places: Places, results: Path, numbers: Collection[int], *, partial: bool = False, judged_before: Path | None = None) -> str:
    """Score the cases of these numbers; write `scores_SEEDS.json` and the figure, return the tables as text.

    Unless `partial`, cases without a line of answers and answers of more than one commit are refused: what is left out or mixed could only
    flatter. The file says both.
    Cases in `judged_before`, a file of scores, are taken from it as they were judged: another computer, or another MuJoCo, makes truths
    that differ by rounding, and these are not the ones that were sealed.
    """
    path = results / f"answers_{places.seeds}.jsonl"
    if not path.exists():
        raise SystemExit(f"{path}: no answers yet; `python benchmarks/concealed run --seeds {places.seeds}` writes them")
    lines = path.read_text(encoding="utf-8").splitlines()
    answers = {answer["number"]: answer for answer in map(json.loads, lines) if answer["number"] in numbers}
    commits = sorted({answer["commit"] for answer in answers.values()})
    before = _judged_before(judged_before, places.seeds, answers) if judged_before else {}
    missing = sorted(set(numbers) - set(answers))
    if not partial:
        _refuse_parts(path, missing, commits)
    judged = []
    for number, answer in sorted(answers.items()):
        if number in before:
            judged.append(before[number])
            continue
        path = places.truth(number)
        if not path.exists():
            remake = f"`python benchmarks/concealed make --seeds {places.seeds} --cases {number}` makes it anew"
            raise SystemExit(f"{path}: the truth of case {number} is not here; {remake}, or --work names the folder that has it")
        if seal(path) != answer["truth_sha256"]:
            raise SystemExit(f"{path}: is not the truth that was sealed when case {number} was answered")
        judged.append(judge(answer, json.loads(path.read_text(encoding="utf-8"))))
    bars, strata, kinds, curve = _bars(judged), _strata(judged), by_kind(judged), _curve(judged)
    table = {"seeds": places.seeds, "cases": len(judged), "missing": missing, "commits": commits, "judged_before": sorted(before)}
    table |= {"bars": bars, "strata": strata, "kinds": kinds, "curve": curve}
    table["cases_judged"] = [asdict(each) for each in judged]
    (results / f"scores_{places.seeds}.json").write_text(_in_lines(table), encoding="utf-8")
    draw_curves(curve, results / f"detectability_{places.seeds}.svg")
    return text(table)


def _judged_before(path: Path, seeds: str, answers: Mapping[int, dict[str, Any]]) -> dict[int, Judgement]:
    """By number, the cases of a file of scores that judged these answers."""
    try:
        table = json.loads(path.read_text(encoding="utf-8"))
        rows = {row["number"]: Judgement(**row) for row in table["cases_judged"] if row["number"] in answers}
        said, commits = table["seeds"], set(table["commits"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise SystemExit(f"{path}: no file of scores as `score` writes it ({type(error).__name__}: {error})") from None
    if said != seeds:
        raise SystemExit(f"{path}: scores of {said} cases, where {seeds} ones are asked for")
    for number, row in rows.items():
        answer = answers[number]
        if answer["commit"] not in commits or (row.answered and row.verdict != (answer.get("diagnosis") or {}).get("verdict")):
            raise SystemExit(f"{path}: case {number} was judged by another answer than the one of {answer['commit']}")
    return rows


def _refuse_parts(path: Path, missing: Sequence[int], commits: Sequence[str]) -> None:
    if missing:
        some = ", ".join(map(str, missing[:5])) + (", ..." if len(missing) > 5 else "")
        raise SystemExit(f"{path}: {len(missing)} cases have no answer ({some}); `run` them, or give --partial to score the others")
    if len(commits) > 1:
        raise SystemExit(f"{path}: answers of {len(commits)} commits ({', '.join(commits)}); run one, or give --partial to mix them")


def _share(judged: Sequence[Judgement], hit: Callable[[Judgement], bool]) -> tuple[int, int]:
    return sum(map(hit, judged)), len(judged)


def _bars(judged: list[Judgement]) -> list[dict[str, Any]]:
    """Every bar of the proof: what was measured, its 95 % interval, what is asked, whether it is met."""
    nulls = [each for each in judged if each.stratum == "null"]
    inside = [each for each in judged if each.stratum in ("single", "pair")]
    singles = [each for each in inside if each.stratum == "single" and each.asked]
    pairs = [each for each in inside if each.stratum == "pair" and each.asked]
    outside = [each for each in judged if each.stratum == "off"]
    ambiguous = [each for each in inside if each.ambiguous]
    confident = [each for each in judged if each.confident]
    covered = [hit for each in inside for hit in each.covered]
    bars = []

    def proportion(name: str, hits: int, n: int, asked: str, met: Callable[[float, float, float], bool]) -> None:
        low, high = clopper_pearson(hits, n)
        value = hits / n if n else float("nan")
        bars.append(
            {
                "bar": name,
                "value": value,
                "hits": hits,
                "n": n,
                "ci95": [low, high],
                "asked": asked,
                "met": None if asked == NOT_ASKED else bool(n and met(value, low, high)),
            }
        )

    def median(name: str, values: list[float], asked: float) -> None:
        value = float(np.median(values)) if values else float("nan")
        bars.append(
            {"bar": name, "value": value, "n": len(values), "asked": f">= {asked:g} in the median", "met": bool(values and value >= asked)}
        )

    alarms = sum(each.alarm or not each.answered for each in nulls)
    proportion(
        "false alarms on nulls (no answer counts as one), one-sided upper bound",
        alarms,
        len(nulls),
        "<= 3 % (upper bound)",
        lambda *_: upper_bound(alarms, len(nulls)) <= 0.03,
    )
    bars[-1]["upper_bound"] = upper_bound(alarms, len(nulls))
    proportion("no answer: crashed or out of time", *_share(judged, lambda each: not each.answered), "none", lambda value, *_: value == 0.0)
    for name, group, first, three in (("single effects", singles, 93, 97), ("pairs", pairs, 85, 93)):
        for what, hit, asked in (
            ("top name right", lambda each: each.right, first),
            ("right among three", lambda each: each.among_three, three),
            ("right but for the law in its family", lambda each: bool(each.family_right), 97),
        ):
            share = _share(group, hit)
            proportion(f"{what}, {name} the oracle separates", *share, f">= {asked} %", lambda value, *_, least=asked: 100 * value >= least)
    proportion(
        "confidently wrong, effects of the catalogue", *_share(inside, lambda each: each.wrong), "<= 3 %", lambda value, *_: value <= 0.03
    )
    proportion("wrong among all confident answers", *_share(confident, lambda each: each.wrong), NOT_ASKED, lambda *_: False)
    spanned_by_none = [each for each in outside if each.asked]
    for name, group in (
        ("off the catalogue, confidently misnamed", spanned_by_none),
        ("the same, with those that an effect spans as drawn", outside),
    ):
        proportion(name, *_share(group, lambda each: each.confident), "<= 3 %", lambda value, *_: value <= 0.03)
    proportion(
        "ambiguous sets hold the truth", *_share(ambiguous, lambda each: each.holds_truth), ">= 95 %", lambda value, *_: value >= 0.95
    )
    told_apart = [each for each in ambiguous if each.asked]
    share = _share(told_apart, lambda each: each.holds_truth)
    proportion("the same, of effects the oracle separates", *share, NOT_ASKED, lambda *_: False)
    shown = [each for each in ambiguous if each.holds_shown is not None]
    share = _share(shown, lambda each: bool(each.holds_shown))
    proportion("the same, but for effects that the recordings hardly show", *share, NOT_ASKED, lambda *_: False)
    proportion("95 % intervals cover", sum(covered), len(covered), "92 to 98 %", lambda value, *_: 0.92 <= value <= 0.98)
    located = [each for each in judged if each.channel_right is not None]
    proportion(
        "location: channel right", *_share(located, lambda each: bool(each.channel_right)), ">= 95 %", lambda value, *_: value >= 0.95
    )
    for dimension in ("time", "position", "frequency"):
        median(f"location: overlap in {dimension}", [each.overlap[dimension] for each in located if dimension in each.overlap], 0.6)
    median("removed share of the oracle's, its files simulated", [each.removed for each in inside if each.removed is not None], 0.9)
    own = [each.removed_by_its_own_word for each in inside if each.removed_by_its_own_word is not None]
    median("removed share as the tool reports it", own, 0.9)
    claimed = [each for each in judged if each.findings and each.alarm]
    bins = calibration([each.confidence for each in claimed], [each.right for each in claimed])
    bars.append(
        {
            "bar": "confidence calibrated, five bins",
            "n": len(claimed),
            "bins": bins,
            "asked": "all inside the band",
            "met": bool(bins) and all(each["inside"] for each in bins),
        }
    )
    return bars


def _strata(judged: list[Judgement]) -> list[dict[str, Any]]:
    groups: dict[tuple[str, str], list[Judgement]] = {}
    for each in judged:
        groups.setdefault((each.stratum, each.condition), []).append(each)
    sensors = [each for each in judged if each.stratum == "single" and INSIDE[each.kinds[0].split("@")[0]].sensor]
    if sensors:
        groups["single", "sensor only (of all singles)"] = sensors
    rows = []
    for (stratum, condition), group in sorted(groups.items()):
        verdicts = {verdict: sum(each.verdict == verdict for each in group) for verdict in sorted({each.verdict for each in group})}
        asked = [each for each in group if each.asked]
        rows.append({
            "stratum": stratum, "condition": condition, "n": len(group), "alarms": sum(each.alarm for each in group),
            "asked": len(asked), "right": sum(each.right for each in asked), "wrong": sum(each.wrong for each in group),
            "verdicts": verdicts,
        })  # fmt: skip
    return rows


def by_kind(judged: Sequence[Judgement]) -> list[dict[str, Any]]:
    """Of every kind of physics that was hidden alone and whose name was asked for: how often it was named, and as what else."""
    groups: dict[tuple[str, str], list[Judgement]] = {}
    for each in judged:
        if each.stratum in ("single", "off") and each.asked:
            groups.setdefault((each.stratum, each.kinds[0].split("@")[0]), []).append(each)
    rows = []
    for (stratum, kind), group in sorted(groups.items(), key=lambda entry: (entry[0][0] != "single", entry[0][1])):
        missed = [each for each in group if each.alarm and not each.right]
        others = Counter(_called(each, kind) for each in missed)
        rows.append({
            "stratum": stratum, "kind": kind, "asked": len(group), "right": sum(each.right for each in group),
            "among_three": sum(each.among_three for each in group), "confident": sum(each.confident and not each.right for each in group),
            "instead": dict(others.most_common()), "nothing": sum(not each.alarm and not each.right for each in group),
        })  # fmt: skip
    return rows


def _called(each: Judgement, kind: str) -> str:
    """What a wrong answer says that it is; "" where it has no name."""
    names = {name.split("@")[0] for name in each.findings} if each.verdict != "unknown_physics" else set()
    return " and ".join(f"{name} elsewhere" if name == kind and len(names) == 1 else name for name in sorted(names))


def _curve(judged: list[Judgement]) -> list[dict[str, Any]]:
    """Detection over detectability, naming over the distance to the nearest other name, single effects."""
    singles = [each for each in judged if each.stratum == "single" and each.condition not in ("little", "uncovered")]
    rows = []
    for low, high in pairwise(EDGES):
        detected = [each for each in singles if low <= each.detectability < high]
        named = [each for each in singles if low <= (each.detectability if each.tuned else each.separation) < high]
        rows.append({
            "from": low, "to": high if np.isfinite(high) else None,
            "detected": [sum(each.found for each in detected), len(detected)], "named": [sum(each.right for each in named), len(named)],
        })  # fmt: skip
    return rows


def _in_lines(table: dict[str, Any]) -> str:
    """JSON with a line for every key, and for every entry of a list."""

    def value(entry: Any) -> str:
        return "[\n" + ",\n".join(json.dumps(each) for each in entry) + "\n]" if isinstance(entry, list) else json.dumps(entry)

    return "{\n" + ",\n".join(f"{json.dumps(name)}: {value(entry)}" for name, entry in table.items()) + "\n}\n"
