"""Confidence in names, from misfits alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hil.diagnosis.fitting.information import Form
from hil.diagnosis.fitting.refit import Fitted
from hil.diagnosis.judging.errors_of_laws import WEIGHTS, Removing, numbers_of, temperature, temperature_of
from hil.diagnosis.ranking.compared import Compared
from hil.diagnosis.ranking.exactness import Part, exactness
from hil.diagnosis.ranking.naming import (
    CAP_ASSUMED,
    CONFIDENT,
    LIKELIER,
    LISTED,
    Evidence,
    Weighed,
    imitated,
    not_told_apart,
    ranking,
    unnamed_share,
    weighed,
)
from hil.diagnosis.ranking.rarity import UNLIKE_ONE, UNLIKE_ONE_PART, rarity_of
from hil.diagnosis.residuals.excess import certain_excess
from hil.diagnosis.result import EffectAt
from hil.machine import load_machine

NOISE = 20000.0
ENTRIES = 19000.0
TRIED = 50
ENERGETIC = 1e8
ALONE = CONFIDENT * (1.0 - WEIGHTS.outside)
CERTAIN = 1.0 - WEIGHTS.outside


def confidences(base, *misfits, freedom=None, cap=1.0):
    """Of sets with these misfits above noise, in the order given."""
    freedom = freedom or [1] * len(misfits)
    sets = [Weighed(None, ENTRIES + misfit, 0.0, (base,) * k) for misfit, k in zip(misfits, freedom, strict=True)]
    ranked, _ = weighed(sets, Weighed(None, ENTRIES + base, 0.0), (ENTRIES, 0.0), TRIED, cap)
    return [next(r.confidence for r in ranked if r.misfit == h.misfit and r.information == h.information) for h in sets]


def test_a_set_that_alone_removes_what_is_there_is_certain():
    right, wrong = confidences(400.0, 0.0, 200.0)
    assert right > ALONE
    assert wrong < 0.01


@pytest.mark.parametrize(("scatter", "stands_alone"), [(1.0, True), (30.0, False)])
def test_names_are_told_apart_in_units_of_the_noise_along_their_difference(scatter, stands_alone):
    """Disturbances at reversals are ten times the noise model's along every friction."""
    first = Weighed(None, ENTRIES, 0.0, (400.0,))
    compared = Compared((ENTRIES, 0.0), (40.0, 0.0), (40.0, 0.0), scatter=scatter)
    second = Weighed(None, ENTRIES + 40.0, 0.0, (400.0,), compared=compared)
    ranked, _ = weighed([first, second], Weighed(None, ENTRIES + 400.0, 0.0), (ENTRIES, 0.0), TRIED)
    assert (ranked[0].confidence > ALONE) is stands_alone
    assert ranked[0].misfit == first.misfit


@pytest.mark.parametrize(("known", "stands_alone"), [(0.0, False), (26000.0, True)])
def test_what_two_sets_have_in_common_errs_alike_in_both(known, stands_alone):
    """Beside an inertia that removes 26 000 two errors of a gear differ by 250: of it is known how the inertia errs."""
    entries, one = 27000.0, Weighed(None, 27000.0, 0.0, (26000.0, 1100.0))
    compared = Compared((entries, 0.0), (250.0, 0.0), (250.0, 0.0), known=(known, 0.0))
    other = Weighed(None, entries + 250.0, 0.0, (26000.0, 850.0), compared=compared)
    ranked, _ = weighed([one, other], Weighed(None, entries + 27100.0, 0.0), (entries, 0.0), TRIED)
    assert (ranked[1].confidence < 0.02 * ranked[0].confidence) is stands_alone


def test_exact_equations_have_no_errors_that_explain_what_a_set_gains():
    """Of what the first gains more, errors of what both have in common explain all but nothing."""
    entries, one = 1000.0, Weighed(None, 1000.0, 0.0, (26000.0, 500.0))
    compared = Compared((entries, 0.0), (40.0, 0.0), (-240.0, 0.0), known=(26000.0, 0.0))
    other = Weighed(None, entries + 40.0, 0.0, (26000.0, 460.0), compared=compared)
    ranked, _ = weighed([one, other], Weighed(None, entries + 26500.0, 0.0), (entries, 0.0), TRIED)
    assert ranked[0].information == other.information
    assert ranked[1].share > 0.9 * WEIGHTS.exact


