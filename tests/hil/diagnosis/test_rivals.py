"""What competes for the name beside the set that was found, by the search from its first screening to its end."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from hil.diagnosis.fitting.refit import Fitted
from hil.diagnosis.fitting.screening import Screened
from hil.diagnosis.judging import judgement
from hil.diagnosis.judging.form_error import NO_ERROR, FormError
from hil.diagnosis.judging.gate import Along
from hil.diagnosis.judging.placebos import NO_PLACEBOS, Placebos, Rivals
from hil.diagnosis.result import EffectAt
from hil.diagnosis.searching import exchanged, finishing, selection, step, ways
from hil.diagnosis.searching.exchanged import MOST_NEIGHBOURS, neighbours_instead, neighbours_of_all
from hil.diagnosis.searching.pairs import Pair
from hil.diagnosis.starting.candidates import Candidate
from hil.diagnosis.tuning.retune import Tuning
from hil.machine import load_machine

ENTRIES = 4000
FRICTION, MODE, LOAD, DAMPER, NOT_THERE = (
    EffectAt(name, "carriage")
    for name in ("coulomb_friction", "structural_mode", "constant_load", "viscous_friction", "quadratic_friction")
)
FAR = 2.0
"""Where an effect is that a fit does not come to alone."""

SWINGS, LOST = np.array([1.0, 16.0, 0.01]), np.array([1.0, 16.0, 1.0])
"""J, f and zeta of a mode, and of one that no longer swings."""

RUBS, PULLS, ELSE, DAMPS, NOWHERE = np.linalg.qr(np.random.default_rng(2).standard_normal((ENTRIES, 5)))[0].T
ALONG = {FRICTION: RUBS, MODE: 0.999 * RUBS + np.sqrt(1.0 - 0.999**2) * ELSE, LOAD: PULLS, DAMPER: DAMPS, NOT_THERE: NOWHERE}
"""The mode imitates the friction: alone it leaves 0.2 % more of it. A damper acts in few tests."""


def search(monkeypatch, mode_beside: np.ndarray, less: float = 0.0) -> list[set[EffectAt]]:
    """Sets that compete, see `selected`."""
    found = selected(monkeypatch, mode_beside, less)
    assert found.chosen is not None and set(found.chosen.effects) == {FRICTION, LOAD}
    return [set(one.fitted.effects) for one in found.contenders]


def candidates_beside(chosen: Fitted | None) -> list[Candidate]:
    """Beside two effects no further one."""
    return [] if chosen is not None and len(chosen.effects) > 1 else [Candidate(effect, ()) for effect in (FRICTION, MODE, LOAD)]


def selected(
    monkeypatch,
    mode_beside: np.ndarray,
    less: float = 0.0,
    pulls: float = 7.0,
    backwards: float = 0.0,
    damps: float = 0.0,
    candidates_of=candidates_beside,
    what_acts=lambda runs, tuning, measured, fits, stand, may_stand: fits,
    polished=lambda runs, tuning, measured, fits, *_: list(fits),
    neighbours=lambda *_: [],
    stuck: EffectAt | None = None,
    paired: Sequence[Pair] = (),
    rounded: float = 0.0,
    short: float = 0.0,
) -> selection.Selection:
    """What a search comes to where a friction and a load are hidden in noise, linear in everything; each fitted set along its directions.

    `mode_beside` are the mode's values where it is fitted beside a load, `less` what the load's fit lacks there, `pulls` how strong the
    load is, `backwards` what the best response run backwards in time gains beside an effect, `damps` how strong a damper is. Alone `stuck`
    comes to no more than the share `short` of what it does but from where it is beside others; `paired` are the pairs that a filter finds;
    `rounded` is what pairs leave less.
    """
    noise = np.random.default_rng(3).standard_normal(ENTRIES)
    noise -= sum((noise @ direction) * direction for direction in (RUBS, PULLS, ELSE, DAMPS, NOWHERE))
    measured = noise + 30.0 * RUBS + pulls * PULLS + damps * DAMPS
    tuning = Tuning((), np.zeros(0, dtype=int), np.ones(0), np.zeros(0), np.zeros(0), np.zeros(ENTRIES), np.zeros((ENTRIES, 0)), np.eye(0))
    sets = {"train": SimpleNamespace(channels=("a",), groups=[SimpleNamespace(time_s=np.zeros(ENTRIES))])}
    layout = SimpleNamespace(size=lambda rows: rows, rate_Hz=10.0)
    machine = SimpleNamespace(plant=None)
    runs = SimpleNamespace(measured=lambda: measured, repeats=lambda name: [[noise]], sets=sets, noise=layout, count=0, machine=machine)

    def fitted(effects: tuple[EffectAt, ...]) -> Fitted:
        basis = np.stack([ALONG[effect] for effect in effects], axis=1)
        predicted = basis @ np.linalg.lstsq(basis, measured, rcond=None)[0]
        values = {effect: np.ones(1) for effect in effects} | {MODE: SWINGS}
        if set(effects) == {MODE, LOAD}:
            predicted, values[MODE] = predicted - less * PULLS, mode_beside
        free = tuple((number, 0) for number in range(len(effects)))
        cost = float(np.sum((measured - predicted) ** 2)) - rounded * (len(effects) == 2)
        own = tuple(values[effect] for effect in effects)
        return Fitted(effects, own, np.zeros(0), predicted, cost, free, basis, np.full(len(effects), 100.0))

    def refitted(effects: tuple[EffectAt, ...], starts: tuple[np.ndarray, ...]) -> Fitted:
        found = fitted(effects)
        is_stuck = effects == (stuck,) and starts[0][0] != FAR
        if is_stuck:
            predicted = short * found.predicted
            found = replace(found, predicted=predicted, cost=float(np.sum((measured - predicted) ** 2)))
        each = zip(effects, found.values, strict=True)
        return replace(found, values=tuple(np.full(1, FAR) if effect == stuck else own for effect, own in each))

    def screened(runs, tuning, found, residual, present) -> list[Screened]:
        def one(effect: EffectAt) -> Screened:
            along = float(ALONG[effect] @ residual)
            return Screened(effect, np.ones(1), along * ALONG[effect], along**2)

        return sorted((one(candidate.effect) for candidate in found), key=lambda s: -s.score)

    monkeypatch.setattr(step, "screen", screened)
    monkeypatch.setattr(step, "refit", lambda runs, tuning, measured, starts: [refitted(*start) for start in starts])
    monkeypatch.setattr(step, "polish", polished)
    monkeypatch.setattr(finishing, "polish", polished)
    monkeypatch.setattr(step, "with_what_acts", what_acts)
    monkeypatch.setattr(step, "with_other_harmonics", lambda runs, tuning, measured, fits: fits)
    monkeypatch.setattr(step, "pairs", lambda *_: paired)
    monkeypatch.setattr(exchanged, "neighbours_instead", neighbours)
    alone = Rivals(np.zeros((1, ENTRIES)), np.array([np.sqrt(backwards)]))  # along no response

    def compared(placebos: Placebos, at, _residual) -> Rivals:
        return alone if len(placebos.responses) and np.any(at.predicted) else Rivals(np.zeros((0, 0)), np.zeros(0))

    monkeypatch.setattr(Placebos, "at", compared)
    some = Placebos(np.ones((1, ENTRIES)))
    monkeypatch.setattr(step, "placebos_of", lambda runs, at, *_: some if np.any(at.predicted) else NO_PLACEBOS)
    monkeypatch.setattr(selection, "onset", lambda runs, name, tuning: NO_ERROR)
    monkeypatch.setattr(selection, "form_error", lambda runs, name, tuning, fit: FormError(np.zeros((0, ENTRIES)), fit.effects))

    return selection.select(runs, tuning, None, float(ENTRIES), candidates_of, lambda what, share: None)


def test_a_rival_with_what_was_found_beside_it_competes(monkeypatch):
    assert {MODE, LOAD} in search(monkeypatch, SWINGS)


def test_a_rival_that_lost_its_form_beside_what_was_found_does_not_compete(monkeypatch):
    competing = search(monkeypatch, LOST)
    assert {FRICTION, LOAD} in competing and {MODE, LOAD} not in competing


def test_a_rival_that_would_have_passed_but_for_its_form_is_kept_apart(monkeypatch):
    assert [set(one.fitted.effects) for one in selected(monkeypatch, LOST).formless] == [{MODE, LOAD}]
    assert selected(monkeypatch, SWINGS).formless == ()


def test_a_rival_that_gains_nothing_by_what_was_found_beside_it_does_not_compete(monkeypatch):
    competing = search(monkeypatch, SWINGS, less=7.0)
    assert {FRICTION, LOAD} in competing and {MODE, LOAD} not in competing


@pytest.mark.parametrize(("pulls", "unsure"), [(7.0, [{FRICTION, LOAD}]), (2.0, [])], ids=["training shows it", "chance gains as much"])
def test_what_training_shows_beside_the_chosen_set_and_is_not_certain_is_kept_apart(monkeypatch, pulls, unsure):
    found = selected(monkeypatch, SWINGS, pulls=pulls, backwards=1e6)
    assert found.chosen is not None and found.chosen.effects == (FRICTION,)
    assert [set(one.fitted.effects) for one in found.unsure] == unsure
    assert not any(LOAD in one.fitted.effects and FRICTION in one.fitted.effects for one in found.contenders)


@pytest.mark.parametrize("last", ["MOST_EFFECTS", "MOST_STEPS"])
def test_what_did_not_pass_and_acts_elsewhere_does_not_compete_with_what_passed(last, monkeypatch):
    """A damper whose strength scatters from repeat to repeat, beside a friction that shows as much and does not."""
    known_along = judgement.Scatter.known_along

    def scattering(self, response: np.ndarray) -> Along:
        found = known_along(self, response)
        return found._replace(variance=400.0) if response @ DAMPS > 0.9 * np.linalg.norm(response) else found

    monkeypatch.setattr(judgement.Scatter, "known_along", scattering)
    monkeypatch.setattr(step, "competes", lambda one, chosen: not one.passed)  # as held-out recordings may have it

    def candidates_of(chosen: Fitted | None) -> list[Candidate]:
        return [] if chosen is not None else [Candidate(effect, ()) for effect in (FRICTION, DAMPER)]

    found = selected(monkeypatch, SWINGS, pulls=0.0, damps=29.0, candidates_of=candidates_of)
    assert [set(one.fitted.effects) for one in found.contenders] == [{FRICTION}]
    monkeypatch.setattr(step, last, 1)  # no further step, in which it would be asked for
    both = selected(monkeypatch, SWINGS, pulls=0.0, damps=29.0, candidates_of=candidates_of).contenders
    assert {DAMPER} in [set(one.fitted.effects) for one in both]


def test_what_only_moves_what_was_found_to_a_closer_fit_is_not_found(monkeypatch):
    """A friction whose fit ends at three quarters of it, and comes to all of it beside a load, which does nothing."""

    def candidates_of(chosen: Fitted | None) -> list[Candidate]:
        return [Candidate(effect, ()) for effect in ((FRICTION,) if chosen is None else (LOAD, DAMPER))]

    found = selected(monkeypatch, SWINGS, pulls=0.1, candidates_of=candidates_of, stuck=FRICTION, short=0.75)
    assert [set(one.fitted.effects) for one in found.contenders] == [{FRICTION}]
    assert found.chosen is found.contenders[0].fitted
    assert found.chosen.predicted @ RUBS == pytest.approx(30.0)
    assert found.contenders[0].gate.gain == pytest.approx(900.0)
    both = selected(monkeypatch, SWINGS, pulls=7.0, candidates_of=candidates_of, stuck=FRICTION, short=0.75)
    assert both.chosen is not None and set(both.chosen.effects) == {FRICTION, LOAD}  # a load that acts is found as before
    assert both.contenders[0].gates[-1].gain == pytest.approx(49.0)


def test_what_was_fitted_beside_a_farther_stand_is_judged_beside_the_closer_one(monkeypatch):
    """Beside a friction that was closer the load is no candidate any more, and is there all the same."""
    asked = []

    def candidates_of(chosen: Fitted | None) -> list[Candidate]:
        asked.append(chosen)
        return [Candidate(effect, ()) for effect in ((FRICTION,) if chosen is None else (LOAD,) if len(asked) == 2 else ())]

    found = selected(monkeypatch, SWINGS, pulls=7.0, candidates_of=candidates_of, stuck=FRICTION, short=0.75)
    assert len(asked) > 2 and found.chosen is not None and set(found.chosen.effects) == {FRICTION, LOAD}
    assert [gate.gain for gate in found.contenders[0].gates] == pytest.approx([900.0, 49.0])


def test_a_set_with_one_effect_exchanged_for_what_answers_alike_competes(monkeypatch):
    monkeypatch.setattr(step, "beside_rivals", lambda *_: [])
    assert {MODE, LOAD} in search(monkeypatch, SWINGS)


def test_what_is_not_there_beside_a_closer_part_of_its_set_is_not_found(monkeypatch):
    """The part is made as close as the set."""
    both = {FRICTION, LOAD}

    def as_close(one, way):
        part = replace(one.fitted, effects=one.fitted.effects[:1], values=one.fitted.values[:1], free=((0, 0),))
        return [replace(one, fitted=part, gates=one.gates[:1])] if set(one.fitted.effects) == both else []

    assert set(selected(monkeypatch, SWINGS).chosen.effects) == both
    monkeypatch.setattr(step, "closer_parts", as_close)
    found = selected(monkeypatch, SWINGS)
    assert set(found.chosen.effects) != both
    assert both not in [set(one.fitted.effects) for one in found.contenders]


def test_a_search_goes_on_from_another_first_effect_that_does_something_else(monkeypatch):
    monkeypatch.setattr(step, "beside_rivals", lambda *_: [])
    monkeypatch.setattr(step, "exchanged", lambda *_: [])
    assert {MODE, LOAD} not in search(monkeypatch, SWINGS)  # what imitates the friction is the same thing
    monkeypatch.setattr(ways, "UNLIKE", 1.0)
    assert {MODE, LOAD} in search(monkeypatch, SWINGS)


def beside_something(chosen: Fitted | None) -> list[Candidate]:
    """The load is a candidate only beside something, the damper only beside the mode."""
    there = () if chosen is None else chosen.effects
    also = [*([LOAD] if there else []), *([DAMPER] if MODE in there else [])]
    return [Candidate(effect, ()) for effect in (FRICTION, MODE, NOT_THERE, *also)]


@pytest.mark.parametrize("goes_on", [True, False])
def test_a_search_goes_on_from_a_closer_set_of_any_step(monkeypatch, goes_on):
    """Nothing of the likeliest set need have been a candidate at the first step."""

    def closer(stand, contenders, *_):
        return next(one for one in contenders if set(one.fitted.effects) == {MODE, LOAD}) if goes_on else None

    monkeypatch.setattr(selection, "closer_than", closer)
    found = selected(monkeypatch, SWINGS, damps=7.0, candidates_of=beside_something)
    assert found.chosen is not None
    assert set(found.chosen.effects) == ({MODE, LOAD, DAMPER} if goes_on else {FRICTION, LOAD})
    assert ({MODE, LOAD, DAMPER} in [set(one.fitted.effects) for one in found.contenders]) is goes_on


def test_sets_compete_without_what_does_nothing_where_the_smaller_set_may_stand(monkeypatch):
    """Not where it leaves more than what was found, nor where one of its effects leaves as little by chance."""
    stands = []

    def what_acts(runs, tuning, measured, fits, stand, may_stand):
        stands.append(stand)
        if stand:
            best = min(fits, key=lambda fit: fit.cost)
            leaves = best.cost + 49.0  # what the friction alone leaves, and the load takes
            assert may_stand(replace(best, cost=leaves - 1.0)) and not may_stand(replace(best, cost=leaves + 1.0))
            two = replace(best, effects=(MODE, LOAD))
            assert may_stand(replace(two, cost=best.cost - 500.0)) and not may_stand(replace(two, cost=leaves - 1.0))
        return [fit for fit in fits if MODE not in fit.effects]

    monkeypatch.setattr(step, "exchanged", lambda *_: [])
    found = selected(monkeypatch, SWINGS, what_acts=what_acts)
    assert stands == [(), (FRICTION,)]
    assert not any(MODE in one.fitted.effects for one in found.contenders)


def test_what_training_shows_competes_once(monkeypatch):
    """A pair may be a rival from the first step on, and be fitted again beside the chosen set."""
    (unsure,) = selected(monkeypatch, SWINGS, backwards=1e6).unsure
    whole = step.Steps.step

    def stepped(self, way):
        found = whole(self, way)
        return replace(found, contenders=(*found.contenders, unsure)) if not way.stand.effects else found

    monkeypatch.setattr(step.Steps, "step", stepped)
    monkeypatch.setattr(selection, "closer_than", lambda *_: None)
    found = selected(monkeypatch, SWINGS, backwards=1e6)
    assert unsure in found.contenders and found.unsure == ()


def test_what_lost_its_form_beside_the_chosen_set_is_not_unsure(monkeypatch):
    monkeypatch.setattr(judgement, "lost_form", lambda fit, *_: "it is none" if LOAD in fit.effects else "")
    assert selected(monkeypatch, SWINGS, backwards=1e6).unsure == ()


def test_a_number_of_the_file_that_is_mistaken_for_the_closest_effect_competes(monkeypatch):
    """At every step, beside what was found."""
    asked = []

    def with_numbers(runs, tuning, measured, fits, *_):
        asked.append(fits[0].effects)
        return [*fits, replace(fits[0], effects=(NOT_THERE,))] if len(fits[0].effects) == 1 else fits

    monkeypatch.setattr(step, "with_numbers_of_the_file", with_numbers)
    found = selected(monkeypatch, SWINGS, candidates_of=beside_something)
    assert asked == [(FRICTION,), (FRICTION, LOAD)]
    assert {NOT_THERE} in [set(one.fitted.effects) for one in found.contenders]


@pytest.mark.parametrize("rounded", [0.0, 1e-9, -1e-9])
def test_what_an_effect_beside_it_makes_surplus_is_left_out(monkeypatch, rounded):
    """The damper stood for the load before that was a candidate beside it; without the damper the load leaves as little."""
    monkeypatch.setattr(step, "exchanged", lambda *_: [])
    monkeypatch.setitem(ALONG, DAMPER, np.sqrt(0.5) * (PULLS + DAMPS))

    def candidates_of(chosen: Fitted | None) -> list[Candidate]:
        there = () if chosen is None else chosen.effects
        return [Candidate(effect, ()) for effect in (FRICTION, *([LOAD] if DAMPER in there else [DAMPER]))]

    found = selected(monkeypatch, SWINGS, pulls=14.0, candidates_of=candidates_of, rounded=rounded)
    assert found.chosen is not None and set(found.chosen.effects) == {FRICTION, LOAD}
    assert {FRICTION, DAMPER, LOAD} not in [set(one.fitted.effects) for one in found.contenders]


def test_a_set_that_gave_way_is_looked_beside_as_any_other(monkeypatch):
    """The damper that stood for the load is a step of its own: beside friction and load another effect is still looked for."""
    monkeypatch.setattr(step, "exchanged", lambda *_: [])
    monkeypatch.setattr(selection, "closer_than", lambda *_: None)
    monkeypatch.setitem(ALONG, DAMPER, np.sqrt(0.5) * (PULLS + DAMPS))
    drawn = np.random.default_rng(4).standard_normal(ENTRIES)
    monkeypatch.setitem(ALONG, NOT_THERE, drawn / np.linalg.norm(drawn))

    def candidates_of(chosen: Fitted | None) -> list[Candidate]:
        there = () if chosen is None else chosen.effects
        also = [LOAD] if DAMPER in there else [NOT_THERE] if LOAD in there else [DAMPER]
        return [Candidate(effect, ()) for effect in (FRICTION, *also)]

    found = selected(monkeypatch, SWINGS, pulls=14.0, candidates_of=candidates_of)
    assert found.chosen is not None and set(found.chosen.effects) == {FRICTION, LOAD}
    assert np.isfinite(found.further)


@pytest.mark.parametrize("paired", [True, False])
def test_what_a_fit_comes_to_beside_another_effect_alone_is_found_where_both_were_a_pair(monkeypatch, paired):
    """Alone the friction's fit gets stuck, and the load is found first; the damper beside the friction does nothing."""
    monkeypatch.setattr(step, "PAIR_MARGIN", np.inf)
    monkeypatch.setattr(selection, "closer_than", lambda *_: None)
    monkeypatch.setattr(step, "with_numbers_of_the_file", lambda runs, tuning, measured, fits, *_: fits)
    both = Pair(((FRICTION, DAMPER), (np.ones(1), np.ones(1))), 900.0, 100.0, 2)
    alone = [Candidate(effect, ()) for effect in (FRICTION, DAMPER, LOAD)]
    asked = {"candidates_of": lambda chosen: alone, "stuck": FRICTION, "paired": [both] if paired else []}
    found = selected(monkeypatch, SWINGS, **asked)
    assert found.chosen is not None
    assert found.chosen.effects == ((FRICTION, LOAD) if paired else (LOAD, FRICTION))


