"""One step of a search: an effect more beside what was found, or a pair at the first one or in its place."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property

import numpy as np

from hil.diagnosis.fitting.refit import Fitted, polish, refit
from hil.diagnosis.fitting.screening import Screened, screen, shortlist
from hil.diagnosis.judging.errors_of_laws import temperature
from hil.diagnosis.judging.gate import Gate, needed_gain
from hil.diagnosis.judging.judgement import Contender, Judgement, Stand
from hil.diagnosis.judging.placebos import Placebos, placebos_of
from hil.diagnosis.judging.tried import Tried
from hil.diagnosis.ranking.naming import price_of_a_parameter
from hil.diagnosis.ranking.weighing import least_by_chance, without_form
from hil.diagnosis.result import EffectAt
from hil.diagnosis.searching.exchanged import another_for_each, bank_of, exchanged, neighbours_of_all
from hil.diagnosis.searching.finishing import closest_of_each, finished, rarer_by_chance, worth_finishing
from hil.diagnosis.searching.from_nominal import with_numbers_from_nominal
from hil.diagnosis.searching.harmonics import with_other_harmonics
from hil.diagnosis.searching.numbers_of_the_file import with_numbers_of_the_file
from hil.diagnosis.searching.other_starts import with_other_starts
from hil.diagnosis.searching.pairs import Pair, Start, beside, beside_rivals, instead, only, pairs, without_one, without_what_stood
from hil.diagnosis.searching.same_order import with_others_of_its_order
from hil.diagnosis.searching.surplus import has_no_surplus, leaves_as_little, needs_all, parts_that_passed
from hil.diagnosis.searching.ways import (
    Way,
    closer_parts,
    competes,
    in_order,
    not_told_apart_in_training,
    price_in_training,
    still_in,
    with_others,
    without_unrelated,
)
from hil.diagnosis.searching.what_acts import with_what_acts
from hil.diagnosis.starting.candidates import Candidate
from hil.diagnosis.tuning.free_run import FreeRuns
from hil.diagnosis.tuning.retune import Tuning

MOST_EFFECTS = 3
"""Of a set: of more, others that were not tried may fit as well."""

MOST_STEPS = 5
"""Steps of one way: a set that gave way to one without one of its effects is looked beside as any other, twice at most."""

REFITTED = 8
"""Candidates refitted after the first screening."""

REFITTED_BESIDE = 5
"""Candidates refitted beside effects that were found already."""

PAIRED = 3
"""Pairs that are fitted beside single effects: a flexible law imitates two simple ones that act together, and alone neither of them comes
near it."""

PAIR_MARGIN = 8.0
"""Logarithm of the evidence by which a pair's filter may stay behind the best single effect and still be worth a fit."""

WIDER = 3
"""Times as many candidates are fitted first where training shows something for certain and none of the best explains it: a far or nearly
degenerate machine's screening is wrong by more than candidates differ by. Gravity may come first with a score of 255 and gain 9, while an
inertia over pose, thirteenth with 56, gains 292."""

WORTH_A_FIT = 0.02
"""Of the best score: candidates below are not refitted."""

SURPLUS = "the set gains no more than chance over a part of it without another of its effects"

Report = Callable[[str, float], None]


