"""Which sets of effects are worth weighing: the best candidates singly, then added to the best set as long as each is there for certain."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial

import numpy as np

from hil.diagnosis.fitting.refit import Fitted, polish, refit
from hil.diagnosis.fitting.screening import Screened, screen, shortlist
from hil.diagnosis.judging.errors_of_laws import Removing, are_of_the_file, numbers_of, temperature, temperature_of
from hil.diagnosis.judging.form_error import form_error
from hil.diagnosis.judging.gate import Gate, needed_gain, placebo_gain
from hil.diagnosis.judging.held_out import HeldOut
from hil.diagnosis.judging.judgement import Contender, Judgement, Stand
from hil.diagnosis.judging.onset import onset
from hil.diagnosis.judging.tried import Tried
from hil.diagnosis.ranking.naming import price_of_a_parameter, ranking
from hil.diagnosis.ranking.weighing import closer_than, evidence_of, least_by_chance, without_form
from hil.diagnosis.searching.exchanged import bank_of, exchanged, neighbours_of_all
from hil.diagnosis.searching.finishing import closest_of_each, finished, rarer_by_chance, worth_finishing
from hil.diagnosis.searching.from_nominal import with_numbers_from_nominal
from hil.diagnosis.searching.harmonics import with_other_harmonics
from hil.diagnosis.searching.numbers_of_the_file import with_numbers_of_the_file
from hil.diagnosis.searching.pairs import Pair, Start, beside, beside_rivals, instead, pairs, without_one, without_what_stood
from hil.diagnosis.searching.same_order import with_others_of_its_order
from hil.diagnosis.searching.surplus import has_no_surplus, leaves_as_little, needs_all, parts_that_passed
from hil.diagnosis.searching.ways import (
    Way,
    another_first,
    closer_parts,
    competes,
    continued,
    from_another,
    is_rival_of,
    is_unrelated,
    joined,
    not_told_apart_in_training,
    price_in_training,
    with_others,
)
from hil.diagnosis.searching.what_acts import with_what_acts
from hil.diagnosis.starting.candidates import Candidate
from hil.diagnosis.tuning.free_run import FreeRuns
from hil.diagnosis.tuning.retune import Tuning

REFITTED = 8
"""Candidates refitted after the first screening."""

REFITTED_BESIDE = 5
"""Candidates refitted beside effects that were found already."""

PAIRED = 3
"""Pairs that are fitted beside single effects: a flexible law imitates two simple ones that act together, and alone neither of them comes
near it."""

PAIR_MARGIN = 8.0
"""Logarithm of the evidence by which a pair's filter may stay behind the best single effect and still be worth a fit."""

MOST_EFFECTS = 3
MOST_STEPS = 5
"""Steps of one way: a set that gave way to one without one of its effects is looked beside as any other, twice at most."""

WIDER = 3
"""Times as many candidates are fitted first where training shows something for certain and none of the best explains it: a far or nearly
degenerate machine's screening is wrong by more than candidates differ by. On sealed 1242 (spent) gravity was first with 255 and gained 9,
an inertia over pose thirteenth with 56 and gained 292."""

WORTH_A_FIT = 0.02
"""Of the best score: candidates below are not refitted."""

SURPLUS = "the set gains no more than chance over a part of it without another of its effects"

Report = Callable[[str, float], None]