@pytest.mark.parametrize("beside", [True, False])
def test_what_is_mistaken_for_a_name_competes_with_it(monkeypatch, beside):
    """A mode in place of the friction beside the load is what no search came to."""
    monkeypatch.setattr(step, "exchanged", lambda *_: [])
    monkeypatch.setattr(step, "beside_rivals", lambda *_: [])

    def neighbours(found, number, bank, there, settings):
        rest = tuple(effect for effect in found.effects if effect != FRICTION)
        is_asked = beside and found.effects[number] == FRICTION and len(rest) == 1
        return [((MODE, *rest), (np.ones(1), np.ones(1)))] if is_asked else []

    found = selected(monkeypatch, SWINGS, neighbours=neighbours)
    assert ({MODE, LOAD} in [set(one.fitted.effects) for one in found.contenders]) is beside


def test_neighbours_are_effects_that_the_catalogue_says_are_mistaken_for_one_at_the_same_part():
    plant = load_machine("carm").plant
    load, gap = EffectAt("constant_load", "propeller"), EffectAt("backlash", "roll")
    found = SimpleNamespace(effects=(load, gap), values=(np.ones(1), np.ones(2)))
    near = [EffectAt(name, "roll") for name in ("nonlinear_stiffness", "presliding_hysteresis", "delay", "joint_compliance")]
    far = [EffectAt("presliding_hysteresis", "propeller"), EffectAt("cogging", "roll"), gap]
    bank = [(effect, np.full(3, float(k))) for k, effect in enumerate([*far, *near])]
    starts = neighbours_instead(found, 1, bank, [{load, near[0]}], plant)
    assert [names for names, _ in starts] == [(load, effect) for effect in near[1 : 1 + MOST_NEIGHBOURS]]
    assert all(values[0] is found.values[0] and values[1] is bank[bank_of][1] for bank_of, (_, values) in enumerate(starts, 4))
    (alone,) = {names for names, _ in neighbours_instead(SimpleNamespace(effects=(gap,), values=(np.ones(2),)), 0, bank[3:4], [], plant)}
    assert alone == (near[0],)


