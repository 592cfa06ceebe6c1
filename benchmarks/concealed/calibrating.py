"""Confidences fitted to development cases: `WEIGHTS` in `hil.diagnosis.judging.errors_of_laws`.

Each case's raw numbers (misfits, parameters, shapes searched, of every set of effects that was weighed; the truth's names beside them) are
kept as a line of evidence_development.jsonl, so that a fit takes seconds and the tool is not run again. The constants are those under which
what was hidden was likeliest: log confidence of the right sets, or of what is left where none is right, with a prior around the values set
by hand. Cases up to LAST_FITTED are fitted, those after it only checked.
"""

from __future__ import annotations

import json
import tempfile
import time
import warnings
from collections.abc import Sequence
from dataclasses import astuple, replace
from pathlib import Path
from typing import Any

import numpy as np
import scipy.optimize
import scipy.special

from concealed.judging import matches
from concealed.making import Places, make, seal
from concealed.running import JSON_KEPT, commit
from hil.diagnosis.answering.verdict import UNKNOWN_LEFT
from hil.diagnosis.diagnose import diagnose
from hil.diagnosis.files import write_diagnosis
from hil.diagnosis.judging.errors_of_laws import Weights
from hil.diagnosis.ranking.compared import Compared
from hil.diagnosis.ranking.naming import Evidence, Weighed, ranking
from hil.diagnosis.ranking.rarity import rarity_at
from hil.errors import BenchError
from hil.machine import load_machine
from hil.recording import read_recording
from virtual_bus.effects.places import part_at

LAST_FITTED = 89
"""Of the development cases; later ones only check."""

BY_HAND = Weights(form_error=0.004, left_weight=0.02, exact=0.3, unknown_freedom=8.0, outside=0.1)
SPREAD = 1.5
"""Standard deviation of the prior, in natural logarithms (logits for probabilities)."""

FOLDS = 5
BINS = 5
LEAST = 1e-3
"""Probability below which a case is not counted as less likely: one case must not decide."""


def evidence_of(places: Places, number: int) -> dict[str, Any]:
    """One case's raw numbers and, under "answer", what `run` keeps of an answer: one diagnosis gives both. No file is simulated anew, and
    no next experiment looked for.
    """
    warnings.simplefilter("ignore")
    make(places, number)
    folder = places.case(number)
    machine = load_machine(folder / "machine.toml")
    runs = {path.stem: read_recording(path, machine) for path in sorted(folder.glob("run_*.csv"))}
    held_out = {"held_out": read_recording(folder / "held_out.csv", machine)}
    sealed, began = seal(places.truth(number)), time.monotonic()
    outcome = diagnose(machine, runs, held_out, look_further=False)
    document = outcome.diagnosis.document()
    exit_status, said = 0, ""
    with tempfile.TemporaryDirectory() as out:
        try:
            write_diagnosis(outcome, machine, Path(out))
        except BenchError as error:  # as the command would end; the other cases go on
            exit_status, said = error.exit_status, str(error).replace(str(places.work), "WORK")
    answer = {
        "number": number,
        "truth_sha256": sealed,
        "commit": commit(),
        "exit_status": exit_status,
        "error": said,
        "wall_s": round(time.monotonic() - began, 1),
        "diagnosis": {key: document[key] for key in JSON_KEPT if key in document},
    }
    truth = json.loads(places.truth(number).read_text(encoding="utf-8"))
    found = outcome.evidence
    lost = [{"effect": f.effect.effect, "at": f.effect.at} for f in (d.finding(channel) for channel, d in outcome.train.read_off)]
    sets = []
    for h in found.sets:
        names = [{"effect": effect.effect, "at": effect.at} for effect in h.fitted.effects] if h.fitted is not None else []
        right = bool(truth["effects"]) and all(e["accepted"] for e in truth["effects"]) and matches([*names, *lost], truth["effects"])
        parts = [part_at(name["at"], machine.plant) for name in names]
        sets.append({"effects": [f"{n['effect']}@{n['at']}" for n in names], "parts": parts, "right": right} | _numbers(h))
    first = outcome.selection.gates[0] if outcome.selection.gates else None
    return {
        "number": number,
        "commit": commit(),
        "truth_sha256": sealed,
        "stratum": truth["stratum"],
        "truth": [f"{e['kind']}@{e['at']}" for e in truth["effects"]],
        "detectability": truth.get("detectability"),
        "verdict": outcome.diagnosis.verdict,
        "unexplained_share": round(outcome.diagnosis.unexplained_share, 4),
        "findings": [f"{f.effect.effect}@{f.effect.at}" for f in outcome.diagnosis.findings],
        "confidence": outcome.diagnosis.findings[0].confidence if outcome.diagnosis.findings else None,
        "gate": None
        if first is None
        else {
            "gain": round(first.gain, 2),
            "needed": round(first.needed, 2),
            "scatter": round(first.scatter, 3),
            "held_out_deviations": None if first.held_out_deviations is None else round(first.held_out_deviations, 2),
            "placebo_gain": round(first.placebo_gain, 2),
            "share": round(first.share, 4),
            "passed": bool(first.passed),
        },
        "sets": sets,
        "base": _numbers(found.base),
        "entries": [found.entries_train, found.entries_held_out],
        "tried": found.tried,
        "found": found.found,
        "cap": found.cap,
        "answer": answer,
    }