@pytest.mark.parametrize("form_error", [0.0, 0.0099])
def test_a_set_that_had_to_move_far_leaves_no_less_than_it_leaves_there(form_error):
    """An eccentricity misses another motion by 660 and, where both motions want it, by 25. Repeats scatter, but 660 may not count as less
    than the 635 that moving brings.
    """
    compared = Compared((1000.0, 1000.0), (12.0, 660.0), (12.0, 641.0), by_moving=(75.0, -635.0), scatter=1.4)
    for part, left in enumerate((87.0, 25.0)):
        assert 1000.0 <= compared.in_units(part, 1.0, form_error) <= 1000.0 + left


def test_what_errors_explain_of_a_difference_goes_as_it_goes_by_moving():
    """Where errors explain 600 of 660 with training's parameters, 635 less is no better than the other set."""

    def beyond(by_moving: float) -> float:
        return Compared((0.0, 0.0), (0.0, 660.0), (0.0, 60.0), by_moving=(0.0, by_moving)).in_units(1, 1.0, 0.01)

    assert [beyond(by) for by in (0.0, -1e-6, -330.0, -635.0)] == pytest.approx([60.0, 60.0, 30.0, 25.0 * 60.0 / 660.0], abs=1e-5)
    assert beyond(-700.0) == pytest.approx(-40.0)  # errors explain nothing of what the other set leaves more


def test_sets_that_fit_alike_share_the_confidence():
    assert confidences(400.0, 0.0, 1e-6) == pytest.approx([0.5 * CERTAIN, 0.5 * CERTAIN], abs=0.02)


@pytest.mark.parametrize(("named", "formless", "most"), [(200.0, 0.0, True), (0.0, 200.0, False)])
def test_what_fits_better_than_every_name_without_its_form_has_the_larger_share(named, formless, most):
    """A relaxing spring is no cable where a hysteresis that hardly slides leaves 200 less of 1600."""
    fits = Fitted((), (), np.zeros(0), np.zeros(0), 0.0, (), np.zeros((0, 0)), np.zeros(0))
    sets = [Weighed(replace(fits), ENTRIES + misfit, 0.0, (1600.0,) * count) for misfit, count in ((named, 3), (formless, 4))]
    base = Weighed(None, ENTRIES + 1600.0, 0.0)
    share, likeliest = imitated(Evidence((sets[0],), base, ENTRIES, 0.0, TRIED, True, formless=(sets[1],)))
    assert likeliest is not None and likeliest.fitted is sets[1].fitted
    assert (share > LIKELIER) is most
    assert imitated(Evidence((sets[0],), base, ENTRIES, 0.0, TRIED, True)) == (0.0, None)


def test_a_set_without_its_form_counts_once():
    """However often it was fitted, and whatever was found beside it."""
    spring, mode, load = (EffectAt(name, "hinge") for name in ("nonlinear_stiffness", "structural_mode", "constant_load"))

    def weighed_set(misfit: float, *effects: EffectAt) -> Weighed:
        own = Fitted(effects, (np.ones(1),) * len(effects), np.zeros(0), np.zeros(0), 0.0, (), np.zeros((0, 0)), np.zeros(0))
        return Weighed(own, ENTRIES + misfit, 0.0, (1600.0,) * 3)

    def share(*formless: Weighed) -> tuple[float, Weighed | None]:
        base = Weighed(None, ENTRIES + 1600.0, 0.0)
        return imitated(Evidence((weighed_set(100.0, spring),), base, ENTRIES, 0.0, TRIED, True, formless=formless))

    one = weighed_set(100.0, mode)
    once = share(one)[0]
    assert 0.4 < once < LIKELIER
    for again in (weighed_set(102.0, mode), weighed_set(101.0, mode, load)):
        assert share(one, again)[0] == pytest.approx(once, rel=0.02)
    closer = weighed_set(-20.0, mode, load)  # what is found beside it may be what counts
    assert share(one, closer)[0] > once and share(one, closer)[1].fitted is closer.fitted
    assert share(one, weighed_set(100.0, load))[0] > LIKELIER  # another set is another chance


