"""Confidences fitted to answers, on answers whose share of right names is known."""

from __future__ import annotations

import numpy as np
import pytest
from concealed.calibrating import calibrate, fit, reliability, weighed

from hil.diagnosis.judging.errors_of_laws import Weights
from hil.errors import BenchError

CERTAIN = Weights(form_error=0.004, left_weight=0.02, exact=0.3, unknown_freedom=8.0, outside=0.001)
NOISE = 4000.0


def row(number: int, right: bool) -> dict[str, object]:
    """A case in which one set explains everything and its only rival nothing."""
    base = {"train": NOISE + 500.0, "held_out": 0.0, "information": [], "searched": 0.0, "passed": True}
    best = {"train": NOISE, "held_out": 0.0, "information": [500.0] * (1 + number % 3), "searched": 0.0, "passed": True, "right": right}
    best |= {"effects": ["coulomb_friction@belt"], "parts": ["belt"], "simpler": []}
    rival = {"train": NOISE + 300.0, "held_out": 0.0, "information": [200.0], "searched": 0.0, "passed": True, "right": False}
    rival |= {"effects": ["constant_load@belt"], "parts": ["belt"], "simpler": []}
    said = {"number": number, "stratum": "single", "verdict": "explained", "unexplained_share": 0.0, "found": True}
    return said | {"sets": [best, rival], "base": base, "entries": [NOISE, 0.0], "tried": 50, "cap": 0.999}


@pytest.fixture(scope="module")
def rows() -> list[dict[str, object]]:
    """Names that look certain, three in ten of them wrong."""
    wrong = np.random.default_rng(1).permutation(20) < 6
    return [row(number, not bool(is_wrong)) for number, is_wrong in enumerate(wrong)]


@pytest.mark.nightly
def test_fitted_confidences_are_the_share_of_right_names(rows: list[dict[str, object]]) -> None:
    assert np.mean([weighed(one, CERTAIN)[0] for one in rows]) > 0.95
    weights = fit(rows)
    assert np.mean([weighed(one, weights)[0] for one in rows]) == pytest.approx(0.7, abs=0.08)
    bins = reliability(rows, weights)
    assert [count for _, _, count in bins] == [4] * 5
    assert np.mean([right for _, right, _ in bins]) == pytest.approx(0.7)


@pytest.mark.nightly
def test_false_alarms_are_counted_and_what_passed_no_gate_is_not_fitted(rows: list[dict[str, object]]) -> None:
    null = row(100, False) | {"stratum": "null", "found": False}
    said = calibrate([*rows[:6], null, row(95, True)], CERTAIN)
    assert "1 nulls, false alarms 1 [100]" in said
    assert "6 cases to fit and 1 to check" in said


@pytest.mark.parametrize("missing", ["parts", "simpler"])
def test_rows_that_lack_what_the_tool_weighs_are_refused(rows: list[dict[str, object]], missing: str) -> None:
    without = {key: value for key, value in rows[0]["sets"][0].items() if key != missing}
    with pytest.raises(BenchError, match="case 0"):
        weighed(rows[0] | {"sets": [without]}, CERTAIN)


def test_a_pair_s_parts_speak_for_it(rows: list[dict[str, object]]) -> None:
    """Where the unknown costs as much as the set: one law is seldom several effects, at several parts still more seldom."""

    def confidence(*places: str) -> float:
        best, rival = rows[2]["sets"]
        named = {"effects": [f"effect_{n}@{at}" for n, at in enumerate(places)], "parts": list(places)}
        dear = best | {"information": [60.0] * 8, "searched": 10.0} | named
        return weighed(rows[2] | {"sets": [dear, rival]}, CERTAIN)[0]

    assert confidence("pan") < confidence("pan", "pan") < confidence("pan", "tilt")


@pytest.mark.nightly
def test_a_case_said_to_be_without_a_name_teaches_nothing_about_names(rows: list[dict[str, object]]) -> None:
    unknown = row(30, False) | {"verdict": "unknown_physics", "unexplained_share": 0.7}
    assert "6 cases to fit and 1 to check" in calibrate([*rows[:6], unknown, row(95, True)], CERTAIN)


def test_a_law_is_weighed_without_its_terms_from_a_row_as_it_was_in_the_answer(rows: list[dict[str, object]]) -> None:
    """A rival that fits as well, dear for a term that was fitted to nothing."""
    best = rows[2]["sets"][0]
    dear = best | {"information": [*best["information"], 1e9]}
    without = dear | {"simpler": [[0.0, best["information"]]]}
    shares = [weighed(rows[2] | {"sets": [best, rival]}, CERTAIN)[0] for rival in (dear, without)]
    assert shares[0] > 0.99
    assert shares[1] == pytest.approx(2.0 / 3.0, abs=0.02)  # half as likely, for there are two such laws
