"""Numbers that stand for what was computed: shares, confidences, intervals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from carriage import MACHINE, repeats

from hil.diagnosis.answering.hypotheses import hypothesis_of, read_off_findings
from hil.diagnosis.answering.verdict import Standing, findings_of, verdict_of, what_may_act_too
from hil.diagnosis.diagnose import diagnose, removed_share
from hil.diagnosis.fitting.refit import Fitted
from hil.diagnosis.judging.gate import Gate
from hil.diagnosis.judging.judgement import Contender
from hil.diagnosis.ranking.naming import CAP_ASSUMED, CAP_UNCONFIRMED, Weighed, weighed
from hil.diagnosis.ranking.weighing import plausible_among, with_unsure
from hil.diagnosis.recorded.dropout import Dropout
from hil.diagnosis.residuals.mismatch import mismatch
from hil.diagnosis.result import EffectAt
from virtual_bus.effects.registry import effects

NOISE = 20000.0


def test_removed_share_is_of_what_stands_above_the_floor_and_of_nothing_below_it():
    assert removed_share(5.0, 3.0, 1.0) == pytest.approx(16.0 / 24.0)
    assert removed_share(1.05, 0.95, 1.0) == pytest.approx((1.05**2 - 0.95**2) / (1.05**2 - 1.0))
    assert removed_share(0.80, 0.79, 1.0) is None


def nothing_beside(*gains: float, excess: float = 0.0, tried: int = 100) -> float:
    base = Weighed(None, NOISE + excess, 0.0)
    sets = [Weighed(None, NOISE + excess - gain, 0.0, (gain,)) for gain in gains]
    _, nothing = weighed(sets, base, (NOISE, 0.0), tried)
    return nothing.confidence


def test_nothing_is_likely_where_the_best_of_many_gains_what_chance_does():
    chance = 2.0 * np.log(100.0)  # the best of so many
    assert nothing_beside(0.5 * chance) > 0.9
    assert 0.5 < nothing_beside(chance) < nothing_beside(0.5 * chance)
    assert nothing_beside(chance, tried=1) < nothing_beside(chance)
    assert nothing_beside(60.0, excess=60.0) < 0.01


@pytest.fixture(scope="module")
def no_repeats():
    return diagnose(MACHINE, repeats(1, seed=5, disturbance_N=0.01))


@pytest.mark.slow
def test_no_effect_has_a_computed_confidence_capped_where_the_noise_is_assumed(no_repeats):
    assert no_repeats.diagnosis.verdict in ("consistent", "retuned")
    assert no_repeats.diagnosis.noise == "assumed" and no_repeats.evidence.cap == CAP_ASSUMED
    confidences = {h.effects: h.confidence for h in no_repeats.diagnosis.hypotheses}
    assert () in confidences and max(confidences.values()) <= CAP_ASSUMED
    assert sum(confidences.values()) <= 1.0


def test_too_little_data_name_no_hypothesis():
    assert diagnose(MACHINE, repeats(3, duration_s=0.6)).diagnosis.hypotheses == ()


def test_a_retuned_numbers_interval_is_of_the_fit_beside_the_effects(friction):
    """Friction takes from the damper what it explains: beside it the damper is known less well than without."""
    diagnosis, tuning = friction.diagnosis, friction.tuning
    widths = {name: (value.ci95[1] - value.ci95[0]) / abs(value.nominal) for name, value in diagnosis.retuned.items()}
    alone = dict(zip(tuning.names, 2.0 * 1.96 * 0.1 * np.sqrt(np.diag(tuning.covariance)), strict=True))
    assert widths and all(width >= (1.0 - 1e-9) * alone[name] for name, width in widths.items())
    assert any(width > 1.02 * alone[name] for name, width in widths.items())


def fitted(name: str) -> Fitted:
    nothing = np.zeros(0)
    return Fitted((EffectAt(name, "carriage"),), (nothing,), nothing, nothing, 0.0, (), np.zeros((0, 0)), np.zeros(0))


def gate(share: float, *, passes: bool) -> Gate:
    trained, followed = (1e-9, 1e-9) if passes else (1e-5, 0.5)
    return Gate(1000.0, 20.0, 1.0, trained, 50.0, 8, 9.0, 500.0, followed, 0.0, share, True)


def contender(name: str, share: float, *, passes: bool = True) -> Contender:
    return Contender(fitted(name), 0.0, 0.0, 0.0, (gate(share, passes=passes),))


def set_of(step: Gate, *names: str) -> Contender:
    nothing = np.zeros(0)
    effects = tuple(EffectAt(name, "carriage") for name in names)
    fit = Fitted(effects, (nothing,) * len(effects), nothing, nothing, 0.0, (), np.zeros((0, 0)), nothing)
    return Contender(fit, 0.0, 0.0, 0.0, (step,) * len(effects))


def first_finding(*sets: tuple[Contender, float], cap: float):
    hypotheses = [Weighed(one.fitted, 0.0, 0.0, (1.0,), confidence) for one, confidence in sets]
    (found,) = findings_of([one for one, _ in reversed(sets)], hypotheses, [{}], cap, "ambiguous")  # in another order than by confidence
    return found


def test_sets_that_a_name_is_not_told_apart_from_stay_sets():
    def of(*names: str) -> Fitted:
        nothing = np.zeros(0)
        effects = tuple(EffectAt(name, "carriage") for name in names)
        return Fitted(effects, (nothing,) * len(effects), nothing, nothing, 0.0, (), np.zeros((0, 0)), np.zeros(0))

    passed = gate(0.6, passes=True)
    sets = [(of("cogging", "end_stop"), 0.3), (of("end_stop", "delay"), 0.2), (of("delay", "backlash"), 0.1), (of("cable_spring"), 0.0005)]
    contenders = [Contender(one, 0.0, 0.0, 0.0, (passed,) * len(one.effects)) for one, _ in sets]
    cogging, _ = findings_of(contenders, [Weighed(one, 0.0, 0.0, (1.0,), share) for one, share in sets], [{}, {}], 0.999, "ambiguous")
    said = cogging.document()
    assert [other["effect"] for other in said["ambiguous_with"]] == ["delay", "backlash"]
    assert [[other["effect"] for other in one] for one in said["ambiguous_sets"]] == [["end_stop", "delay"], ["delay", "backlash"]]
    assert "end_stop at carriage and delay at carriage fit nearly as well" in cogging.evidence_against
    assert "delay at carriage fits nearly as well" not in cogging.evidence_against


def test_a_plausible_set_with_an_effect_that_is_not_certain_is_listed_behind_the_others():
    """Under each finding where it holds all that was found and more, and in no count of what fits nearly as well."""
    found, rival = contender("viscous_friction", 0.6), contender("quadratic_friction", 0.6)
    beside = [set_of(gate(0.6, passes=False), "viscous_friction", name) for name in ("delay", "backlash")]
    sure = [Weighed(one.fitted, 0.0, 0.0, (1.0,), share) for one, share in ((found, 0.3), (rival, 0.2))]
    wide = [*sure, Weighed(beside[0].fitted, 0.0, 0.0, (1.0,), 0.1), Weighed(beside[1].fitted, 0.0, 0.0, (1.0,), 0.0005)]
    unsure = plausible_among(beside, wide)
    assert [h.fitted for h in unsure] == [beside[0].fitted]
    (finding,) = findings_of([found, rival], sure, [{}], 0.999, "ambiguous", unsure)
    assert [effect.effect for effect in finding.ambiguous_with] == ["quadratic_friction", "delay"]
    assert [len(one) for one in finding.ambiguous_sets] == [1, 2] and finding.confidence == 0.3
    assert not any("delay" in text for text in finding.evidence_against)
    assert what_may_act_too(()) == "" and "viscous_friction at carriage and delay at carriage" in what_may_act_too(unsure)


@pytest.mark.parametrize(("said", "left", "listed"), [(0.05, 0.2, 0.05), (0.6, 0.7, 0.3), (0.2, 0.1, 0.1), (0.2, 0.0, 0.0)])
def test_sets_with_an_effect_that_is_not_certain_are_hypotheses_behind_the_first(said, left, listed):
    """With no more confidence than the first has, nor than the others leave of what all names have."""
    first, second, none = (Weighed(None, 0.0, 0.0, (1.0,), confidence) for confidence in (0.3, 0.01, 0.0))
    doubtful = Weighed(None, 1.0, 0.0, (1.0,), said)
    ranked = with_unsure((first, second, none), (doubtful,), 0.31 + left)
    assert ranked[0] is first
    assert [h.confidence for h in ranked] == sorted((h.confidence for h in ranked), reverse=True)
    assert next(h.confidence for h in ranked if h.train == 1.0) == pytest.approx(listed)
    assert with_unsure((first, second), (), 0.5) == (first, second) and with_unsure((), (doubtful,), 0.5) == ()


ONE_OF_MANY = ("coulomb_friction", "delay", "backlash", "cable_spring", "end_stop", "cogging")
FILLED_UP = ["delay", "backlash", "cable_spring", "end_stop"]  # 0.915 and four times 0.015 are more than 0.999 of all


@pytest.mark.parametrize(
    ("verdict", "second", "listed", "near"),
    [
        ("ambiguous", 0.015, FILLED_UP, []),
        ("ambiguous", 0.02, FILLED_UP, ["delay"]),
        ("explained", 0.015, [], []),
        ("explained", 0.02, ["delay"], ["delay"]),
    ],
)
def test_what_is_listed_to_have_999_in_a_thousand_together_does_not_fit_nearly_as_well(verdict, second, listed, near):
    """And a name that stands alone is told apart from it."""
    contenders = [contender(name, 0.6) for name in ONE_OF_MANY]
    shares = [0.915, second, 0.015, 0.015, 0.015, 0.0005]
    hypotheses = [Weighed(one.fitted, 0.0, 0.0, (1.0,), share) for one, share in zip(contenders, shares, strict=True)]
    (found,) = findings_of(contenders, hypotheses, [{}], 0.999, verdict)
    assert [one.effect for (one,) in found.ambiguous_sets] == listed
    assert [one.effect for one in found.ambiguous_with] == listed
    assert [text for text in found.evidence_against if "nearly" in text] == [f"{name} at carriage fits nearly as well" for name in near]


def test_a_findings_evidence_is_its_own_sets():
    found = first_finding((contender("viscous_friction", 0.6), 0.6), (contender("coulomb_friction", 0.3), 0.3), cap=0.999)
    assert found.effect.effect == "viscous_friction" and any("explains 60.0%" in text for text in found.evidence_for)


def test_confidence_of_several_sets_together_is_capped_as_one_sets_is():
    both = (contender("viscous_friction", 0.6), 0.505), (contender("viscous_friction", 0.6), 0.495)
    assert first_finding(*both, cap=CAP_ASSUMED).confidence == CAP_ASSUMED
    unconfirmed = [(contender("viscous_friction", 0.6, passes=False), confidence) for confidence in (0.5, 0.4)]
    assert first_finding(*unconfirmed, cap=0.999).confidence == CAP_UNCONFIRMED


def test_a_diagnosis_says_what_its_likeliest_set_passed(friction):
    (finding,) = friction.diagnosis.findings
    best = next(c for c in friction.selection.contenders if c.fitted is friction.hypotheses[0].fitted)
    assert list(finding.evidence_for) == best.gates[0].evidence()[0]


@pytest.mark.parametrize(
    ("left", "said"), [(12.0, "unknown_physics"), (1.2, "retuned")], ids=["twelve times the noise", "what slow disturbances leave on nulls"]
)
def test_many_times_the_noise_is_never_called_retuned(left, said):
    nothing_passed = replace(gate(0.01, passes=False), gain=30.0)  # 20 is chance
    standing = Standing((nothing_passed,), (Weighed(None, 0.0, 0.0),), 20.0 * NOISE, left * NOISE, left * NOISE, NOISE, 8, "")
    assert verdict_of(standing)[0] == said


@pytest.mark.parametrize(
    ("here", "there", "said"),
    [(1.07, 1.03, "retuned"), (1.12, 1.03, "retuned"), (1.12, 1.5, "unknown_physics"), (1.3, 1.03, "unknown_physics")],
)
@pytest.mark.parametrize("agrees", [-1.0, 0.5])  # by chance two times in three where two deviations are predicted: that is no sign of it
def test_what_training_alone_shows_must_be_more_than_nulls_leave(here, there, said, agrees):
    """Where nothing is hidden, the mean of four repeats may be 7 % above its noise, along a load as well, which the held-out recording does
    not follow.
    """
    nothing_passed = replace(gate(0.01, passes=False), gain=60.0, predicted=2.0, seen=agrees)
    held_out = there * NOISE, there * NOISE, NOISE
    standing = Standing((nothing_passed,), (Weighed(None, 0.0, 0.0),), 20.0 * NOISE, here * NOISE, here * NOISE, NOISE, 8, "", held_out)
    assert verdict_of(standing)[0] == said


@pytest.mark.parametrize(("trained", "said"), [(0.9e-6, "unknown_physics"), (1.1e-6, "retuned")])
def test_what_chance_never_does_in_training_is_not_called_other_numbers(trained, said):
    """A spring that varies in time is fitted by one that hardens, which another motion does not follow."""
    refused = replace(gate(0.8, passes=False), gain=1600.0, trained=trained, followed=1.0, held_out_gain=-113.0)
    held_out = NOISE, NOISE, NOISE
    standing = Standing((refused,), (Weighed(None, 0.0, 0.0),), 2000.0 * NOISE, 1.07 * NOISE, 1.07 * NOISE, NOISE, 8, "", held_out)
    assert verdict_of(standing)[0] == said


@pytest.mark.parametrize(
    ("passes", "form", "said"), [(True, "it no longer swings", "unknown_physics"), (False, "it no longer swings", "retuned")]
)
def test_what_passes_but_for_its_form_is_there_without_a_name(passes, form, said):
    imitated = replace(gate(0.9, passes=passes), gain=30.0, lost_form=form)
    standing = Standing((imitated,), (Weighed(None, 0.0, 0.0),), 20.0 * NOISE, 1.02 * NOISE, 1.02 * NOISE, NOISE, 8, "")
    assert verdict_of(standing)[0] == said


def named(**standing) -> str:
    """The verdict on one set that passed and stands alone."""
    one = contender("viscous_friction", 0.9)
    hypotheses = (Weighed(one.fitted, NOISE, 0.0, (1.0,), 0.5, share=0.99),)
    numbers = {"retuned_misfit": 2.0 * NOISE, "best_misfit": NOISE} | standing
    return verdict_of(Standing(one.gates, hypotheses, 3.0 * NOISE, noise=NOISE, shown=8, missing="", **numbers))[0]


def test_a_name_does_not_stand_alone_where_training_shows_more_beside_it():
    """One of all effects tried beside it gains by chance as much on one machine in a hundred."""
    assert named(further=0.02) == "explained"
    assert named(further=0.005) == "ambiguous"


def test_a_last_effect_does_not_stand_alone_where_it_moves_the_recordings_by_so_little_that_other_laws_look_like_it():
    assert said_of(THREE[:1], share=0.92, gained=150.1)[0] == "explained"
    verdict, reason = said_of(THREE[:1], share=0.92, gained=149.9)
    assert verdict == "ambiguous" and "by 12.2 standard deviations" in reason and "known or not" in reason
    assert said_of(THREE[:2], share=0.92, gained=150.1)[0] == "explained"
    verdict, reason = said_of(THREE[:2], share=0.92, gained=149.9)
    assert verdict == "ambiguous" and "of which one effect shows by 12.2" in reason


def test_two_effects_do_not_stand_alone_where_they_leave_more_than_one_of_them_gains():
    """A clipped current leaves 13 000 of nine million, of which a load at the other axis takes 1450."""
    left = {"share": 0.92, "gained": 0.4 * NOISE, "retuned_misfit": 1e3 * NOISE}
    assert said_of(THREE[:2], best_misfit=1.45 * NOISE, **left)[0] == "explained"  # noise may be 8 % of it
    verdict, reason = said_of(THREE[:2], best_misfit=1.6 * NOISE, **left)
    assert verdict == "ambiguous" and "leave more above noise than one of them gains" in reason
    assert said_of(THREE[:1], best_misfit=1.6 * NOISE, **left)[0] == "explained"


@pytest.mark.parametrize(("times", "said"), [(0.0, "retuned"), (26.0, "unknown_physics")])
def test_held_out_recordings_far_from_the_retuned_machine_are_not_called_other_numbers(times, said):
    """Training does not reach a stop, or hardly moves."""
    nothing_passed = replace(gate(0.01, passes=False), gain=10.0)
    standing = Standing(
        (nothing_passed,), (Weighed(None, 0.0, 0.0),), 20.0 * NOISE, NOISE, NOISE, NOISE, 8, "", (9.0 * NOISE,) * 2 + (NOISE,),
        only_held_out=times,
    )  # fmt: skip
    verdict, reason = verdict_of(standing)
    assert verdict == said
    assert ("26 times the noise" in reason) == (said == "unknown_physics")


def test_a_name_does_not_stand_alone_where_what_fits_better_is_none():
    assert named(imitated="") == "explained"
    assert named(imitated="it slides for less than half of a stroke") == "ambiguous"


def said_of(names: Sequence[str], *, share: float, rival: float = 0.0, **standing) -> tuple[str, str]:
    """The verdict on a set that passed, beside one of a load with this confidence."""
    one = contender("coulomb_friction", 1.0)
    many = replace(one.fitted, effects=tuple(EffectAt(name, "carriage") for name in names))
    hypotheses = Weighed(many, 0.0, 0.0, confidence=0.52 * share, share=share), Weighed(fitted("constant_load"), 0.0, 0.0, confidence=rival)
    numbers = {"retuned_misfit": 2.0 * NOISE, "best_misfit": NOISE} | standing
    return verdict_of(Standing(one.gates, hypotheses, 3.0 * NOISE, noise=NOISE, shown=8, missing="", **numbers))


@pytest.mark.parametrize(
    ("left", "left_held_out", "said"),
    [(1.05, None, "ambiguous"), (1.05, 1.05, "ambiguous"), (1.1, 1.05, "unknown_physics"), (1.05, 1.1, "unknown_physics")],
)
def test_an_unlikely_set_is_a_name_where_it_leaves_nothing_above_noise_in_either_motion(left, left_held_out, said):
    held_out = None if left_held_out is None else (2.0 * NOISE, left_held_out * NOISE, NOISE)
    one = {"share": 0.2, "best_misfit": left * NOISE, "held_out": held_out}
    assert said_of(("coulomb_friction",), **one)[0] == said
    assert said_of(("coulomb_friction",), **one, is_noise_known=False)[0] == "unknown_physics"  # it is what the closest set leaves


THREE = ("coulomb_friction", "cogging", "end_stop")


@pytest.mark.parametrize("rival", [0.0, 0.045])
def test_three_effects_together_do_not_stand_alone(rival):
    """Whatever else is plausible: they are told apart from it."""
    assert said_of(THREE[:2], share=0.92, rival=rival)[0] == "explained"
    verdict, reason = said_of(THREE, share=0.92, rival=rival)
    assert verdict == "ambiguous" and "end_stop at carriage" in reason
    assert reason.endswith("3 known effects fit together; with so many, others that were not tried may fit as well")


@pytest.mark.parametrize("rival", [0.0, 0.045])
def test_the_reason_for_ambiguous_is_what_failed(rival):
    assert "training shows more" in said_of(THREE[:1], share=0.92, rival=rival, further=0.005)[1]
    assert "leaves 60% of" in said_of(THREE[:1], share=0.92, rival=rival, retuned_misfit=1.1 * NOISE, best_misfit=1.06 * NOISE)[1]
    for plausible in (0.2, 0.03):  # the first alone has less than 95 % of what both have
        assert said_of(THREE, share=0.6, rival=plausible)[1].endswith("do not tell apart from constant_load at carriage")


def test_what_is_not_sure_without_a_rival_names_the_catalogue_s_neighbours():
    verdict, reason = said_of(("coulomb_friction",), share=0.8)
    assert verdict == "ambiguous" and all(name in reason for name in effects()["coulomb_friction"].neighbours)


def test_only_what_is_left_for_certain_has_no_name():
    """The noise of a few repeats is known to a twelfth: 0.06 of it left of 0.1 is more than half, but not for certain. A name that leaves
    more than a tenth does not stand alone all the same.
    """
    assert named() == "explained"
    assert named(retuned_misfit=1.1 * NOISE, best_misfit=1.008 * NOISE) == "explained"
    assert named(retuned_misfit=1.1 * NOISE, best_misfit=1.012 * NOISE) == "ambiguous"
    assert named(retuned_misfit=1.1 * NOISE, best_misfit=1.06 * NOISE) == "ambiguous"
    assert named(retuned_misfit=1.5 * NOISE, best_misfit=1.4 * NOISE) == "unknown_physics"


def test_most_of_a_large_held_out_mismatch_left_is_no_explanation():
    assert named(held_out=(40.0 * NOISE, 30.0 * NOISE, NOISE)) == "unknown_physics"
    assert named(held_out=(40.0 * NOISE, 10.0 * NOISE, NOISE)) == "explained"
    assert named(held_out=(4.6 * NOISE, 4.5 * NOISE, NOISE)) == "explained"  # another motion has other noise


def test_a_law_whose_numbers_change_with_the_motion_is_no_explanation():
    assert named(drift=0.01) == "explained"
    assert named(drift=1e-6) == "unknown_physics"


@pytest.mark.parametrize(("count", "kind", "confidence"), [(3, "repeats", 0.99), (1, "assumed", 0.9)])
def test_what_is_read_off_is_no_surer_than_anything_without_repeats(count, kind, confidence):
    lost = Dropout(0.02, (0.01, 0.03), 1.0, "", 5.0)
    found = replace(mismatch(MACHINE, repeats(count, 1.0)), lost={"position_carriage": lost})
    (finding,) = read_off_findings(found)
    assert (found.noise.kind, str(finding.effect)) == (kind, "sample_dropout at position_carriage")
    assert finding.confidence == pytest.approx(confidence)


def test_what_is_read_off_alone_is_confirmed_and_nothing_at_all_is_not():
    nothing, lost = Weighed(None, 100.0, 50.0, confidence=0.9), EffectAt("sample_dropout", "position_carriage")
    alone, none = (hypothesis_of(nothing, [], read_off, True) for read_off in ([lost], []))
    assert (alone.effects, alone.is_confirmed, alone.parameters) == ((lost,), True, 0)
    assert (none.effects, none.is_confirmed, none.gained_held_out) == ((), False, 0.0)
    assert hypothesis_of(nothing, [], [], False).gained_held_out is None