def test_sets_that_fit_alike_are_as_likely_as_there_are_fewer_of_their_size():
    """Of 50 effects there are 1225 pairs and 19 600 triples. Beside nothing and the unknown sizes change nothing."""
    names = [EffectAt(name, "hinge") for name in ("coulomb_friction", "constant_load", "cable_spring", "asymmetric_friction")]

    def sets(*sizes: int) -> list[Weighed]:
        fits = [
            Fitted(tuple(names[:k]), (np.ones(1),) * k, np.zeros(0), np.zeros(0), 0.0, (), np.zeros((0, 0)), np.zeros(0)) for k in sizes
        ]
        return [Weighed(fit, ENTRIES, 0.0, (400.0,) * 3) for fit in fits]

    base = Weighed(None, ENTRIES + 60.0, 0.0)
    (pair, triple), nothing = weighed(sets(2, 3), base, (ENTRIES, 0.0), TRIED)
    assert pair.share / triple.share == pytest.approx(19600.0 / 1225.0)
    assumed = Evidence(tuple(sets(2, 3)), base, ENTRIES, 0.0, TRIED, True, is_noise_known=False)
    pair, triple = (h for h in ranking(assumed) if h.fitted is not None)
    assert pair.share == pytest.approx(triple.share)  # an assumed noise is a bound, in units of which effects gain too little already
    (one, same), other = weighed(sets(1, 1), base, (ENTRIES, 0.0), TRIED)
    assert one.share == pytest.approx(same.share)
    assert other.share == pytest.approx(nothing.share)


def test_small_differences_between_large_effects_prove_nothing():
    one, other = confidences(1e6, 2000.0, 5000.0)
    assert one < ALONE
    assert other > 0.04


def test_more_parameters_must_gain_more():
    simple, complex_ = confidences(400.0, 3.0, 0.0, freedom=[1, 5])
    assert simple > complex_


def test_what_leaves_most_of_it_is_no_name():
    assert max(confidences(6000.0, 4500.0, 5400.0)) < 0.5 * CERTAIN


def test_confidence_is_capped_where_the_noise_is_assumed():
    assert max(confidences(4000.0, 0.0, 3000.0, cap=CAP_ASSUMED)) == pytest.approx(CAP_ASSUMED * CERTAIN)
    assert max(confidences(4000.0, 0.0, 3000.0)) > 1.05 * CAP_ASSUMED * CERTAIN


def test_a_name_stands_alone_only_where_it_would_if_equations_were_exact():
    simple, closer = confidences(10000.0, 80.0, 0.0, freedom=[1, 4])
    assert simple < ALONE
    assert closer > 0.04


def test_what_is_left_above_noise_is_the_share_without_a_name():
    assert unnamed_share(NOISE + 4000.0, NOISE, NOISE) == 0.0
    left = 0.25 * 4000.0 + certain_excess(NOISE)
    assert unnamed_share(NOISE + 4000.0, NOISE + left, NOISE) == pytest.approx(0.25)


def test_without_repeats_a_name_may_stand_alone_with_the_confidence_capped():
    """What even the best set leaves takes a little of every share: of one capped before, the rest would never reach what stands alone."""
    left = certain_excess(NOISE) + 0.001 * 4000.0
    sets = (Weighed(None, NOISE + left, 0.0, (4000.0,)), Weighed(None, NOISE + 3000.0, 0.0, (1000.0,)))
    evidence = Evidence(sets, Weighed(None, NOISE + 4000.0, 0.0), NOISE, 0.0, TRIED, found=True, cap=CAP_ASSUMED)
    best = ranking(evidence)[0]
    assert best.confidence <= CAP_ASSUMED * CERTAIN
    assert best.share >= CONFIDENT