def _numbers(h: Weighed) -> dict[str, Any]:
    return {
        "train": round(h.train, 3),
        "held_out": round(h.held_out, 3),
        "information": [float(f"{value:.4g}") for value in h.information],
        "simpler": [[float(f"{loss:.4g}"), [float(f"{value:.4g}") for value in seen]] for loss, seen in h.simpler],
        "searched": round(h.searched, 3),
        "passed": bool(h.passed),
        "by_numbers": [round(energy, 3) for energy in h.by_numbers],
        "by_signs": [round(energy, 3) for energy in h.by_signs],
        "of_the_file": h.of_the_file,
        "compared": None if h.compared is None else h.compared._asdict(),
    }


def _evidence(row: dict[str, Any]) -> Evidence:
    base = row["base"]
    for key, what in (("parts", "the parts their effects act at"), ("simpler", "what they cost without some of their laws' terms")):
        if any(key not in s for s in row["sets"]):
            raise BenchError(f"evidence of case {row['number']}: sets lack {what}; remove the row and calibrate again")

    def one(numbers: dict[str, Any]) -> Weighed:
        information, passed = tuple(numbers["information"]), numbers["passed"]
        train, held_out, by_numbers = numbers["train"], numbers["held_out"], numbers.get("by_numbers", (0.0, 0.0))
        if isinstance(by_numbers, int | float):  # some rows hold the sum: shared as the misfits fall
            falls = max(base["train"] - train, 0.0), max(base["held_out"] - held_out, 0.0)
            by_numbers = [by_numbers * fall / max(sum(falls), 1e-9) for fall in falls]
        searched = numbers["searched"]
        rarity = rarity_at(dict(zip(numbers.get("effects", ()), numbers.get("parts", ()), strict=True)).values())
        simpler = tuple((loss, tuple(seen)) for loss, seen in numbers.get("simpler", ()))  # the base has none
        known = Weighed(None, train, held_out, information, searched=searched, passed=passed, rarity=rarity)
        by_signs = tuple(numbers.get("by_signs", (0.0, 0.0)))
        known = replace(
            known, by_numbers=tuple(by_numbers), by_signs=by_signs, of_the_file=numbers.get("of_the_file", True), simpler=simpler
        )
        compared = numbers.get("compared")  # not every row has it
        return replace(known, compared=None if compared is None else Compared(**compared))

    return Evidence(tuple(map(one, row["sets"])), one(base), *row["entries"], row["tried"], row["found"], row["cap"])


def weighed(row: dict[str, Any], weights: Weights) -> tuple[float, bool, float]:
    """Confidence of the likeliest set, whether it is right, and the probability given to what was so.

    Where nothing is the likeliest, 0, False, and 1: no name is said.
    """
    sets = {(s["train"], s["held_out"], tuple(s["information"]), s["searched"]): s["right"] for s in row["sets"]}
    ranked = ranking(_evidence(row), weights)
    if not ranked[0].information:
        return 0.0, False, 1.0
    right = [sets.get((h.train, h.held_out, h.information, h.searched), False) for h in ranked]
    confidences = [h.confidence for h in ranked]
    so = sum(c for c, is_right in zip(confidences, right, strict=True) if is_right) if any(right) else 1.0 - sum(confidences)
    return confidences[0], right[0], so


