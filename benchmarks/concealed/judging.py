"""One answer against its truth: what is right, wrong, abstained, covered, located."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from itertools import permutations
from typing import Any

import numpy as np

from virtual_bus.effects.registry import effects as catalogue

QUIET = ("consistent", "retuned", "inconclusive")
"""Verdicts that claim no missing physics."""

NO_ANSWER = "none"
"""Stands for the verdict of a tool that crashed or ran out of time."""

HIDDEN_FROM_NAMING = ("uncovered", "little")
"""Conditions under which nobody is asked for a name."""

DURATION_S = 10.0
LOWEST_Hz, HIGHEST_Hz = 0.1, 100.0
"""Frequencies are compared in octaves between a recording's lowest line and half the sample rate of most machines."""

CHANNEL_SHARE = 0.5
"""A channel is right that holds at least this share of what the truest channel holds."""

NAMES_OF_A_JOINT = 4
"""Of an axis's names: itself, its joint, that joint's body, its encoder. Those that follow are the spring's behind it, another joint."""

OF_THE_JOINT = ("A", "A1", "Fc", "Fc_plus", "Fc_minus", "tau0", "mgr", "at_position")
"""Parameters in units of the joint's effort or position. The same line, shaken at the spring behind a drive or at the drive, has the same
frequency and another amplitude."""

SHOWN = 5.0
"""Standard deviations from nothing, everything else refitted, from which on recordings show an effect."""

ENOUGH_TO_REMOVE = 0.05
"""Excess of the squared misfit over noise, from which on a removed share means something."""


@dataclass(frozen=True)
class Judgement:
    """What the scorer makes of one case."""

    number: int
    stratum: str
    condition: str
    machine: str
    kinds: tuple[str, ...]
    verdict: str
    findings: tuple[str, ...]
    seconds: float
    detectability: float
    separation: float
    tuned: bool
    answered: bool  # False after a crash or beyond the time limit
    asked: bool  # the oracle can tell the names
    alarm: bool
    found: bool  # alarm, or the right verdict of a tuned parameter
    right: bool
    among_three: bool
    wrong: bool  # explained, and something named that is not there
    confident: bool
    ambiguous: bool
    holds_truth: bool
    confidence: float
    covered: tuple[bool, ...]
    channel_right: bool | None
    overlap: dict[str, float]
    removed: float | None  # by simulating the tool's files
    removed_by_its_own_word: float | None
    holds_shown: bool | None = None  # holds what stands SHOWN from nothing; None where nothing does, or where a file of scores does not say
    family_right: bool | None = None  # right but for the law within its family; None where a file of scores does not say


