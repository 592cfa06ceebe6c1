"""How sure an answer is said to be: as often as answers like it were right where the truth was known."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from hil.diagnosis.report.tables import how_sure
from hil.diagnosis.result import Diagnosis, EffectAt, Finding, Hypothesis, NoiseKind, Verdict
from hil.diagnosis.verdict.values import ASSUMED, RIGHT, with_confidence

RESULTS = Path(__file__).resolve().parents[3] / "benchmarks" / "results" / "concealed"
DRY, AT_REST = EffectAt("coulomb_friction", "roll"), EffectAt("stribeck_friction", "roll")


def counted(path: Path) -> dict[str, tuple[int, int]]:
    """By verdict, right answers and all of one tree."""
    found = {verdict: (0, 0) for verdict in RIGHT}
    for line in path.read_text(encoding="utf-8").splitlines():
        one = json.loads(line)["judged"]
        verdict = "retuned" if one["verdict"] == "consistent" else one["verdict"]
        if verdict in found:
            right, answers = found[verdict]
            is_right = one["right"] or (verdict == "retuned" and one["stratum"] == "null")
            found[verdict] = right + is_right, answers + 1
    return found


def test_what_is_said_of_verdicts_was_counted_on_a_hundred_cases_or_more() -> None:
    trees = [counted(path) for path in RESULTS.glob("answers_????????.jsonl")]
    assert RIGHT in trees
    assert sum(answers for _, answers in RIGHT.values()) > 100


def said(verdict: Verdict, noise: NoiseKind) -> Diagnosis:
    variants = ((DRY, 0.7), (AT_REST, 0.2))
    finding = Finding(DRY, 0.9, {}, variants=variants)
    sets = (Hypothesis((DRY,), 0.75, is_confirmed=True), Hypothesis((), 0.25))
    return with_confidence(
        Diagnosis(verdict=verdict, reason="", noise=noise, findings=(finding,), hypotheses=sets, baseline=(finding,), seconds=1.0)
    )


@pytest.mark.parametrize("noise", ["repeats", "periods", "assumed"])
def test_shares_of_the_evidence_become_confidences(noise: NoiseKind) -> None:
    right, count = RIGHT["explained"]
    sure = right / count * (ASSUMED if noise == "assumed" else 1.0)
    found = said("explained", noise)
    assert ("without repeats" in how_sure(found)) is (noise == "assumed")
    for one in found.findings:
        assert one.confidence == pytest.approx(0.9 * sure)
        assert [each for _, each in one.variants] == pytest.approx([0.7 * sure, 0.2 * sure])
    assert sum(one.confidence for one in found.hypotheses) == pytest.approx(sure)


def test_a_verdict_that_leaves_doubt_is_less_sure_and_says_how_often_such_were_right() -> None:
    doubtful, sure = said("ambiguous", "repeats"), said("explained", "repeats")
    assert doubtful.findings[0].confidence < sure.findings[0].confidence
    assert said("unknown_physics", "repeats").findings[0].confidence == doubtful.findings[0].confidence
    assert "{} of {} answers called ambiguous were right".format(*RIGHT["ambiguous"]) in how_sure(doubtful)