def test_neighbours_of_what_was_added_start_beside_the_others_and_those_of_the_others_alone():
    plant = load_machine("carm").plant
    clock, gap = EffectAt("clock_offset", "current_roll"), EffectAt("backlash", "roll")
    found = SimpleNamespace(effects=(clock, gap), values=(np.ones(2), np.ones(2)))
    spring, delay = EffectAt("nonlinear_stiffness", "roll"), EffectAt("delay", "roll")
    beside, alone = ([(effect, np.full(3, value)) for effect in (spring, delay)] for value in (1.0, 2.0))
    starts = {names: values for names, values in neighbours_of_all(found, (clock,), (beside, alone), [], plant)}
    assert starts[clock, spring][1][0] == starts[clock, delay][1][0] == 1.0
    assert starts[gap, delay][1][0] == 2.0
    starts = {names: values for names, values in neighbours_of_all(found, (), (beside, alone), [], plant)}
    assert starts[clock, spring][1][0] == 2.0


def test_rarer_than_all_that_were_finished_are_the_rarest_three():
    fits = [SimpleNamespace(number=k) for k in range(8)]
    by_chance = [1e-3, 1e-6, 2.0, 1e-5, 1e-7, 1e-9, 1e-8, 1e-10]
    assert [fit.number for fit in finishing.rarer_by_chance(fits, 3, by_chance)] == [7, 5, 6]
    assert [fit.number for fit in finishing.rarer_by_chance(fits[:4], 1, by_chance[:4])] == [1, 3]


@pytest.mark.parametrize(("shapes", "is_finished"), [(1e9, True), (1.0, False)])
def test_what_chance_does_less_often_is_finished_though_others_gain_more(monkeypatch, shapes, is_finished):
    """Searched in so many shapes, a friction and a mode gain 900 by chance more often than a load gains 400 that was not searched for."""
    finished: list[set[EffectAt]] = []

    def polished(runs, tuning, measured, fits, *_):
        finished.extend(set(fit.effects) for fit in fits)
        return list(fits)

    searched = [Candidate(FRICTION, (), shapes), Candidate(MODE, (), shapes), Candidate(LOAD, ())]
    monkeypatch.setattr(finishing, "POLISHED", 1)
    monkeypatch.setattr(selection, "closer_than", lambda *_: None)
    selected(monkeypatch, SWINGS, pulls=20.0, candidates_of=lambda chosen: searched if chosen is None else [], polished=polished)
    assert ({LOAD} in finished) is is_finished
    assert {FRICTION} in finished