def judge(answer: dict[str, Any], truth: dict[str, Any]) -> Judgement:
    """Judge one line of answers by its truth. A command that ended in an error has not answered, whatever it had written before."""
    diagnosis = (answer.get("diagnosis") or {}) if answer["exit_status"] == 0 else {}
    verdict = diagnosis.get("verdict", NO_ANSWER)
    everything = diagnosis.get("findings") or []
    findings = [finding for finding in everything if finding.get("kind") != "number"]  # numbers of the file are no effects
    effects = truth["effects"]
    each = truth.get("each", [])
    named = bool(effects) and all(effect["accepted"] for effect in effects)
    tuned = named and all(effect["tuned"] for effect in effects)
    detectability = truth.get("raw_detectability" if tuned else "detectability", 0.0)
    separation = min((min([*one["distances"].values(), one["detectability"]]) for one in each), default=0.0)
    asked = (
        bool(effects)
        and truth["condition"] not in HIDDEN_FROM_NAMING
        and all(one["separable"] or effect["tuned"] for one, effect in zip(each, effects, strict=True))
    )
    if tuned:
        asked = truth["condition"] not in HIDDEN_FROM_NAMING and detectability >= SHOWN
    alarm = verdict not in (*QUIET, NO_ANSWER)
    by_tuning = tuned and (verdict == "retuned" or (bool(everything) and not findings))
    sets = [findings] if findings else []
    ranked = [hypothesis["effects"] for hypothesis in diagnosis.get("hypotheses") or []]
    claims = alarm and verdict != "unknown_physics" and named and bool(sets)
    right = by_tuning or (claims and matches(findings, effects))
    three = right or (alarm and named and any(matches(some, effects) for some in ranked[:3]))
    wrong = verdict == "explained" and any(not any(_accepts(effect, finding) for effect in effects) for finding in findings)
    possible = [*findings, *(other for finding in findings for other in finding.get("ambiguous_with", []))]
    held = [bool(effect["tuned"] or any(_accepts(effect, other) for other in possible)) for effect in effects]
    shown = [hold for hold, one in zip(held, each, strict=True) if one["detectability"] >= SHOWN]
    return Judgement(
        number=truth["number"],
        stratum=truth["stratum"],
        condition=truth["condition"],
        machine=truth["machine"],
        kinds=tuple(f"{effect['kind']}@{effect['at']}" for effect in effects),
        verdict=verdict,
        findings=tuple(f"{finding['effect']}@{finding['at']}" for finding in findings),
        seconds=float(answer.get("wall_s", 0.0)),
        detectability=detectability,
        separation=separation,
        tuned=tuned,
        answered=verdict != NO_ANSWER,
        asked=asked,
        alarm=alarm,
        found=alarm or by_tuning,
        right=right,
        among_three=three,
        wrong=wrong,
        confident=verdict == "explained",
        ambiguous=verdict == "ambiguous",
        holds_truth=named and all(held),
        holds_shown=named and all(shown) if shown else None,
        family_right=right or (claims and matches(findings, effects, _accepts_family)),
        confidence=max((float(finding.get("confidence", 0.0)) for finding in findings[:1]), default=0.0),
        covered=tuple(_coverage(findings, truth)),
        channel_right=_channel_right(diagnosis, truth) if alarm and asked else None,
        overlap=_overlap(diagnosis, truth) if alarm and asked else {},
        removed=_removed(answer, truth) if asked and named else None,
        removed_by_its_own_word=diagnosis.get("fit", {}).get("removed_share") if asked and named and alarm else None,
    )


def _accepts(effect: dict[str, Any], finding: dict[str, Any]) -> bool:
    return finding["effect"] in effect["accepted"] and finding["at"] in effect["accepted_at"]


def _accepts_family(effect: dict[str, Any], finding: dict[str, Any]) -> bool:
    family = {name: law.family for name, law in catalogue().items()}
    own = {family[name] for name in (effect["kind"], *effect["accepted"]) if name in family}
    return family.get(finding["effect"]) in own and finding["at"] in effect["accepted_at"]


def matches(
    findings: list[dict[str, Any]],
    effects: list[dict[str, Any]],
    accepts: Callable[[dict[str, Any], dict[str, Any]], bool] = _accepts,
) -> bool:
    """Every finding is an effect of its own, and what has no finding is a number of the machine file, left to re-tuning."""
    return len(findings) <= len(effects) and any(
        all(accepts(effect, finding) for effect, finding in zip(order, findings, strict=False))
        and all(effect["tuned"] for effect in order[len(findings) :])
        for order in permutations(effects)
    )


def _coverage(findings: list[dict[str, Any]], truth: dict[str, Any]) -> Iterable[bool]:
    """Whether intervals of parameters that mean the same in both equations hold the truth."""
    for effect, own in zip(truth["effects"], truth.get("each", []), strict=True):  # a null has neither
        for finding in findings:
            if finding["effect"] != effect["kind"] or not _accepts(effect, finding) or _stands_for_two(effect, own, findings, truth):
                continue
            for name, value in effect["compare"].items():
                if name in OF_THE_JOINT and finding["at"] not in effect["accepted_at"][:NAMES_OF_A_JOINT]:
                    continue
                interval = finding.get("parameters", {}).get(name, {}).get("ci95")
                if interval:
                    yield bool(interval[0] <= value <= interval[1])