@dataclass(frozen=True, eq=False)
class Steps:
    """Steps of a search, with what is the same at each; see `selection.select`."""

    runs: FreeRuns
    tuning: Tuning
    judgement: Judgement
    noise_energy: float
    candidates_of: Callable[[Fitted | None], Sequence[Candidate]]
    report: Report

    def to_the_end(self, way: Way) -> Way:
        """Until none passes the gate."""
        while not way.is_at_its_end and _may_go_on(way.stand.effects, way.gates):
            way = self.step(way)
        return way

    @cached_property
    def measured(self) -> np.ndarray:
        return self.runs.measured()

    def fits_from(self, starts: Sequence[Start], tuning: Tuning | None = None) -> list[Fitted]:
        """Those that can be simulated, in the order of their starts."""
        return [fit for fit in refit(self.runs, self.tuning if tuning is None else tuning, self.measured, starts) if fit is not None]

    def polished(self, fits: Sequence[Fitted]) -> list[Fitted]:
        return polish(self.runs, self.tuning, self.measured, fits)

    def step(self, way: Way, before: Sequence[Fitted] = ()) -> Way:
        """One effect more, or a pair at the first step or in place of what was found; anew where that came closer beside a larger set, with
        the fits beside it of before.
        """
        begun = self._begin(way)
        fits, leaner = self._fitted(begun, before)
        if not fits:
            return replace(way, is_at_its_end=True)
        if not before and (closer := self._with_a_closer_stand(begun, fits)) is not None:
            return self.step(closer, [fit for fit in fits if set(way.stand.effects) < set(fit.effects)])
        first, singles = way.screened, way.singles
        if begun.is_first:
            first = tuple(begun.screened)
            fits = self._with_pairs(begun, closest_of_each(way.singles, fits) if way.is_wider else fits)
            singles = tuple(fit for fit in fits if len(fit.effects) == 1)
        fits, doubtful = self._that_need_all(begun, fits, leaner, singles)
        if not fits:  # none of those beside the stand could be simulated, and none in its place gains enough
            return replace(way, is_at_its_end=True, screened=first, singles=singles, limits=begun.limits, tried=begun.tried)
        # from here on lines that only the held-out recordings have count by their own power
        stand = self.judgement.without_own_lines(fits) if begun.is_first else way.stand
        fits = self._acting(begun, stand, fits, singles)
        closest = min(fits, key=lambda fit: fit.cost)
        gate, fits = self._with_others_of_formless(self._ask(begun, stand, fits), fits, singles, first)
        needed = gate.without_surplus(gate.judged, (*way.smaller, *leaner))
        also_passed = [one for one in needed if one.passed]
        passed = [one for one in also_passed if one.fitted.cost < stand.cost]  # in place of what was found stands only what leaves less
        shows = any(one.gate.training_shows_something for one in gate.judged)
        if begun.is_first and not passed and begun.behind and not way.is_wider and shows:
            wider = self.step(replace(way, screened=first, singles=singles, is_wider=True))
            if wider.gates:  # some of those behind could be simulated
                return wider
        refused = next((one for one in gate.judged if one not in also_passed), gate.judged[0])
        end = Way(
            stand,
            (*way.gates, passed[0].gate if passed else _refused(refused, needed)),
            way.contenders,
            first,
            closest,
            least_by_chance(gate.judged, stand),
            singles,
            (*way.smaller, *fits),
            begun.limits,
            begun.tried,
            True,
            (*way.formless, *without_form(needed)),
            placebos=gate.placebos[1],
        )
        if passed:
            return self._gone_on(gate, end, passed, needed, doubtful)
        if stand.fitted is not None:
            larger = [one for one in needed if set(stand.effects) < set(one.fitted.effects)]
            unsure = tuple(one for one in larger if one.gate.shows and not one.gate.lost_form)
            return replace(end, contenders=tuple(with_others(way.contenders, also_passed, stand.fitted)), unsure=unsure)
        rivals = [one for one in needed if one.passed or competes(one, None)]
        return replace(end, contenders=(*rivals, *still_in(way.contenders, rivals)))

    def _begin(self, way: Way) -> _Begun:
        """All candidates beside what was found, and those of them that are worth a fit."""
        stand, chosen, size = way.stand, way.stand.fitted, len(way.stand.effects)
        self.report("screening" if size == 0 else f"screening beside {size}", 0.25 + 0.2 * size)
        found = [candidate for candidate in self.candidates_of(chosen) if candidate.effect not in stand.effects]
        limits = {**{candidate.effect: candidate.limits for candidate in found}, **way.limits}
        residual = self.measured - stand.tuning.predicted
        screened = (
            [*way.screened] if way.is_wider else screen(self.runs, stand.tuning, found, residual, () if chosen is None else chosen.settings)
        )
        screened.sort(key=lambda s: -s.score / self.judgement.scatter.along(s.response[: len(residual)].astype(float)))
        most = REFITTED if size == 0 else REFITTED_BESIDE
        best = shortlist(screened, most, WORTH_A_FIT) if screened else []
        behind = [one for one in screened[: WIDER * most] if one not in best]
        return _Begun(way, residual, found, screened, behind if way.is_wider else best, behind, limits, Tried(found, way.tried))

    def _fitted(self, begun: _Begun, before: Sequence[Fitted]) -> tuple[list[Fitted], list[Fitted]]:
        """Fits of what is worth one and those of before, and of them those that need not all that they were added to."""
        runs, tuning, measured, stand, tried = self.runs, self.tuning, self.measured, begun.way.stand, begun.tried
        chosen, entries = stand.fitted, len(begun.residual)
        self.report("fitting", 0.35 + 0.2 * len(stand.effects))
        starts = [*(beside(chosen, s) for s in begun.worth), *(start for s in begun.worth[:1] for start in instead(chosen, s))]
        fits = sorted(closest_of_each(self.fits_from(starts, stand.tuning), before), key=lambda fit: fit.cost)
        if not fits:
            return [], []
        unfinished = worth_finishing(fits, stand.cost, entries)
        fits = finished(runs, tuning, measured, fits, unfinished)
        rarer = rarer_by_chance(fits, unfinished, [self.judgement.by_chance(stand, fit, tried) for fit in fits])
        fits = [*(fit for fit in fits if fit not in rarer), *self.polished(rarer)]
        fits = with_numbers_from_nominal(runs, tuning, measured, fits, stand.cost)
        best = min(fits, key=lambda fit: fit.cost)  # those that were finished are no longer in order
        freedom = max(best.freedom - (0 if chosen is None else chosen.freedom), 1)
        if not stand.cost - best.cost > needed_gain(tried.sets(best.effects[-1:]), freedom, best.cost, entries):
            return fits, []
        fits = with_other_starts(runs, tuning, stand, measured, fits, begun.found, self.noise_energy)
        fits = with_other_harmonics(runs, tuning, measured, fits)
        fits = with_others_of_its_order(runs, tuning, stand, measured, fits, begun.found)
        fits = with_numbers_of_the_file(runs, tuning, measured, fits, begun.screened, stand)
        best = min((fit for fit in fits if set(stand.effects) < set(fit.effects)), key=lambda fit: fit.cost, default=best)
        alone = self.polished(self.fits_from(without_what_stood(chosen, best)))
        leaner = [fit for fit in alone if leaves_as_little(fit, best, tried, entries)]
        fits = closest_of_each(fits, [fit for fit in alone if fit in leaner or self._is_likelier(fit, chosen, tried)])
        return fits, [fit for fit in fits if set(fit.effects) in [set(part.effects) for part in leaner]]  # the closest of each

    def _with_a_closer_stand(self, begun: _Begun, fits: Sequence[Fitted]) -> Way | None:
        """The way with what was found where it is beside the closest set that adds to it, if it leaves less there by itself.

        Alone its fit may have ended elsewhere, and whatever moves it from there would gain what it gains: beside a drive's lag even a
        friction of no strength may gain 128.
        """
        way, stand, entries, size = begun.way, begun.way.stand, len(begun.residual), len(begun.way.stand.effects)
        larger = [fit for fit in fits if len(fit.effects) > size and fit.effects[:size] == stand.effects]
        if stand.fitted is None or not larger:
            return None
        best = min(larger, key=lambda fit: fit.cost)
        if stand.cost - best.cost < needed_gain(1.0, 1, best.cost, entries):
            return None
        alone = self.polished(self.fits_from([only(best, stand.effects)]))
        if not alone or stand.cost - alone[0].cost < needed_gain(1.0, 1, alone[0].cost, entries):
            return None
        own = next((one for one in way.contenders if one.fitted is stand.fitted), None)
        if own is None or way.tried is None:
            return None
        closer = self.judgement.closer(own, alone[0], way.tried, way.limits)
        if closer is None:
            return None
        return replace(
            way,
            stand=self.judgement.after(closer),
            gates=tuple(closer.gate if gate is own.gate else gate for gate in way.gates),
            contenders=tuple(closer if one is own else one for one in way.contenders),
            singles=tuple(closest_of_each(way.singles, [closer.fitted])) if size == 1 else way.singles,
            smaller=(*way.smaller, closer.fitted),
            limits=begun.limits,
            tried=begun.tried,
        )

    def _is_likelier(self, fit: Fitted, chosen: Fitted | None, tried: Tried) -> bool:
        """By training than what was found, each against nothing."""
        nothing = self.judgement.nothing
        return chosen is not None and in_order([chosen, fit], nothing.cost, self.noise_energy, tried, nothing)[0] is fit

    def _with_pairs(self, begun: _Begun, fits: Sequence[Fitted]) -> list[Fitted]:
        """First fits, with pairs that their filter puts near the best of them, and the parts of the closest pair."""
        nothing = self.judgement.nothing
        ordered = in_order(fits, nothing.cost, self.noise_energy, begun.tried, nothing)
        starts = _pairs_worth_a_fit(self.tuning, begun.residual, ordered, begun.screened, nothing.cost, begun.tried)
        twos = sorted(self.fits_from(starts), key=lambda fit: fit.cost)
        closest_pair = self.polished(twos[:1])
        alone = self.polished(self.fits_from([start for pair in closest_pair for start in without_one(pair)]))
        return closest_of_each([*fits, *closest_pair, *twos[1:]], alone)

    def _that_need_all(
        self, begun: _Begun, fits: Sequence[Fitted], leaner: Sequence[Fitted], singles: Sequence[Fitted]
    ) -> tuple[list[Fitted], list[Fitted]]:
        """Those that need all of their effects, and first ones of which one may be another's error."""
        stand, base, entries = begun.way.stand, self.judgement.nothing.cost, len(begun.residual)
        exact = [fit for fit in fits if fit in leaner or needs_all(fit, stand, singles, None, begun.tried, entries)]
        needed = [fit for fit in exact if fit in leaner or needs_all(fit, stand, singles, base, begun.tried, entries)]
        return needed, [] if stand.effects else [fit for fit in exact if fit not in needed]

    def _acting(self, begun: _Begun, stand: Stand, fits: Sequence[Fitted], singles: Sequence[Fitted]) -> list[Fitted]:
        """Fits without effects that do nothing in them, in the order of their evidence."""
        nothing, entries = self.judgement.nothing, len(begun.residual)

        def may_stand(fit: Fitted) -> bool:
            """As what was found: a set without one of the stand's effects is judged against nothing."""
            return fit.cost < stand.cost and needs_all(fit, stand, singles, nothing.cost, begun.tried, entries)

        acting = with_what_acts(self.runs, self.tuning, self.measured, fits, stand.effects, may_stand)
        return in_order(acting, nothing.cost, self.noise_energy, begun.tried, stand)

    def _ask(self, begun: _Begun, stand: Stand, fits: Sequence[Fitted]) -> _AtTheGate:
        """The gate, with its answers about these sets."""
        here = placebos_of(self.runs, stand.tuning, begun.screened, begun.residual)
        placebos = here, here if begun.is_first else begun.way.placebos
        judged = self.judgement.contenders(stand, fits, begun.tried, placebos, begun.limits)
        return _AtTheGate(self.judgement, begun, stand, placebos, judged)

    def _with_others_of_formless(
        self, gate: _AtTheGate, fits: Sequence[Fitted], singles: Sequence[Fitted], screened: Sequence[Screened]
    ) -> tuple[_AtTheGate, list[Fitted]]:
        """The gate, asked too about sets in which another effect stands for one of the closest set, where that has several and would pass
        but for its form, and all fits in the order of their evidence. Beside an effort read late, a gear's error at its bound is no name,
        and a motor constant, which does the same, would never be fitted there.
        """
        closest, begun = min(gate.judged, key=lambda one: one.fitted.cost), gate.begun
        if len(closest.fitted.effects) < 2 or not (closest.gate.lost_form and closest.gate.something_is_there):
            return gate, list(fits)
        there = [set(fit.effects) for fit in (*fits, *begun.way.smaller)]
        banks, settings = (bank_of((), begun.screened), bank_of(singles, screened)), self.runs.machine.plant
        starts = another_for_each(self.tuning, closest.fitted, gate.stand.effects, (singles, screened), banks, there, settings)
        more, _ = self._that_need_all(begun, self.polished(self.fits_from(starts)), (), singles)
        asked = {id(one.fitted): one for one in (*gate.judged, *gate.contenders(more, len(gate.judged)))}
        ordered = in_order([*fits, *more], self.judgement.nothing.cost, self.noise_energy, begun.tried, gate.stand)
        return replace(gate, judged=[asked[id(fit)] for fit in ordered]), ordered

    def _gone_on(
        self, gate: _AtTheGate, end: Way, passed: Sequence[Contender], needed: Sequence[Contender], doubtful: Sequence[Fitted]
    ) -> Way:
        """A way that goes on beside the best that passed, with all that competes with it."""
        way, stand, count = gate.begun.way, gate.stand, len(gate.judged)
        rivals = [one for one in needed if one.passed or competes(one, passed[0])]
        if _may_go_on(passed[0].fitted.effects, end.gates):
            rivals = without_unrelated(rivals, passed, stand)
        also = gate.contenders(doubtful, count)  # naming weighs pairs whose second effect may be the first one's error
        likely = [one for one in also if one.passed and gate.is_no_chance_beside_its_parts(one)]
        rivals += likely
        several = next((one.fitted for one in (*passed, *likely) if len(one.fitted.effects) > 1), passed[0].fitted)
        refitted = self.polished(self.fits_from(self._starts_that_compete(gate, end, rivals, passed[0].fitted, several)))
        smaller = (*end.smaller, *refitted)
        more = gate.without_surplus(gate.contenders(refitted, count), smaller)
        rivals += [one for one in more if one.passed]
        return replace(
            end,
            stand=gate.stand_beside(passed[0]),
            contenders=(*rivals, *still_in(way.contenders, rivals)),
            formless=(*end.formless, *without_form(more)),
            smaller=smaller,
            further=np.inf,
            is_at_its_end=False,
        )

    def _starts_that_compete(self, gate: _AtTheGate, end: Way, rivals: Sequence[Contender], best: Fitted, several: Fitted) -> list[Start]:
        """What was found beside rivals of the stand, and with an effect exchanged for one that answers alike or is its neighbour, each set
        once: of the best that passed, and of the best of several effects.
        """
        way, stand = gate.begun.way, gate.stand
        known = not_told_apart_in_training(way.contenders, rivals, self.judgement.nothing.cost, self.noise_energy)
        there = [set(one.fitted.effects) for one in (*way.contenders, *rivals)]
        starts = beside_rivals(known, stand.fitted, best, there)
        there += [*(set(one.fitted.effects) for one in gate.judged), *(set(names) for names, _ in starts)]
        starts += exchanged(self.tuning, several, end.singles, end.screened, there)
        there += [*(set(fit.effects) for fit in way.smaller), *(set(names) for names, _ in starts)]
        banks = bank_of((), gate.begun.screened), bank_of(end.singles, end.screened)
        for likely in {id(fit): fit for fit in (several, best)}.values():
            near = neighbours_of_all(likely, stand.effects, banks, there, self.runs.machine.plant)
            there += [set(names) for names, _ in near]
            starts += near
        return starts