def shares(*sets: tuple[float, float, tuple[float, ...]], base: tuple[float, float], entries=(ENTRIES, ENTRIES)) -> list[float]:
    """Of sets with these misfits above the entries on training and held-out recordings, and this information."""
    made = [Weighed(None, entries[0] + train, entries[1] + held_out, information) for train, held_out, information in sets]
    ranked, _ = weighed(made, Weighed(None, entries[0] + base[0], entries[1] + base[1]), entries, TRIED)
    return [next(r.share for r in ranked if r.misfit == h.misfit and r.information == h.information) for h in made]


def test_a_parameter_that_the_recordings_do_not_see_costs_nothing():
    simple, blind, seen = shares((0.0, 0.0, (9000.0,)), (0.0, 0.0, (9000.0, 0.0)), (0.0, 0.0, (9000.0, 3000.0)), base=(9000.0, 0.0))
    assert simple == pytest.approx(blind)
    assert seen < 0.5 * simple


def test_what_a_number_of_the_machine_file_removes_tempers_nothing():
    """A torque constant a thousand times above noise, and with it a load that gains 200: the constant's equation is the machine's own."""

    def share_of_both(by_numbers: float) -> float:
        one = Weighed(None, ENTRIES + 200.0, 0.0, (1e6,), by_numbers=(by_numbers, 0.0))
        both = Weighed(None, ENTRIES, 0.0, (1e6, 200.0), by_numbers=(by_numbers, 0.0))
        ranked, _ = weighed([one, both], Weighed(None, ENTRIES + 1e6, 0.0), (ENTRIES, 0.0), TRIED)
        return next(r.share for r in ranked if r.misfit == both.misfit)

    assert share_of_both(1e6) > CONFIDENT
    assert share_of_both(0.0) < 0.8


def test_a_number_that_leaves_more_than_the_best_set_s_equation_errs_by_is_not_counted():
    sets = [Removing(ENTRIES), Removing(ENTRIES + 3000.0, 7000.0)]
    near = Removing(ENTRIES + 10.0, 9990.0)
    assert temperature_of(sets, ENTRIES + 10000.0, ENTRIES) == temperature(10000.0, 0.0)
    assert temperature_of([*sets, near], ENTRIES + 10000.0, ENTRIES) == pytest.approx(temperature(10.0, 0.0) + 0.0999)


def test_an_exact_effect_that_is_no_number_of_the_file_does_not_make_a_closer_one_s_equation_exact():
    """A delay that leaves 10 more than a drive's low pass, each of which may stand for the other."""
    low_pass, delay = Removing(ENTRIES), Removing(ENTRIES + 10.0, 9990.0, of_the_file=False)
    assert temperature_of([low_pass, delay], ENTRIES + 10000.0, ENTRIES) == temperature(10000.0, 0.0)
    assert temperature_of(
        [low_pass._replace(misfit=ENTRIES + 10.0), Removing(ENTRIES, 10000.0, of_the_file=False)], ENTRIES + 10000.0, ENTRIES
    ) == pytest.approx(temperature(0.0, 0.0) + 0.1)


def test_another_motion_s_noise_above_the_model_s_decides_no_name():
    """The held-out recording is 4.5 times as noisy as the repeats; what one name gains there the other gains in training."""
    held_out = 3.5 * ENTRIES
    one, other = shares((30.0, held_out, (9000.0,)), (0.0, held_out + 135.0, (9000.0,)), base=(9000.0, held_out + 700000.0))
    assert one == pytest.approx(other, abs=0.1)


def test_noise_of_another_motion_hides_no_name_that_training_shows():
    """Held out a fifth more than noise is left by every set and by none: where nothing is hidden that is not rare in other motions."""
    (name,) = shares((0.0, 0.2 * ENTRIES, (60.0,)), base=(60.0, 0.2 * ENTRIES + 30.0))
    assert name > CONFIDENT


def test_what_training_leaves_above_its_repeats_noise_speaks_for_the_unknown():
    (name,) = shares((0.2 * ENTRIES, 0.0, (60.0,)), base=(0.2 * ENTRIES + 60.0, 30.0))
    assert name < 0.5


def test_an_equation_errs_in_each_motion_by_a_share_of_what_it_does_there():
    """One name leaves 200 of 2000 in training, ten times what equations err by; held out both remove a hundred times as much."""
    one, other = shares((0.0, 0.0, (2000.0,)), (200.0, 0.0, (2000.0,)), base=(2000.0, 200000.0))
    assert one > 0.9
    assert other < 0.1