@dataclass(frozen=True, eq=False)
class Selection:
    """Sets of effects that were fitted, and the chosen one.

    Attributes
    ----------
    chosen : Fitted or None
        The largest set whose effects all pass the gate; None where not even one does.
    gates : tuple of Gate
        Of each step of the chosen set, and of the step that ended it, last.
    contenders : tuple of Contender
        Sets that compete for the name, the chosen one among them; where nothing was chosen, the effects that came closest.
    screened : tuple of Screened
        The first screening.
    closest : Fitted or None
        The set that comes closest to the training recordings, whether or not it passed.
    further : float
        Of all effects tried beside the chosen set, how many gain by chance in training as much as the best of them did beyond what the
        set's equations may err by: what is left is more than noise and errors where it is small, though no effect passed the gate.
    formless : tuple of Contender
        Sets that would have passed but for their form: what they imitate has no name.
    unsure : tuple of Contender
        The chosen set with one effect more, which training shows and which did not pass the gate.
    smaller : tuple of Fitted
        All sets that were fitted on the way.
    """

    chosen: Fitted | None
    gates: tuple[Gate, ...]
    contenders: tuple[Contender, ...]
    screened: tuple[Screened, ...]
    closest: Fitted | None
    further: float = np.inf
    formless: tuple[Contender, ...] = ()
    unsure: tuple[Contender, ...] = ()
    smaller: tuple[Fitted, ...] = ()

    def gained_by_least(self, chosen: Fitted | None) -> float:
        """Fall of |residual|^2 by that effect of a set without which it loses least, over the best fit without it: what its last step
        gained, where none is known. Nothing, where a part was fitted closer. Infinite of no set.
        """
        found = self.contender_of(chosen)
        if found is None:
            return np.inf
        own = set(found.fitted.effects)
        costs = [part.cost for part in self.smaller if set(part.effects) < own and len(part.effects) == len(own) - 1]
        return max(min(found.gate.gain, *(cost - found.fitted.cost for cost in costs)), 0.0) if costs else found.gate.gain

    def contender_of(self, fitted: Fitted | None) -> Contender | None:
        """The contender of a set, of its closer fit where another way came to it as well."""
        if fitted is None:
            return None
        same = [one for one in self.contenders if set(one.fitted.effects) == set(fitted.effects)]
        return next((one for one in same if one.fitted is fitted), same[0] if same else None)

    def moved(self, to: Callable[[Sequence[Contender]], Sequence[Contender]]) -> Selection:
        """With all sets that are weighed, moved side by side."""
        sets = to((*self.contenders, *self.formless, *self.unsure))
        first, second = len(self.contenders), len(self.contenders) + len(self.formless)
        return replace(self, contenders=tuple(sets[:first]), formless=tuple(sets[first:second]), unsure=tuple(sets[second:]))


def select(
    runs: FreeRuns,
    tuning: Tuning,
    held_out: HeldOut | None,
    noise_energy: float,
    candidates_of: Callable[[Fitted | None], Sequence[Candidate]],
    report: Report,
    *,
    another_way: bool = True,
) -> Selection:
    """Add effects one at a time, once more from another first one that was not told apart, where further ones were found, and once more
    from the likeliest set where it leaves less than the one at the end: further effects are looked for beside what is named.

    Parameters
    ----------
    runs : FreeRuns
    tuning : Tuning
        Without effects.
    held_out : HeldOut or None
    noise_energy : float
        Expected |residual|^2 of a perfect simulation.
    candidates_of : callable
        Candidates with start values, given the effects found so far.
    report : callable
        Told what is being done, and how far the whole is.
    another_way : bool
        Whether effects are added from another first one, or from the likeliest set, at all.
    """
    judgement = Judgement(runs, tuning, held_out, noise_energy, partial(form_error, runs), lambda name: onset(runs, name, tuning))
    search = Search(runs, tuning, judgement, noise_energy, candidates_of, report)
    first = search.step(Way(judgement.nothing))
    way = search.to_the_end(first)
    rival = another_first(first.contenders, way.stand.effects, first.stand, judgement.nothing, noise_energy)
    if another_way and rival is not None:
        other = search.to_the_end(replace(first, stand=judgement.after(rival), gates=(rival.gate,), smaller=way.smaller))
        way = joined(way, other, judgement.nothing.cost, noise_energy)
    weigh = partial(evidence_of, runs, tuning, held_out, tried=len(way.screened), found=True)
    entries = len(tuning.predicted), 0 if held_out is None else len(held_out.measured)
    closer = closer_than(way.stand, way.contenders, entries, lambda some: ranking(weigh(some))[0].fitted)
    if another_way and closer is not None:
        way = continued(way, search.to_the_end(from_another(way, closer, judgement.after(closer))))
    competing = [set(one.fitted.effects) for one in way.contenders]
    unsure = tuple(one for one in way.unsure if set(one.fitted.effects) not in competing)  # a rival of the first step may be one
    smaller = (*way.smaller, *(search.parts_not_fitted(way) if another_way else ()))
    return Selection(way.stand.fitted, way.gates, way.contenders, way.screened, way.closest, way.further, way.formless, unsure, smaller)