def log_likelihood(rows: Sequence[dict[str, Any]], weights: Weights) -> float:
    """Of what was hidden, over the rows in which a set passed the gate."""
    return float(sum(np.log(max(weighed(row, weights)[2], LEAST)) for row in rows))


def fit(rows: Sequence[dict[str, Any]]) -> Weights:
    """The constants of greatest likelihood times prior."""
    start = _coordinates(BY_HAND)

    def cost(at: np.ndarray) -> float:
        return 0.5 * float(np.sum(((at - start) / SPREAD) ** 2)) - log_likelihood(rows, _weights(at))

    found = [
        scipy.optimize.minimize(cost, start + move, method="Nelder-Mead", options={"xatol": 1e-2, "fatol": 1e-3, "maxfev": 300})
        for move in (np.zeros(len(start)), np.array([1.0, 1.0, -1.0, 0.0, 1.0]))
    ]
    return _weights(min(found, key=lambda one: one.fun).x)


def _coordinates(weights: Weights) -> np.ndarray:
    form_error, left_weight, exact, unknown, outside = astuple(weights)
    return np.array([np.log(form_error), np.log(left_weight), scipy.special.logit(exact), np.log(unknown), scipy.special.logit(outside)])


def _weights(at: np.ndarray) -> Weights:
    exact, outside = (float(scipy.special.expit(at[k])) for k in (2, 4))
    return Weights(float(np.exp(at[0])), float(np.exp(at[1])), exact, float(np.exp(at[3])), outside)


def reliability(rows: Sequence[dict[str, Any]], weights: Weights) -> list[tuple[float, float, int]]:
    """(mean confidence said, share right, cases) of up to BINS bins of equal count."""
    said = sorted((confidence, right) for confidence, right, _ in (weighed(row, weights) for row in rows) if confidence > 0.0)
    bins = np.array_split(np.arange(len(said)), max(min(BINS, len(said)), 1)) if said else []
    return [(float(np.mean([said[k][0] for k in b])), float(np.mean([said[k][1] for k in b])), len(b)) for b in bins]


def _left_unnamed(row: dict[str, Any]) -> bool:
    """Whether what is left alone makes a case `unknown_physics`, whatever the constants: no name is said there."""
    return bool(row["verdict"] == "unknown_physics" and row["unexplained_share"] > UNKNOWN_LEFT)


def calibrate(rows: Sequence[dict[str, Any]], present: Weights) -> str:
    """Fit, cross-validate, and say how reliable the confidences are before and after."""
    named = [row for row in rows if row["found"] and row["sets"] and not _left_unnamed(row)]
    fitted_rows = [row for row in named if row["number"] <= LAST_FITTED]
    checked = [row for row in named if row["number"] > LAST_FITTED]
    nulls = [row for row in rows if row["stratum"] == "null"]
    quiet = ("consistent", "retuned", "inconclusive")
    alarms = [row["number"] for row in nulls if row["verdict"] not in quiet]
    lines = [f"{len(rows)} cases; {len(nulls)} nulls, false alarms {len(alarms)} {alarms or ''}"]
    lines.append(f"a set passed the gate in {len(fitted_rows)} cases to fit and {len(checked)} to check")
    weights = fit(fitted_rows)
    crossed = 0.0
    for k in range(FOLDS):
        others = [row for number, row in enumerate(fitted_rows) if number % FOLDS != k]
        crossed += log_likelihood(fitted_rows[k::FOLDS], fit(others))
    before, after = log_likelihood(checked, present), log_likelihood(checked, weights)
    lines.append(f"log likelihood, cases to fit: present {log_likelihood(fitted_rows, present):.2f}, cross-validated {crossed:.2f}")
    lines.append(f"log likelihood, cases to check: present {before:.2f}, fitted {after:.2f}")
    for name, some in (("to fit", fitted_rows), ("to check", checked)):
        for label, these in (("present", present), ("fitted", weights)):
            bins = ", ".join(f"{said:.2f}: {right:.2f} of {count}" for said, right, count in reliability(some, these))
            lines.append(f"{name}, {label}, said: right  {bins}")
    return "\n".join([*lines, str(weights)])