def test_a_channel_that_has_lost_a_part_of_its_sign_is_no_number_of_the_machine_file():
    effects = tuple(EffectAt(*each) for each in (("viscous_friction", "belt"), ("coulomb_friction", "belt"), ("rectified_sensor", "speed")))

    def known(share: float, sign: float) -> set[str]:
        values = (np.array([1.0]), np.array([2.0]), np.array([share, sign]))
        return {
            effect.effect
            for effect in numbers_of(Fitted(effects, values, np.zeros(0), np.zeros(0), 0.0, (), np.zeros((0, 0)), np.zeros(0)))
        }

    assert known(1.0, 1.0) == known(0.0, -1.0) == {"viscous_friction", "rectified_sensor"}
    assert known(0.88, 1.0) == known(0.0, 0.02) == {"viscous_friction"}
    assert numbers_of(None) == set()


def test_what_turns_leaves_no_room_for_another_law():
    """A late drive does: within a sample it may shift its target or mix it with the one before."""
    names = ("gear_ratio", "imu_misalignment", "delay", "imu_scale_bias", "coulomb_friction", "drive_bandwidth")
    effects, none = tuple(EffectAt(name, "belt") for name in names), np.zeros(0)
    known = numbers_of(Fitted(effects, (np.ones(1),) * len(names), none, none, 0.0, (), np.zeros((0, 0)), none))
    assert {effect.effect for effect in known} == set(names[:2])


def test_the_unknown_is_one_law_and_seldom_does_what_several_known_effects_do():
    """Eight parameters and the search for two effects cost a little more than the unknown does."""

    def share(rarity: float) -> float:
        found = Weighed(None, ENTRIES, 0.0, (60.0,) * 8, searched=10.0, rarity=rarity)
        ((ranked,), _) = weighed([found], Weighed(None, ENTRIES + 600.0, 0.0), (ENTRIES, 0.0), TRIED)
        return ranked.share

    assert share(0.0) < 0.45
    assert 0.5 < share(UNLIKE_ONE) < CONFIDENT
    assert share(UNLIKE_ONE) + 0.1 < share(UNLIKE_ONE_PART) < CONFIDENT


def test_what_the_unknown_is_charged_goes_smoothly_from_the_single_effect_to_the_pair():
    """As the pair's price passes the single effect's, a hundredth of log evidence moves no share by more than that."""

    def named(searched: float, rarity: float = UNLIKE_ONE_PART) -> float:
        single = Weighed(None, ENTRIES + 4.0, 0.0, (60.0,) * 8, searched=10.0)
        pair = Weighed(None, ENTRIES, 0.0, (60.0,) * 8, searched=searched, rarity=rarity)
        ranked, _ = weighed([single, pair], Weighed(None, ENTRIES + 600.0, 0.0), (ENTRIES, 0.0), TRIED)
        return sum(one.share for one in ranked)

    totals = [named(searched) for searched in np.arange(9.0, 14.0, 0.01)]
    assert np.max(np.abs(np.diff(totals))) < 0.01
    assert named(9.0) > named(9.0, 0.0) + 0.1  # the pair is likelier
    assert named(25.0) == pytest.approx(named(25.0, 0.0), abs=1e-3)  # the single effect is by far: what one law is seldom does not matter


def test_several_effects_at_one_axis_are_less_rare_for_one_law_than_at_several():
    carm = load_machine("carm").plant
    cogging, spring = EffectAt("cogging", "roll_rotor"), EffectAt("cable_spring", "roll")
    assert rarity_of((cogging,), carm) == 0.0
    assert rarity_of((cogging, spring, EffectAt("clock_offset", "position_roll")), carm) == UNLIKE_ONE
    assert rarity_of((cogging, EffectAt("cogging", "roll")), carm) == UNLIKE_ONE  # of one kind, at another place
    assert rarity_of((cogging, EffectAt("cable_spring", "propeller")), carm) == UNLIKE_ONE_PART > UNLIKE_ONE