@dataclass(frozen=True, eq=False)
class Search:
    """What is the same at every step; see `select`."""

    runs: FreeRuns
    tuning: Tuning
    judgement: Judgement
    noise_energy: float
    candidates_of: Callable[[Fitted | None], Sequence[Candidate]]
    report: Report

    def to_the_end(self, way: Way) -> Way:
        """Steps until none passes the gate."""
        while not way.is_at_its_end and len(way.stand.effects) < MOST_EFFECTS and len(way.gates) < MOST_STEPS:
            way = self.step(way)
        return way

    def is_likelier(self, fit: Fitted, chosen: Fitted | None, tried: Tried) -> bool:
        """By training than what was found, each against nothing."""
        nothing = self.judgement.nothing
        return chosen is not None and in_order([chosen, fit], nothing.cost, self.noise_energy, tried, nothing)[0] is fit

    def parts_not_fitted(self, way: Way) -> list[Fitted]:
        """What the search ended with, and the set that gains most, without each of their effects, where they were not fitted so: whether
        a name shows by enough is asked of all its effects.
        """
        if way.stand.fitted is None:
            return []
        most = max(way.contenders, key=lambda one: one.gained + one.gained_held_out)
        starts: list[Start] = []
        for named in {id(one): one for one in (way.stand.fitted, most.fitted)}.values():
            fitted = [*(set(part.effects) for part in way.smaller), *(set(names) for names, _ in starts)]
            starts += [start for start in without_one(named) if set(start[0]) not in fitted]
        measured = self.runs.measured()
        return polish(self.runs, self.tuning, measured, [fit for fit in refit(self.runs, self.tuning, measured, starts) if fit is not None])

    def step(self, way: Way) -> Way:
        """One effect more, or a pair at the first step or in place of what was found."""
        runs, tuning, judgement, noise_energy = self.runs, self.tuning, self.judgement, self.noise_energy
        stand, chosen, nothing, measured = way.stand, way.stand.fitted, self.judgement.nothing, self.runs.measured()
        end, size = replace(way, is_at_its_end=True), len(way.stand.effects)
        self.report("screening" if size == 0 else f"screening beside {size}", 0.25 + 0.2 * size)
        found = [candidate for candidate in self.candidates_of(chosen) if candidate.effect not in stand.effects]
        limits = {**{candidate.effect: candidate.limits for candidate in found}, **way.limits}
        tried = Tried(found, way.tried)
        residual = measured - stand.tuning.predicted
        screened = (
            [*way.screened] if way.is_wider else screen(runs, stand.tuning, found, residual, () if chosen is None else chosen.settings)
        )
        screened.sort(key=lambda s: -s.score / judgement.scatter.along(s.response[: len(residual)].astype(float)))
        if not screened:
            return end
        most = REFITTED if size == 0 else REFITTED_BESIDE
        best_screened = shortlist(screened, most, WORTH_A_FIT)
        behind = [one for one in screened[: WIDER * most] if one not in best_screened]
        worth = behind if way.is_wider else best_screened
        self.report("fitting", 0.35 + 0.2 * size)
        starts = [*(beside(chosen, s) for s in worth), *instead(chosen, worth[0])]
        fits = sorted((fit for fit in refit(runs, stand.tuning, measured, starts) if fit is not None), key=lambda fit: fit.cost)
        if not fits:
            return end
        unfinished = worth_finishing(fits, stand.cost, len(residual))
        fits = finished(runs, tuning, measured, fits, unfinished)
        rarer = rarer_by_chance(fits, unfinished, [judgement.by_chance(stand, fit, tried) for fit in fits])
        fits = [*(fit for fit in fits if fit not in rarer), *polish(runs, tuning, measured, rarer)]
        fits = with_numbers_from_nominal(runs, tuning, measured, fits, stand.cost)
        best, leaner = min(fits, key=lambda fit: fit.cost), []  # those that were finished are no longer in order
        freedom = max(best.freedom - (0 if chosen is None else chosen.freedom), 1)
        if stand.cost - best.cost > needed_gain(tried.sets(best.effects[-1:]), freedom, best.cost, len(residual)):
            fits = with_other_harmonics(runs, tuning, measured, fits)
            fits = with_others_of_its_order(runs, tuning, stand, measured, fits, found)
            fits = with_numbers_of_the_file(runs, tuning, measured, fits, screened, stand)
            best = min((fit for fit in fits if set(stand.effects) < set(fit.effects)), key=lambda fit: fit.cost, default=best)
            without = without_what_stood(stand.fitted, best)
            alone = polish(runs, tuning, measured, [fit for fit in refit(runs, tuning, measured, without) if fit is not None])
            leaner = [fit for fit in alone if leaves_as_little(fit, best, tried, len(residual))]
            fits = closest_of_each(fits, [fit for fit in alone if fit in leaner or self.is_likelier(fit, chosen, tried)])
            leaner = [fit for fit in fits if set(fit.effects) in [set(part.effects) for part in leaner]]  # the closest of each
        first, singles = way.screened, way.singles
        if size == 0:
            fits = closest_of_each(way.singles, fits) if way.is_wider else fits
            first, singles = tuple(screened), tuple(fits)
            ordered = in_order(fits, nothing.cost, noise_energy, tried, nothing)
            starts = _pairs_worth_a_fit(tuning, residual, ordered, screened, nothing.cost, tried)
            twos = sorted((fit for fit in refit(runs, tuning, measured, starts) if fit is not None), key=lambda fit: fit.cost)
            closest_pair = polish(runs, tuning, measured, twos[:1])
            parts = [start for pair in closest_pair for start in without_one(pair)]
            alone = polish(runs, tuning, measured, [fit for fit in refit(runs, tuning, measured, parts) if fit is not None])
            fits = closest_of_each([*fits, *closest_pair, *twos[1:]], alone)
            singles = tuple(fit for fit in fits if len(fit.effects) == 1)
        exact = [fit for fit in fits if fit in leaner or needs_all(fit, stand, singles, None, tried, len(residual))]
        fits = [fit for fit in exact if fit in leaner or needs_all(fit, stand, singles, nothing.cost, tried, len(residual))]
        doubtful = [] if stand.effects else [fit for fit in exact if fit not in fits]
        if not fits:  # none of those beside the stand could be simulated, and none in its place gains enough
            return replace(end, screened=first, singles=singles, limits=limits, tried=tried)
        if size == 0:
            stand = judgement.without_own_lines(fits)

        def may_stand(fit: Fitted) -> bool:
            """As what was found: a set without one of the stand's effects is judged against nothing."""
            return fit.cost < stand.cost and needs_all(fit, stand, singles, nothing.cost, tried, len(residual))

        fits = with_what_acts(runs, tuning, measured, fits, stand.effects, may_stand)
        fits = in_order(fits, nothing.cost, noise_energy, tried, stand)
        closest = min(fits, key=lambda fit: fit.cost)
        placebo = placebo_gain(runs, stand.tuning, screened, residual)
        placebos = placebo, placebo if size == 0 else way.placebo
        judged = judgement.contenders(stand, fits, tried, placebos, limits)

        after = cache(judgement.after)

        def is_there_beside(one: Contender, part: Contender) -> bool:
            return judgement.contenders(after(part), [one.fitted], tried, placebos, limits)[0].passed

        def is_no_chance_beside_its_parts(one: Contender) -> bool:
            parts = parts_that_passed(one, judged) if size == 0 else []
            return all(judgement.by_chance(after(part), one.fitted, tried) < 1.0 for part in parts)

        def without_surplus(sets: Sequence[Contender], smaller: Sequence[Fitted]) -> list[Contender]:
            needed = [one for one in sets if has_no_surplus(one.fitted, stand, smaller, tried, len(residual))]
            needed = [one for one in needed if not one.passed or all(is_there_beside(one, part) for part in closer_parts(one, way))]
            return [one for one in needed if not one.passed or is_no_chance_beside_its_parts(one)]

        needed = without_surplus(judged, (*way.smaller, *leaner))
        smaller = (*way.smaller, *fits)
        also_passed = [one for one in needed if one.passed]
        passed = [one for one in also_passed if one.fitted.cost < stand.cost]  # in place of what was found stands only what leaves less
        if size == 0 and not passed and behind and not way.is_wider and any(one.gate.training_shows_something for one in judged):
            wider = self.step(replace(way, screened=first, singles=singles, is_wider=True))
            if wider.gates:  # some of those behind could be simulated
                return wider
        formless = (*way.formless, *without_form(needed))
        refused = next((one for one in judged if one not in also_passed), judged[0])
        gates = (*way.gates, passed[0].gate if passed else _refused(refused, needed))
        further = least_by_chance(judged, stand)
        end = Way(
            stand, gates, way.contenders, first, closest, further, singles, smaller, limits, tried, True, formless, placebo=placebos[1]
        )
        if not passed and chosen is not None:
            larger = [one for one in needed if set(stand.effects) < set(one.fitted.effects)]
            unsure = tuple(one for one in larger if one.gate.shows and not one.gate.lost_form)
            return replace(end, contenders=tuple(with_others(way.contenders, also_passed, chosen)), unsure=unsure)
        rivals = [one for one in needed if one.passed or competes(one, passed[0] if passed else None)]
        rivals = [one for one in rivals if not passed or not is_unrelated(one, passed, stand)]
        if passed:  # naming weighs pairs whose second effect may be the first one's error
            also = judgement.contenders(stand, doubtful, tried, placebos, limits, len(fits))
            likely = [one for one in also if one.passed and is_no_chance_beside_its_parts(one)]
            rivals += likely
            known = not_told_apart_in_training(way.contenders, rivals, nothing.cost, noise_energy)
            there = [set(one.fitted.effects) for one in (*way.contenders, *rivals)]
            starts = beside_rivals(known, stand.fitted, passed[0].fitted, there)
            several = next((one.fitted for one in (*passed, *likely) if len(one.fitted.effects) > 1), passed[0].fitted)
            there += [*(set(fit.effects) for fit in fits), *(set(names) for names, _ in starts)]
            starts += exchanged(tuning, several, singles, first, there)
            there += [*(set(fit.effects) for fit in way.smaller), *(set(names) for names, _ in starts)]
            banks = bank_of((), screened), bank_of(singles, first)
            for likely_set in {id(fit): fit for fit in (several, passed[0].fitted)}.values():
                near = neighbours_of_all(likely_set, stand.effects, banks, there, runs.machine.plant)
                there += [set(names) for names, _ in near]
                starts += near
            refitted = polish(runs, tuning, measured, [fit for fit in refit(runs, tuning, measured, starts) if fit is not None])
            more = judgement.contenders(stand, refitted, tried, placebos, limits, len(fits))
            more = without_surplus(more, (*smaller, *refitted))
            rivals += [one for one in more if one.passed]
            end = replace(end, formless=(*formless, *without_form(more)), smaller=(*smaller, *refitted))
        end = replace(end, contenders=(*rivals, *still_in(way.contenders, rivals)))
        return replace(end, stand=after(passed[0]), further=np.inf, is_at_its_end=False) if passed else end


