"""A search that went on beside one of two first effects goes on beside the other as well, and both ways' sets compete."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from hil.diagnosis.fitting.refit import Fitted
from hil.diagnosis.judging.tried import Tried
from hil.diagnosis.ranking.weighing import closer_than
from hil.diagnosis.result import EffectAt
from hil.diagnosis.searching.ways import (
    Way,
    another_first,
    closer_parts,
    competes,
    continued,
    each_once,
    joined,
    still_in,
    with_others,
    without_unrelated,
)
from hil.diagnosis.starting.candidates import Candidate
from hil.diagnosis.tuning.retune import Tuning

ENTRIES = 100
BOTH = (ENTRIES, ENTRIES)
ALONG = np.eye(ENTRIES)
COGGING, RUBBING, DELAY, RIPPLE = (EffectAt(name, "rotor") for name in ("cogging", "position_dependent_friction", "delay", "torque_ripple"))
NOTHING = SimpleNamespace(tuning=SimpleNamespace(predicted=np.zeros(ENTRIES)), cost=20_000.0)


def contender(gained: float, *effects: EffectAt, response=ALONG[0], passed: bool = True, held_out: float = 0.0):
    """A set that a search has come to, with this change of the free run."""
    nothing = np.zeros((ENTRIES, 0))
    cost = NOTHING.cost - gained
    fitted = Fitted(effects, (np.ones(1),) * len(effects), np.zeros(0), response, cost, (), nothing, np.zeros(0))
    gains = {"gained": gained, "gained_held_out": held_out, "left_held_out": NOTHING.cost - held_out}
    return SimpleNamespace(fitted=fitted, passed=passed, by_numbers=(0.0, 0.0), by_signs=(0.0, 0.0), searched=0.0, **gains)


def stand_of(found):
    """What a search ended with."""
    held_out = SimpleNamespace(misfit=found.left_held_out)
    return SimpleNamespace(fitted=found.fitted, effects=found.fitted.effects, cost=found.fitted.cost, held_out=held_out)


def another(*rivals, found=(RUBBING, DELAY), first=(RUBBING,)):
    stand = contender(16_000.0, *first)
    own = SimpleNamespace(fitted=stand.fitted, effects=first)
    return another_first((stand, *rivals), found, own, NOTHING, float(ENTRIES))


def test_another_first_effect_is_one_that_the_equations_errors_may_hold():
    """Of 16 000 units of noise an equation may err by 160 or so, and a twenty-fifth of the likelihood is six of them."""
    rival = contender(15_200.0, COGGING, response=ALONG[1])
    assert another(rival) is rival
    assert another(contender(17_000.0, COGGING, response=ALONG[1])) is not None  # one of more parameters comes closer and comes second
    assert another(contender(14_000.0, COGGING, response=ALONG[1])) is None
    assert another(contender(15_200.0, COGGING, response=ALONG[1], passed=False)) is None


def test_another_first_effect_is_the_one_of_them_that_gains_most():
    """A friction over position and a cogging are both within what an equation errs by, and the cogging, one place behind, gains more."""
    rivals = [contender(gained, effect, response=ALONG[1]) for gained, effect in ((15_200.0, DELAY), (15_400.0, COGGING))]
    assert another(*rivals) is rivals[1]
    assert another(*rivals[::-1]) is rivals[1]


def test_another_first_effect_does_something_else():
    alike = ALONG[0] + 0.2 * ALONG[1]
    assert another(contender(15_900.0, COGGING, response=alike)) is None
    assert another(contender(15_900.0, COGGING, response=ALONG[0] + 0.5 * ALONG[1])) is not None


def test_a_search_that_found_nothing_further_or_the_rival_itself_is_not_taken_up_again():
    rival = contender(15_200.0, COGGING, response=ALONG[1])
    assert another(rival, found=(RUBBING,)) is None
    assert another(rival, found=(RUBBING, COGGING)) is None
    pair = (RUBBING, DELAY)  # found together at the first step, and nothing beside
    assert another(rival, found=pair, first=pair) is None


def test_what_a_set_must_be_there_beside_is_every_part_of_it_that_passed_and_is_closer_than_what_it_was_added_to():
    pair = contender(16_500.0, RUBBING, DELAY)
    closer, farther = contender(16_400.0, DELAY), contender(15_900.0, DELAY)
    refused, other = contender(16_400.0, DELAY, passed=False), contender(16_400.0, COGGING)
    stand = contender(16_000.0, RUBBING)
    way = Way(SimpleNamespace(cost=stand.fitted.cost), contenders=(stand, closer, farther, refused, other, pair))
    assert closer_parts(pair, way) == [closer]


def test_of_two_ways_the_likelier_stands_and_all_sets_compete_once():
    def way(*contenders):
        """At its end with the first of its sets."""
        return Way(SimpleNamespace(fitted=contenders[0].fitted), contenders=contenders, closest=contenders[0].fitted)

    one = way(contender(16_500.0, RUBBING, DELAY), contender(15_900.0, COGGING, DELAY), contender(15_200.0, COGGING))
    other = way(contender(18_500.0, COGGING, RIPPLE), contender(16_100.0, DELAY, COGGING), contender(4_000.0, RIPPLE))
    both = joined(one, other, NOTHING.cost, float(ENTRIES))
    assert both.stand is other.stand and both.closest is other.closest
    assert [set(c.fitted.effects) for c in both.contenders] == [{RUBBING, DELAY}, {COGGING, DELAY}, {COGGING, RIPPLE}]
    assert [c.gained for c in both.contenders] == pytest.approx([16_500.0, 16_100.0, 18_500.0])
    assert joined(other, one, NOTHING.cost, float(ENTRIES)).stand is other.stand
    assert each_once([]) == []


def test_what_lost_its_form_on_either_way_is_kept_once():
    """Either way began at the same first step."""
    first, second, third = (contender(gained, RIPPLE) for gained in (1.0, 2.0, 3.0))

    def way(end, *formless):
        stand = SimpleNamespace(fitted=end.fitted, effects=end.fitted.effects)
        return Way(stand, contenders=(end,), closest=end.fitted, formless=formless)

    one, other = way(contender(16_500.0, RUBBING), first, second), way(contender(18_500.0, COGGING), first, third)
    assert joined(one, other, NOTHING.cost, float(ENTRIES)).formless == (first, second, third)


def test_of_two_ways_it_is_known_what_either_tried():
    """A second cogging is a candidate beside the first one only; a search may go on from the sets of either way."""
    second, step = EffectAt("cogging 2", "rotor"), Tried([Candidate(COGGING, (), 3.0), Candidate(RUBBING, ())])

    def way(gained, effect, tried, limits):
        end = contender(gained, effect)
        return Way(SimpleNamespace(fitted=end.fitted), contenders=(end,), closest=end.fitted, tried=tried, limits=limits)

    one = way(18_500.0, RUBBING, Tried([Candidate(DELAY, ())], step), {RUBBING: (0.1, 1.0)})
    other = way(16_500.0, COGGING, Tried([Candidate(second, (), 7.0)], step), {second: (0.2, 2.0)})
    for both in (joined(one, other, NOTHING.cost, float(ENTRIES)), joined(other, one, NOTHING.cost, float(ENTRIES))):
        assert both.tried.shapes == {COGGING: 3.0, RUBBING: 1.0, DELAY: 1.0, second: 7.0} and both.tried.first == 2
        assert both.limits == {RUBBING: (0.1, 1.0), second: (0.2, 2.0)}


@pytest.mark.parametrize(
    ("gained", "passed", "likeliest", "goes_on"),
    [(19_700.0, True, True, True), (19_605.0, True, True, False), (19_700.0, False, True, False), (19_700.0, True, False, False)],
    ids=["it leaves less", "it leaves as much", "it is not there for certain", "it is less likely"],
)
def test_a_search_goes_on_from_the_likeliest_set_that_leaves_less_than_the_one_at_its_end(gained, passed, likeliest, goes_on):
    """Of one parameter, where 4 of noise are left per entry, chance gains some forty."""
    end, rival = contender(19_600.0, RUBBING), contender(gained, COGGING, passed=passed)
    best = rival if likeliest else end
    assert closer_than(stand_of(end), (end, rival), BOTH, lambda some: best.fitted) is (rival if goes_on else None)
    twin = contender(19_601.0, RUBBING)  # of the other way, which came to the same set
    assert closer_than(stand_of(end), (twin, rival), BOTH, lambda some: (rival if likeliest else twin).fitted) is (
        rival if goes_on else None
    )


@pytest.mark.parametrize(("held_out", "goes_on"), [(17_300.0, False), (19_000.0, True)])
def test_a_search_goes_on_from_the_likeliest_set_that_leaves_less_in_both_motions_together(held_out, goes_on):
    """Beside 20 units of what is left in training that it leaves more, it leaves 11 or 200 such units less held out, which are larger."""
    end, rival = contender(19_600.0, RUBBING, held_out=17_000.0), contender(19_500.0, COGGING, held_out=held_out)
    assert closer_than(stand_of(end), (end, rival), BOTH, lambda some: rival.fitted) is (rival if goes_on else None)


def test_a_way_that_went_on_has_the_sets_of_both_where_it_found_more():
    first, likeliest = contender(16_000.0, RUBBING), contender(16_100.0, COGGING)
    larger = contender(16_400.0, COGGING, DELAY)
    way = Way(SimpleNamespace(fitted=first.fitted), contenders=(first, likeliest), closest=likeliest.fitted)
    found_nothing = Way(SimpleNamespace(fitted=likeliest.fitted), contenders=(first, likeliest))
    found_more = Way(SimpleNamespace(fitted=larger.fitted), contenders=(larger,), closest=larger.fitted)
    assert continued(way, found_nothing) is found_nothing
    both = continued(way, found_more)
    assert both.stand is found_more.stand and both.closest is larger.fitted
    assert [set(one.fitted.effects) for one in both.contenders] == [{RUBBING}, {COGGING, DELAY}]


@pytest.mark.parametrize(
    ("training", "held_out", "lost_form", "rival"),
    [
        (60.0, 0.0, "", True),
        (40.0, 0.0, "", False),
        (40.0, 60.0, "", True),  # of 100 and 40 together, as naming weighs them
        (40.0, -60.0, "", False),
        (60.0, 60.0, "no longer that effect", False),
        (0.0, 200.0, "", False),
    ],
)
def test_a_set_competes_that_gains_half_as_much_in_training_or_in_both_motions(training, held_out, lost_form, rival):
    assert competes(judged(training, held_out, lost_form=lost_form), judged(100.0, 40.0)) is rival


@pytest.mark.parametrize(
    ("along", "passed", "is_another_matter"), [(0.0, False, True), (0.2, False, True), (0.5, False, False), (0.0, True, False)]
)
def test_what_did_not_pass_and_does_nothing_of_what_one_that_passed_does_is_no_rival_of_it(along, passed, is_another_matter):
    """A ripple of another axis gains as much as a shaken floor, by chance; the floor shakes whether or not there is a ripple."""
    floor = contender(60.0, RUBBING, response=ALONG[0])
    ripple = contender(60.0, COGGING, response=along * ALONG[0] + np.sqrt(1.0 - along**2) * ALONG[1], passed=passed)
    assert is_unrelated(ripple, [floor], nothing_found()) is is_another_matter


def test_what_retuning_imitates_makes_no_two_sets_alike():
    floor, ripple = (contender(60.0, name, response=ALONG[k] + 10.0 * ALONG[5], passed=k == 0) for k, name in enumerate((RUBBING, COGGING)))
    assert is_unrelated(ripple, [floor], nothing_found(jacobian=1e3 * ALONG[5:6].T))
    assert not is_unrelated(ripple, [floor], nothing_found())


def test_a_pair_that_can_do_what_passed_is_its_rival_however_much_its_other_effect_does():
    """The first imitates what passed, the second, which is something else, is ten times as large."""
    floor = contender(60.0, RUBBING, response=ALONG[0])
    pair = contender(60.0, COGGING, DELAY, response=ALONG[0] + 10.0 * ALONG[1], passed=False)
    assert is_unrelated(pair, [floor], nothing_found())
    pair.fitted = replace(pair.fitted, jacobian=ALONG[:2].T)
    assert not is_unrelated(pair, [floor], nothing_found())


def test_what_gains_more_or_does_what_another_one_does_that_passed_is_a_rival():
    floor, other = (contender(60.0, name, response=ALONG[k]) for k, name in enumerate((RUBBING, DELAY)))
    ripple = contender(60.0, COGGING, response=ALONG[1], passed=False)
    assert is_unrelated(ripple, [floor], nothing_found())
    assert not is_unrelated(ripple, [floor, other], nothing_found())
    assert not is_unrelated(contender(61.0, COGGING, response=ALONG[1], passed=False), [floor], nothing_found())


def test_a_set_that_took_the_stands_place_is_a_rival_whatever_it_does():
    stand = nothing_found(DELAY)
    beside, instead = contender(60.0, DELAY, RUBBING), contender(60.0, COGGING, response=ALONG[1], passed=False)
    assert not is_unrelated(instead, [beside], stand)
    assert is_unrelated(contender(60.0, DELAY, COGGING, response=ALONG[1], passed=False), [beside], stand)


def is_unrelated(one, passed, stand) -> bool:
    """Whether a set is left out of those that compete."""
    kept = without_unrelated([*passed, one], passed, stand)
    assert kept[: len(passed)] == list(passed)
    return one not in kept


def nothing_found(*effects: EffectAt, jacobian=0.0 * ALONG[:, :1]):
    """A stand whose free run is zero."""
    tuning = Tuning((), np.zeros(1, int), np.ones(1), np.zeros(1), np.zeros(1), np.zeros(ENTRIES), jacobian, np.eye(1))
    return SimpleNamespace(tuning=tuning, effects=effects)


def test_where_nothing_was_chosen_all_that_gain_are_what_came_closest():
    assert competes(judged(1.0), None)
    assert not competes(judged(0.0), None)


def judged(gained: float, held_out: float | None = None, before: tuple[float, ...] = (), lost_form: str = "", shows: bool = True):
    """With the gate of its last step, and of those before: the same where they gained the same."""
    gate = SimpleNamespace(certain_gain=gained, held_out_gain=held_out, lost_form=lost_form, shows=shows)
    steps = tuple(STEPS.setdefault(each, SimpleNamespace(certain_gain=each)) for each in before)
    return SimpleNamespace(gate=gate, gates=(*steps, gate), gained=sum(before) + gained, gained_held_out=held_out or 0.0)


STEPS: dict[float, SimpleNamespace] = {}


@pytest.mark.parametrize(("chosen", "rival"), [(judged(20_000.0), True), (judged(200_000.0), False)])
def test_beside_a_set_that_took_the_stands_place_one_that_was_added_to_the_stand_competes_with_all_that_it_gains(chosen, rival):
    """The chosen set's gain is over nothing, the other's last step's is over a stand that gained 16 000."""
    assert competes(judged(300.0, before=(16_000.0,)), chosen) is rival
    assert not competes(judged(0.7, before=(16_000.0,), shows=False), chosen)  # the stand does that without it