def test_an_imu_belongs_to_what_carries_it():
    """One law that bends the C shows at the axis and in the IMU that it carries."""
    carm = load_machine("carm").plant
    bias = EffectAt("imu_scale_bias", "imu")
    assert rarity_of((EffectAt("coulomb_friction", "roll"), bias), carm) == UNLIKE_ONE
    assert rarity_of((EffectAt("coulomb_friction", "propeller"), bias), carm) == UNLIKE_ONE_PART


def test_two_waves_of_one_kind_at_one_place_are_one_law():
    carm = load_machine("carm").plant
    waves = EffectAt("cogging", "roll"), EffectAt("cogging", "roll", 2)
    assert rarity_of(waves, carm) == 0.0
    assert rarity_of((*waves, EffectAt("cable_spring", "roll")), carm) == UNLIKE_ONE


def test_a_term_that_was_fitted_to_nothing_costs_the_choice_and_no_more():
    alone = Weighed(None, ENTRIES, 0.0, (400.0,))
    with_a_term = Weighed(None, ENTRIES, 0.0, (400.0, 1e9), simpler=((0.0, (400.0,)),))
    assert with_a_term.price() - alone.price() == pytest.approx(np.log(2.0), abs=1e-3)


def test_a_term_that_is_there_costs_what_it_is_narrowed_by_and_the_choice():
    whole = Weighed(None, ENTRIES, 0.0, (400.0, 300.0))
    chosen = Weighed(None, ENTRIES, 0.0, (400.0, 300.0), simpler=((300.0, (400.0,)),))
    assert chosen.price() - whole.price() == pytest.approx(np.log(2.0), abs=1e-6)
    tempered = chosen.in_units(100.0, 1.0)  # where 300 are little, both count
    assert tempered.price() < 0.5 * np.log(1.0 + 4.0) + 0.5 * np.log(1.0 + 3.0) + np.log(2.0)


@pytest.mark.parametrize("temper", [1.0, 100.0])
def test_a_price_in_units_of_an_error_is_that_of_what_is_counted_in_them(temper):
    chosen = Weighed(None, ENTRIES, 0.0, (400.0, 300.0), searched=2.0, simpler=((300.0, (400.0,)), (500.0, (200.0,))))
    assert chosen.price(temper) == pytest.approx(chosen.in_units(temper, 1.0).price())


def test_a_set_is_priced_by_what_its_fit_says_of_its_simpler_forms():
    nothing = np.zeros(0)
    whole = Fitted(
        (EffectAt("cable_spring", "arm"),), (nothing,), nothing, nothing, 0.0, (), np.zeros((0, 0)), np.array([ENERGETIC, ENERGETIC])
    )
    known = Weighed(None, ENTRIES, 0.0)
    with_forms = known.priced_as(replace(whole, simpler=(Form(0.0, np.array([ENERGETIC]), (1,)),)))
    assert known.priced_as(whole).price() == pytest.approx(np.log1p(ENERGETIC))
    assert with_forms.price() == pytest.approx(0.5 * np.log1p(ENERGETIC) + np.log(2.0), abs=1e-3)


@pytest.mark.parametrize(
    ("shares", "listed"),
    [
        ((0.9992, 0.0005, 0.0003), 1),
        ((0.90, 0.035, 0.035, 0.0295, 0.0005), 4),  # of which all but the first have less than 2 %, and that alone not 99.9 %
        ((0.50, 0.40, 0.0995, 0.0005), 3),
        ((0.20, 0.20, 0.20, 0.20, 0.10, 0.10), 6),
    ],
)
def test_sets_that_are_not_told_apart_have_999_in_a_thousand_of_what_known_ones_have(shares, listed):
    """Whatever share of it all known sets have; nothing and the unknown are no sets."""
    one = Fitted((EffectAt("coulomb_friction", "arm"),), (), np.zeros(0), np.zeros(0), 0.0, (), np.zeros((0, 0)), np.zeros(0))
    sets = [Weighed(one, 0.0, 0.0, confidence=0.52 * share) for share in shares]
    assert not_told_apart([*sets, Weighed(None, 0.0, 0.0, confidence=0.3)], LISTED) == sets[:listed]