def _refused(best: Contender, needed: Sequence[Contender]) -> Gate:
    """The gate of the step that ends a search."""
    return best.gate if best in needed or best.gate.lost_form else replace(best.gate, lost_form=SURPLUS)


def _pairs_worth_a_fit(
    tuning: Tuning, residual: np.ndarray, singles: Sequence[Fitted], screened: Sequence[Screened], base: float, tried: Tried
) -> list[Start]:
    """Starts of the pairs whose filter says that they may be likelier than the best single effect, and more than chance."""
    found = pairs(tuning, residual, singles, screened)
    if not found:
        return []
    best, entries = singles[0], len(residual)
    temper = temperature(base - min(best.cost, base - found[0].gain), min(best.cost, base - found[0].gain) - entries)
    price = price_of_a_parameter(base - best.cost, temper)
    least = 0.5 * (base - best.cost) / temper - price_in_training(best, temper, tried.searched_for(best)) - PAIR_MARGIN

    def evidence(pair: Pair) -> float:
        return 0.5 * pair.gain / temper - pair.freedom * price - tried.searched(pair.start[0])

    worth = [
        pair
        for pair in found
        if evidence(pair) > least
        and best.effects[0] not in pair.start[0]  # what is to be added to it is looked for beside it
        and pair.added > needed_gain(tried.count, 1, base - pair.gain, entries)
    ]
    return [pair.start for pair in sorted(worth, key=lambda pair: -evidence(pair))[:PAIRED]]


def still_in(earlier: Sequence[Contender], larger: Sequence[Contender]) -> list[Contender]:
    """Sets of a step before that compete with the larger sets of this one: they gain as much, and are no part of one that passed too."""
    if not larger:
        return []
    return [
        one
        for one in earlier
        if is_rival_of(one, larger)
        and not any(set(one.fitted.effects) <= set(other.fitted.effects) for other in larger if other.passed or not one.passed)
    ]


def in_order(fits: Sequence[Fitted], base: float, noise_energy: float, tried: Tried, stand: Stand) -> list[Fitted]:
    """Fitted sets by their evidence on the training recordings, see naming.py."""
    if not fits:
        return []
    known = sum(gate.gain for gate in stand.steps(numbers=True))

    def by_numbers(fit: Fitted) -> float:
        if set(fit.effects) <= numbers_of(fit):
            return base - fit.cost
        return known if set(stand.effects) <= set(fit.effects) else 0.0

    temper = temperature_of([Removing(fit.cost, by_numbers(fit), are_of_the_file(fit)) for fit in fits], base, noise_energy)
    return sorted(fits, key=lambda fit: 0.5 * fit.cost / temper + price_in_training(fit, temper, tried.searched_for(fit)))
