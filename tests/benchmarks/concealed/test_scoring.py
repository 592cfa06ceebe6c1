"""The scorer: intervals against tables, one answer against its truth, calibration of a tool that is calibrated and of one that is not."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest


def test_clopper_pearson_gives_the_published_limits() -> None:
    from concealed.intervals import clopper_pearson, upper_bound

    assert clopper_pearson(4, 20) == pytest.approx((0.0573, 0.4366), abs=1e-4)  # Newcombe 1998 quotes the exact interval's kind
    assert upper_bound(0, 300) == pytest.approx(1.0 - 0.05 ** (1.0 / 300.0))  # closed form for no hits
    assert upper_bound(0, 300) < 0.0100
    assert clopper_pearson(0, 10)[0] == 0.0
    assert clopper_pearson(10, 10)[1] == 1.0


def test_a_calibrated_tool_is_inside_the_band_and_a_boasting_one_is_not() -> None:
    from concealed.intervals import calibration

    rng = np.random.default_rng(3)
    said = rng.uniform(0.2, 1.0, 400)
    assert all(part["inside"] for part in calibration(said, rng.random(400) < said))
    assert not any(part["inside"] for part in calibration(said, rng.random(400) < said - 0.2))


def finding(
    effect: str, at: str, interval: tuple[float, float] = (11.0, 13.0), others: list[str] | tuple[object, ...] = ()
) -> dict[str, object]:
    return {
        "effect": effect, "at": at, "confidence": 0.9,
        "parameters": {"Fc": {"value": 12.0, "unit": "Nm", "ci95": list(interval)}},
        "ambiguous_with": [{"effect": other, "at": at} for other in others],
    }  # fmt: skip


def truth(**changes: int | list[dict[str, bool | dict[str, object] | float]] | str) -> dict[str, object]:
    effect = {
        "kind": "coulomb_friction", "at": "roll", "accepted_at": ["roll", "position_roll"], "accepted": ["coulomb_friction"],
        "tuned": False, "compare": {"Fc": 12.5},
    }  # fmt: skip
    location = {
        "channels": {"current_roll": 0.9, "position_roll": 0.1}, "time_s": [[0.0, 4.0]], "frequency_hz": [[0.0, 5.0]],
        "position": {"roll": {"intervals": [[0.0, 1.0]], "visited": [-1.0, 1.0]}},
    }  # fmt: skip
    each = [{"detectability": 20.0, "distances": {"viscous_friction": 9.0}, "separable": True}]
    return {
        "number": 3, "stratum": "single", "condition": "plain", "machine": "carm", "effects": [effect], "each": each, "detectability": 20.0,
        "location": location, "held_out_noise_rms": {"current_roll": 0.01, "position_roll": 1e-5},
    } | changes  # fmt: skip


def answer(
    verdict: str, findings: list[dict[str, object]], **more: object
) -> dict[str, dict[str, dict[str, object] | list[dict[str, object]] | str] | float]:
    diagnosis = {"verdict": verdict, "findings": findings, "hypotheses": [], "location": more.pop("location", {})}
    return {"number": 3, "exit_status": 0, "wall_s": 1.0, "diagnosis": diagnosis} | more


def test_the_right_name_at_the_right_place_is_right() -> None:
    from concealed.judging import judge

    judged = judge(answer("explained", [finding("coulomb_friction", "roll")]), truth())
    assert (judged.asked, judged.right, judged.wrong, judged.covered) == (True, True, False, (True,))


@pytest.mark.parametrize(
    ("law", "at", "family_right"),
    [("stribeck_friction", "roll", True), ("stribeck_friction", "propeller", False), ("viscous_friction", "roll", False)],
)
def test_another_law_of_the_family_at_the_place_is_right_but_for_the_law(law: str, at: str, family_right: bool) -> None:
    from concealed.judging import judge

    judged = judge(answer("explained", [finding(law, at)]), truth())
    assert (judged.right, judged.family_right) == (False, family_right)


def test_two_tools_are_told_apart_by_the_cases_that_one_alone_answers_well(tmp_path: Path) -> None:
    """Six that the earlier alone has right and none the other way: 2 / 2**6 by chance."""
    from dataclasses import asdict

    from concealed.judging import judge
    from concealed.pairing import write
    from concealed.trees import in_short, kept

    earlier, today = "a" * 40, "b" * 40
    right, other = [finding("coulomb_friction", "roll")], [finding("viscous_friction", "roll")]
    for tool, rights in ((earlier, range(7)), (today, range(6, 7))):
        lines = []
        for number in range(8):
            given = answer("ambiguous", right if number in rights else other, commit=tool) | {"number": number, "processor_s": 2.0 + number}
            given |= {"machine": "carm", "colour": "white", "judged": asdict(judge(given, truth(number=number)))}
            lines.append(json.dumps(in_short(given)))
        kept(tmp_path, tool).write_text("\n".join(lines) + "\n")
    text = write(tmp_path, (earlier, today))
    written = json.loads((tmp_path / "paired_aaaaaaaa_bbbbbbbb.json").read_text())
    asked = next(row for row in written["questions"] if row["question"].startswith("right, single"))
    assert [asked[key] for key in ("n", "both", "first alone", "second alone", "neither")] == [8, 1, 6, 0, 1]
    assert asked["p"] == pytest.approx(2.0 / 2**6, abs=1e-4)
    assert written["groups"]["separation"].keys() == {"5 to 10"}  # the nearest other name is 9 deviations away
    assert "| right, single effects the oracle separates | 8 | 7 | 1 | 6 | 0 | 0.031 |" in text


def test_the_order_of_cases_is_by_lot_and_the_arm_comes_last(tmp_path: Path) -> None:
    from concealed.making import Places, case_of, export_models
    from concealed.trees import order

    places = Places(tmp_path, "development")
    export_models(places)
    drawn = order(places, range(60), 3)
    assert drawn == order(places, range(59, -1, -1), 3)
    is_arm = [case_of(places, number).machine == "carm" for number in drawn]
    assert is_arm == [False] * (len(drawn) - 3) + [True] * 3
    assert drawn[:10] != sorted(drawn[:10])


def test_a_tree_answers_as_its_command_does_and_a_late_answer_is_none() -> None:
    from concealed.trees import ROOT, Answering, commit_of

    ask = Answering(ROOT)
    assert ask("machine", "show", "turntable")["exit_status"] == 0
    refused = ask("machine", "show", "no_such_machine")
    assert refused["exit_status"] == 2
    assert "no_such_machine" in refused["said"]
    assert ask("machine", "check", "carm", limit_s=0.01)["exit_status"] is None
    ask.close()
    with pytest.raises(SystemExit, match="no commit of this repository"):
        commit_of("no-such-commit")


def test_an_amplitude_is_compared_at_its_own_joint_and_a_frequency_at_the_spring_behind_it_too() -> None:
    from concealed.judging import judge

    names = ["roll", "roll", "roll_rotor", "position_roll", "roll_gear", "c_arc"]
    effect = truth()["effects"][0] | {"kind": "base_motion", "accepted": ["base_motion"], "accepted_at": names}
    hidden = truth(effects=[effect | {"compare": {"A": 12.0, "f": 9.0}}])
    said = {"effect": "base_motion", "confidence": 0.9, "parameters": {"A": {"ci95": [1.0, 2.0]}, "f": {"ci95": [8.9, 9.1]}}}
    for at, covered in (("roll", (False, True)), ("roll_rotor", (False, True)), ("c_arc", (True,))):
        assert judge(answer("explained", [said | {"at": at}]), hidden).covered == covered


def test_a_friction_named_where_two_add_is_neither_of_them() -> None:
    """Fc 2.5 beside one of 10 and 22 by direction: the one that is named finds their mean, 18.5."""
    from concealed.judging import judge

    effect, own = truth()["effects"][0], truth()["each"][0]
    kind, compare = "asymmetric_friction", {"Fc_plus": 10.0, "Fc_minus": 22.0}
    other = effect | {"kind": kind, "accepted": [kind], "compare": compare}
    hidden = truth(effects=[other, effect | {"compare": {"Fc": 2.5}}], each=[own, own | {"distances": {kind: 0.4}}])
    named = [finding("coulomb_friction", "roll", (17.0, 20.0))]
    assert judge(answer("ambiguous", named), hidden).covered == ()
    assert judge(answer("ambiguous", [*named, finding(kind, "roll")]), hidden).covered == (False,)  # both are named: each has its own
    apart = truth(effects=[other | {"at": "propeller", "accepted_at": ["propeller"]}, hidden["effects"][1]], each=hidden["each"])
    assert judge(answer("ambiguous", named), apart).covered == (False,)  # at another joint: nothing adds


def test_one_friction_named_where_two_of_its_law_add_is_neither_of_them() -> None:
    from concealed.judging import judge

    effect, own = truth()["effects"][0], truth()["each"][0]
    hidden = truth(effects=[effect | {"compare": {"Fc": 2.5}}, effect | {"compare": {"Fc": 10.0}}], each=[own, own])
    named = finding("coulomb_friction", "roll", (12.0, 13.0))
    assert judge(answer("ambiguous", [named]), hidden).covered == ()
    assert judge(answer("ambiguous", [named, finding("coulomb_friction", "position_roll", (2.0, 3.0))]), hidden).covered != ()


def test_effects_whose_truth_does_not_say_how_far_they_stand_apart_are_not_passed_over() -> None:
    from concealed.judging import judge

    hidden = truth(condition="little")  # nobody is asked for a name, intervals are compared all the same
    assert judge(answer("explained", [finding("coulomb_friction", "roll")]), hidden).covered == (True,)
    del hidden["each"]
    with pytest.raises(ValueError, match="zip"):
        judge(answer("explained", [finding("coulomb_friction", "roll")]), hidden)


@pytest.mark.parametrize(
    ("verdict", "findings", "right", "wrong"),
    [
        ("explained", [finding("viscous_friction", "roll")], False, True),
        ("explained", [finding("coulomb_friction", "propeller")], False, True),
        ("explained", [finding("coulomb_friction", "roll"), finding("delay", "roll")], False, True),
        ("ambiguous", [finding("viscous_friction", "roll", others=["coulomb_friction"])], False, False),
        ("unknown_physics", [], False, False),
        ("consistent", [], False, False),
    ],
)
def test_what_is_not_right(verdict: str, findings: list[dict[str, object]], right: bool, wrong: bool) -> None:
    from concealed.judging import judge

    judged = judge(answer(verdict, findings), truth())
    assert (judged.right, judged.wrong) == (right, wrong)
    assert judged.holds_truth is (verdict == "ambiguous") or "coulomb_friction@roll" in judged.findings


def test_a_set_without_an_effect_that_no_recording_shows_lacks_the_truth_but_nothing_that_is_shown() -> None:
    from concealed.judging import judge

    hidden, faint = truth(), {**truth()["effects"][0], "kind": "backlash", "accepted": ["backlash"]}
    hidden["effects"].append(faint)
    named = answer("ambiguous", [finding("viscous_friction", "roll", others=["coulomb_friction"])])
    for distance, holds_shown in ((0.4, True), (5.4, False)):
        hidden["each"] = [truth()["each"][0], {"detectability": distance, "distances": {}, "separable": False}]
        judged = judge(named, hidden)
        assert (judged.holds_truth, judged.holds_shown) == (False, holds_shown)
    hidden["each"] = [{"detectability": 0.4, "distances": {}, "separable": False}] * 2
    assert judge(named, hidden).holds_shown is None


def test_an_alarm_on_a_null_and_a_confident_name_off_the_catalogue() -> None:
    from concealed.judging import judge

    null = truth(stratum="null", effects=[], each=[])
    assert judge(answer("unknown_physics", []), null).alarm
    assert not judge(answer("retuned", []), null).alarm
    off = truth(stratum="off", effects=[{**truth()["effects"][0], "kind": "sloshing_mass", "accepted": []}])
    judged = judge(answer("explained", [finding("coulomb_friction", "roll")]), off)
    assert judged.confident
    assert judged.wrong
    assert not judged.right


def test_every_kind_says_what_it_was_called_instead() -> None:
    from concealed.judging import judge
    from concealed.scoring import by_kind

    answers = [
        answer("explained", [finding("coulomb_friction", "roll")]),
        answer("explained", [finding("viscous_friction", "roll")]),
        answer("ambiguous", [finding("viscous_friction", "roll"), finding("delay", "roll")]),
        answer("retuned", []),
        answer("unknown_physics", [finding("coulomb_friction", "roll")]),
        answer("explained", [finding("coulomb_friction", "propeller")]),
    ]
    (row,) = by_kind([judge(one, truth()) for one in answers])
    assert (row["kind"], row["asked"], row["right"], row["confident"], row["nothing"]) == ("coulomb_friction", 6, 1, 2, 1)
    assert row["instead"] == {"viscous_friction": 1, "delay and viscous_friction": 1, "": 1, "coulomb_friction elsewhere": 1}


def test_removed_share_and_overlap() -> None:
    from concealed.judging import judge

    rms = {"retuned": {"current_roll": 0.03, "position_roll": 1e-5}, "extended": {"current_roll": 0.01, "position_roll": 1e-5}}
    location = {
        "channels": {"current_roll": 0.8, "position_roll": 0.2}, "time_s": {"run_1": [[2.0, 6.0]]}, "frequency_hz": [[0.0, 10.0]],
        "position": {"roll": [[0.0, 1.0]]},
    }  # fmt: skip
    judged = judge(answer("explained", [finding("coulomb_friction", "roll")], location=location, held_out_rms=rms), truth())
    assert judged.removed == pytest.approx(1.0)  # (5 - 1) / (5 - 1)
    assert judged.channel_right
    assert judged.overlap["time"] == pytest.approx(2.0 / 6.0)
    assert judged.overlap["frequency"] == pytest.approx(np.log2(50.0) / np.log2(100.0))
    assert judged.overlap["position"] == pytest.approx(1.0)


def test_of_a_pair_a_changed_number_may_be_left_to_retuning_and_the_other_must_be_named() -> None:
    from concealed.judging import judge

    friction = truth()["effects"][0]
    payload = {**friction, "kind": "payload", "accepted": ["payload"], "accepted_at": ["c_arc"], "tuned": True, "compare": {}}
    pair = truth(stratum="pair", condition="equal", effects=[payload, friction], each=truth()["each"] * 2)
    assert judge(answer("explained", [finding("coulomb_friction", "roll")]), pair).right
    assert judge(answer("explained", [finding("coulomb_friction", "roll"), finding("payload", "c_arc")]), pair).right
    assert not judge(answer("explained", [finding("payload", "c_arc")]), pair).right
    assert not judge(answer("retuned", []), pair).right