def exact_after(removed: float, left: float = 0.0, held_out: tuple[float, float] | None = None) -> float:
    """Probability that equations are exact once a set has removed this energy and left this much above noise."""
    each = [(removed, left), *([held_out] if held_out else [])]
    parts = [Part(ENTRIES + left, ENTRIES + removed + left, ENTRIES) for removed, left in each]
    return exactness(parts, WEIGHTS.exact, WEIGHTS.form_error)


def test_the_more_is_removed_down_to_the_noise_the_surer_no_equation_erred():
    """Against Bayes' rule with errors drawn: chi-squared energies whose mean is the form error of what is removed."""
    errors = np.random.default_rng(1).standard_normal(400_000) ** 2
    for removed in (1e4, 1e6, 1e8):
        unseen = float(np.mean(WEIGHTS.form_error * removed * errors < certain_excess(ENTRIES)))
        expected = WEIGHTS.exact / (WEIGHTS.exact + (1.0 - WEIGHTS.exact) * unseen)
        assert exact_after(removed) == pytest.approx(expected, rel=0.01)
    assert exact_after(1e3) == pytest.approx(WEIGHTS.exact, rel=0.01)


def test_where_the_best_set_leaves_more_than_noise_an_equation_may_have_erred():
    left = 1.01 * certain_excess(ENTRIES)
    assert exact_after(1e8, left) == WEIGHTS.exact
    assert exact_after(1e8, held_out=(1e6, left)) == WEIGHTS.exact
    assert exact_after(1e8, held_out=(1e6, 0.0)) == exact_after(1e8)  # both recordings are of one law


def test_the_more_is_left_that_may_be_noise_the_less_it_says_of_exactness():
    """Without a step: half of what nobody tells from noise says all that it can, and the whole nothing."""
    shares = [exact_after(1e8, share * certain_excess(ENTRIES)) for share in np.linspace(0.0, 1.2, 241)]
    assert np.diff(shares).max() < 1e-6 and np.abs(np.diff(shares)).max() < 0.02
    assert shares[100] == pytest.approx(shares[0], rel=1e-5) and shares[0] > 0.9 and shares[-1] == WEIGHTS.exact


def test_noise_that_is_taken_to_be_what_the_closest_set_leaves_says_nothing_of_exactness():
    training = Part(ENTRIES, ENTRIES + 1e8, ENTRIES, is_known=False)
    assert exactness([training, Part(0.0, 0.0, 0.0)], WEIGHTS.exact, WEIGHTS.form_error) == WEIGHTS.exact
    another_motion = Part(ENTRIES, ENTRIES + 1e8, ENTRIES)
    assert exactness([training, another_motion], WEIGHTS.exact, WEIGHTS.form_error) > 0.9


def test_without_repeats_a_set_that_leaves_what_is_taken_for_noise_is_no_surer_for_it():
    def share(is_noise_known: bool) -> float:
        near, far = (Weighed(None, ENTRIES + misfit, 0.0, (58e6,) * k) for misfit, k in ((0.0, 6), (5e5, 1)))
        ranked, _ = weighed([near, far], Weighed(None, ENTRIES + 58e6, 0.0), (ENTRIES, 0.0), TRIED, is_noise_known=is_noise_known)
        return next(r.share for r in ranked if r.misfit == near.misfit)

    assert share(True) > share(False)


def test_names_whose_difference_exact_equations_show_are_told_apart_where_much_is_removed_down_to_the_noise():
    """A delay that leaves 550 000 of 58 million is not the likelier one where a drive's lag beside a friction leaves nothing."""
    near = confidences(58e6, 0.0, 5e5, freedom=[6, 1])
    assert near[0] > 0.8 * CERTAIN


@pytest.mark.parametrize(("more", "stands_alone"), [(477.0, False), (1e5, True)])
def test_of_much_that_was_removed_a_little_tells_no_exact_equations_apart(more, stands_alone):
    """A thousandth of the response left where a friction removes 775 million, and a hundredth."""
    asymmetric, viscous = confidences(775e6, 0.0, more, freedom=[2, 1])
    assert (asymmetric > ALONE) is stands_alone
    assert (viscous > asymmetric) is not stands_alone