@dataclass(frozen=True, eq=False)
class _Begun:
    """What a step begins with."""

    way: Way
    residual: np.ndarray
    found: Sequence[Candidate]
    screened: Sequence[Screened]  # the best first
    worth: Sequence[Screened]  # those that are fitted in this step
    behind: Sequence[Screened]  # fitted in a wider step, where none of the best passes
    limits: Mapping[EffectAt, tuple[float, float]]
    tried: Tried

    @property
    def is_first(self) -> bool:
        return not self.way.stand.effects


@dataclass(frozen=True, eq=False)
class _AtTheGate:
    """The gate of one step, with its answers about the sets that were fitted."""

    judgement: Judgement
    begun: _Begun
    stand: Stand
    placebos: tuple[Placebos, Placebos]
    judged: Sequence[Contender]

    def contenders(self, fits: Sequence[Fitted], earlier: int = 0, stand: Stand | None = None) -> list[Contender]:
        """Of sets that are asked about after so many others, beside the step's stand or another one."""
        stand = self.stand if stand is None else stand
        return self.judgement.contenders(stand, fits, self.begun.tried, self.placebos, self.begun.limits, earlier)

    @cached_property
    def stand_beside(self) -> Callable[[Contender], Stand]:
        """What sets are judged against beside one that passed."""
        return cache(self.judgement.after)

    def is_there_beside(self, one: Contender, part: Contender) -> bool:
        """Whether a set passes beside a part of it."""
        return self.contenders([one.fitted], stand=self.stand_beside(part))[0].passed

    def is_no_chance_beside_its_parts(self, one: Contender) -> bool:
        """Whether chance gains less beside each part of it that passed at the first step."""
        parts = parts_that_passed(one, self.judged) if self.begun.is_first else []
        return all(self.judgement.by_chance(self.stand_beside(part), one.fitted, self.begun.tried) < 1.0 for part in parts)

    def without_surplus(self, sets: Sequence[Contender], smaller: Sequence[Fitted]) -> list[Contender]:
        """Sets that need all of their effects: beside smaller ones, beside parts of them that leave less than the stand, and each."""
        way, entries = self.begun.way, len(self.begun.residual)
        needed = [one for one in sets if has_no_surplus(one.fitted, self.stand, smaller, self.begun.tried, entries)]
        needed = [one for one in needed if not one.passed or all(self.is_there_beside(one, part) for part in closer_parts(one, way))]
        return [one for one in needed if not one.passed or self.is_no_chance_beside_its_parts(one)]


def _may_go_on(effects: Sequence[EffectAt], gates: Sequence[Gate]) -> bool:
    """Whether another step follows beside these effects, after so many."""
    return len(effects) < MOST_EFFECTS and len(gates) < MOST_STEPS


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