def test_a_set_that_passed_gives_way_to_none_that_did_not():
    stand, instead, more = contender(16_000.0, COGGING), contender(16_300.0, RIPPLE), contender(16_001.0, COGGING, DELAY, passed=False)
    assert still_in([stand], [instead, more]) == [stand]
    assert still_in([stand], [instead, contender(16_301.0, COGGING, DELAY)]) == []


def test_beside_the_same_stand_what_was_added_to_it_counts_alone():
    chosen = judged(1000.0, before=(16_000.0,))
    assert competes(judged(600.0, before=(16_000.0,)), chosen)
    assert not competes(judged(400.0, before=(16_000.0,)), chosen)


def test_of_sets_that_leave_more_than_the_stand_the_closer_fit_competes_and_the_stand_stays():
    stand, unfinished = contender(16_400.0, COGGING, DELAY), contender(15_000.0, RUBBING, DELAY)
    closer, far = contender(16_200.0, RUBBING, DELAY), contender(4_000.0, RIPPLE)
    again = contender(16_500.0, COGGING, DELAY)
    kept = with_others((stand, unfinished), (closer, far, again), stand.fitted)
    assert kept == [stand, closer, far]
    part, larger = contender(16_400.0, COGGING), contender(16_300.0, COGGING, DELAY)
    assert with_others((part,), (larger,), part.fitted) == [part, larger]  # what is named stays although a larger set leaves more
    assert with_others((stand, part, far), (), stand.fitted) == [stand, part, far]  # none that competed is lost for that


def test_a_set_that_competes_by_both_motions_is_kept_where_ways_are_joined():
    strong, weak = contender(100.0, COGGING, held_out=40.0), contender(40.0, RIPPLE, held_out=60.0)
    assert each_once((strong, weak)) == [strong, weak]
    assert each_once((strong, contender(40.0, RIPPLE, held_out=10.0))) == [strong]
    assert each_once((strong, contender(60.0, RIPPLE, held_out=-50.0)))[1:] != []


def test_where_ways_are_joined_a_set_that_passed_gives_way_to_none_that_did_not():
    """Neither a larger one nor a fit of the same that is a little closer."""
    there, unsure = contender(16_000.0, COGGING), contender(16_001.0, COGGING, DELAY, passed=False)
    assert each_once((there, unsure)) == [there, unsure]
    larger = contender(16_001.0, COGGING, DELAY)
    assert each_once((there, larger)) == [larger]
    assert each_once((contender(15_999.0, COGGING, passed=False), unsure)) == [unsure]
    far = contender(40_000.0, RIPPLE, DELAY, passed=False)
    assert each_once((there, far)) == [there, far]
    closer = contender(16_000.5, COGGING, passed=False)
    assert each_once((there, closer)) == each_once((closer, there)) == [there]
