"""What a set leaves more than the best one counts by what its own equations may err by."""

from __future__ import annotations

from dataclasses import replace

import pytest

from hil.diagnosis.ranking.compared import Compared
from hil.diagnosis.ranking.naming import Weighed, beside_the_best, weighed

ENTRIES = 19000.0
TRIED = 50


def test_what_a_set_of_numbers_leaves_more_has_no_error_of_another_set_s_equation_for_a_reason():
    """An eccentricity that errs by 1 % may leave 100 more than another one; a gear's ratio, which is a number, may not."""

    def beside_the_best(by_numbers: float) -> float:
        best = Weighed(None, ENTRIES, 0.0, (2500.0,))
        other = Weighed(None, ENTRIES + 100.0, 0.0, (2500.0,), by_numbers=(by_numbers, 0.0), of_the_file=False)
        ranked, _ = weighed([best, other], Weighed(None, ENTRIES + 2500.0, 0.0), (ENTRIES, 0.0), TRIED)
        return next(one.share for one in ranked if one.misfit == other.misfit)

    assert beside_the_best(0.0) > 0.02
    assert beside_the_best(2000.0) < 0.002


def share_of_a_rival(left, more, by_numbers=(0.0, 0.0)):
    """Of a set that leaves so much more, in training and held out, than the best one, which leaves `left` above noise in training."""
    best = Weighed(None, ENTRIES + left, ENTRIES, (2500.0,))
    rival = Weighed(None, best.train + more[0], best.held_out + more[1], (2500.0,), by_numbers=by_numbers, of_the_file=False)
    base = Weighed(None, best.train + 2500.0, ENTRIES + 2500.0)
    ranked, _ = weighed([best, rival], base, (ENTRIES, ENTRIES), TRIED)
    return next(one.share for one in ranked if (one.train, one.held_out) == (rival.train, rival.held_out))


def test_where_much_is_left_rivals_that_leave_a_little_more_stay_plausible():
    assert share_of_a_rival(6000.0, (100.0, 0.0)) > 0.1 * share_of_a_rival(6000.0, (0.001, 0.0))


def test_numbers_that_make_the_held_out_motion_worse_are_no_credit():
    for lost in (1e5, 2e5, 1e300):
        assert 0.0 <= share_of_a_rival(0.0, (0.0, lost), by_numbers=(2e5, -lost)) < 1e-3


@pytest.mark.parametrize("net", [-100.0, 0.0, 1e-6])
def test_a_set_that_leaves_as_much_in_both_motions_together_is_judged_like_the_best(net):
    """It leaves 400 more in training and as much less held out; only what it leaves more in all counts by its own T."""
    best, rival = Weighed(None, 100.0, 100.0), Weighed(None, 500.0, -300.0 + net)
    judged = beside_the_best(rival, rival, best, best, (20.0, 20.0), (2.0, 2.0))
    assert judged.misfit == pytest.approx(rival.misfit, abs=1e-4)


def test_a_difference_along_which_repeats_scatter_counts_as_little_by_a_set_s_own_temper():
    compared = Compared((100.0, 0.0), (600.0, 0.0), (600.0, 0.0), scatter=5.0)
    rival, best = replace(Weighed(None, 700.0, 0.0), compared=compared), Weighed(None, 100.0, 0.0)
    judged = beside_the_best(rival, rival.in_units(20.0, 20.0, 0.01), best, best.in_units(20.0, 20.0), (20.0, 20.0), (2.0, 2.0))
    by_chance = 5.0 * 6.635 / 600.0  # of one parameter, once in a hundred times
    as_all, by_its_own = 600.0 / (20.0 - 1.0 + 5.0), 600.0 / (2.0 - 1.0 + 5.0)
    assert judged.misfit == pytest.approx(100.0 / 20.0 + by_chance * as_all + (1.0 - by_chance) * by_its_own, rel=1e-4)


def test_what_further_parameters_gain_by_chance_is_counted_as_they_are_paid_for():
    """Viscous friction beside asymmetric friction, which holds it: three parameters more, and 6.5 less."""
    rival, best = Weighed(None, 106.5, 0.0, (1e4,)), Weighed(None, 100.0, 0.0, (1e4,) * 4)
    judged = beside_the_best(rival, rival.in_units(20.0, 20.0), best, best.in_units(20.0, 20.0), (20.0, 20.0), (1.0, 1.0))
    assert judged.misfit == rival.in_units(20.0, 20.0).misfit


def test_where_sets_are_compared_what_counts_is_the_difference_that_is_compared_to_the_best_set():
    """Of 250 more errors explain all but 8; and a set that lost its form leaves 500 less than the name that both are compared with."""
    best = Weighed(None, 100.0, 0.0, (1e4,) * 4)

    def judged(compared: Compared) -> tuple[float, float]:
        rival = replace(Weighed(None, sum(compared.reference) + compared.apart[0], 0.0, (1e4,)), compared=compared)
        as_all = rival.in_units(20.0, 20.0, 0.01)
        beside = beside_the_best(rival, as_all, best, best.in_units(20.0, 20.0), (20.0, 20.0), (1.0, 1.0))
        return beside.misfit, as_all.misfit

    explained = judged(Compared((100.0, 0.0), (250.0, 0.0), (8.0, 0.0)))
    assert explained[0] == explained[1]
    of_another = judged(Compared((600.0, 0.0), (3.0, 0.0), (3.0, 0.0)))
    assert of_another[0] > 10.0 * of_another[1]


@pytest.mark.parametrize(
    ("charged", "apart", "scatter", "is_stricter"), [(90.0, 8.0, 1.0, False), (6.5, 100.0, 1.0, True), (120.0, 120.0, 11.0, False)]
)
def test_where_sets_are_compared_chance_is_that_of_their_difference(charged, apart, scatter, is_stricter):
    """Not what each was charged for by itself; eleven times the variance gains eleven times as much."""
    compared = Compared((100.0, 0.0), (apart, 0.0), (apart, 0.0), scatter=scatter)
    rival, best = replace(Weighed(None, 100.0 + charged, 0.0, (1e4,)), compared=compared), Weighed(None, 100.0, 0.0, (1e4,) * 4)
    as_all = rival.in_units(300.0, 300.0, 0.01)
    judged = beside_the_best(rival, as_all, best, best.in_units(300.0, 300.0), (300.0, 300.0), (1.0, 1.0))
    assert (judged.misfit > as_all.misfit + 1e-9) is is_stricter