def _stands_for_two(effect: dict[str, Any], own: dict[str, Any], findings: list[dict[str, Any]], truth: dict[str, Any]) -> bool:
    """Whether an effect's finding is also all that is said of another effect at its place: one of the laws that it could be taken for, or
    of its own law, where fewer are named than there are.

    Efforts at a joint add: one Coulomb friction named where an asymmetric one acts too is their sum, which is neither's.
    """
    beside = [other for other in truth["effects"] if other is not effect and other["at"] == effect["at"]]
    named = sum(_accepts(effect, finding) for finding in findings)
    return named <= sum(other["kind"] == effect["kind"] for other in beside) or any(
        other["kind"] in own["distances"] and not any(_accepts(other, finding) for finding in findings) for other in beside
    )


def _channel_right(diagnosis: dict[str, Any], truth: dict[str, Any]) -> bool:
    said, true = diagnosis.get("location", {}).get("channels") or {}, truth["location"]["channels"]
    known = {name: share for name, share in said.items() if name in true}
    if not known:
        return False
    top = max(known, key=lambda name: known[name])
    return bool(true[top] >= CHANNEL_SHARE * max(true.values()))


def _overlap(diagnosis: dict[str, Any], truth: dict[str, Any]) -> dict[str, float]:
    """Intersection over union in time, frequency and position; what is left out is everywhere."""
    said, true = diagnosis.get("location", {}), truth["location"]
    overlap = {}
    if true["time_s"]:
        runs = [intervals for name, intervals in (said.get("time_s") or {}).items() if "held_out" not in name]
        everywhere = [[[0.0, DURATION_S]]]
        overlap["time"] = float(np.mean([_iou(intervals, true["time_s"]) for intervals in (runs or everywhere)]))
    if true["frequency_hz"]:
        overlap["frequency"] = _iou(_octaves(said.get("frequency_hz") or [[0.0, HIGHEST_Hz]]), _octaves(true["frequency_hz"]))
    axis = next((effect["at"] for effect in truth["effects"] if effect["at"] in true["position"]), None)
    if axis and true["position"][axis]["intervals"]:
        visited = true["position"][axis]["visited"]
        overlap["position"] = _iou((said.get("position") or {}).get(axis) or [visited], true["position"][axis]["intervals"])
    return overlap


def _octaves(intervals: list[list[float]]) -> list[list[float]]:
    return [[float(np.log2(np.clip(edge, LOWEST_Hz, HIGHEST_Hz))) for edge in interval] for interval in intervals]


def _iou(first: list[list[float]], second: list[list[float]]) -> float:
    """Intersection over union of two unions of intervals."""
    edges = np.unique([edge for intervals in (first, second) for interval in intervals for edge in interval])
    middles, widths = 0.5 * (edges[1:] + edges[:-1]), np.diff(edges)
    inside = [np.any([(low <= middles) & (middles <= high) for low, high in intervals], axis=0) for intervals in (first, second)]
    union = float(widths[inside[0] | inside[1]].sum())
    return float(widths[inside[0] & inside[1]].sum()) / union if union else 0.0


def _removed(answer: dict[str, Any], truth: dict[str, Any]) -> float | None:
    """Share of what the oracle could remove from the re-tuned machine's held-out misfit, in the truth's own noise units."""
    errors, noise = answer.get("held_out_rms") or {}, truth["held_out_noise_rms"]
    if "retuned" not in errors or "extended" not in errors:
        return None
    channels = [name for name in noise if name in errors["retuned"] and noise[name] > 0.0]
    squares = {name: float(np.mean([(errors[name][channel] / noise[channel]) ** 2 for channel in channels])) for name in errors}
    excess = squares["retuned"] - 1.0
    return (squares["retuned"] - squares["extended"]) / excess if excess > ENOUGH_TO_REMOVE else None
