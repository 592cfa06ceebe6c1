"""Which sets of effects are worth weighing: the best candidates singly, then added to the best set as long as each is there for certain."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from hil.diagnosis.candidates import Candidate
from hil.diagnosis.form_error import form_error
from hil.diagnosis.free_run import FreeRuns
from hil.diagnosis.gate import Gate, needed_gain, placebo_gain
from hil.diagnosis.half_orders import with_half_orders
from hil.diagnosis.held_out import HeldOut
from hil.diagnosis.judgement import Contender, Judgement, Stand, Tried
from hil.diagnosis.naming import PLAUSIBLE, Weighed, numbers_of, price_of_a_parameter, temperature, temperature_of
from hil.diagnosis.pairs import Pair, Start, beside_rivals, pairs
from hil.diagnosis.refit import NEARLY, POLISHED_GAIN, POLISHING_ROUNDS, Fitted, polish, refit
from hil.diagnosis.result import EffectAt
from hil.diagnosis.retune import Tuning
from hil.diagnosis.screening import Screened, screen, shortlist

REFITTED = 8
"""Candidates refitted after the first screening."""

REFITTED_BESIDE = 5
"""Candidates refitted beside effects that were found already."""

POLISHED = 3
"""Fits that are continued with sensitivities taken where they are, and as many again of those that gain nearly as much (NEARLY): an
unfinished fit of a law that holds another is no evidence against it."""

FINISHING_RUNS = 450
"""Free runs of polishing after which no more than POLISHED go on: a machine of 49 numbers takes 60 to 150 for each that is near its end,
600 for one that is far from it."""

PAIRED = 3
"""Pairs that are fitted beside single effects: a flexible law imitates two simple ones that act together, and alone neither of them comes
near it."""

PAIR_MARGIN = 8.0
"""Logarithm of the evidence by which a pair's filter may stay behind the best single effect and still be worth a fit."""

MOST_EFFECTS = 3
RIVAL_SHARE = 0.5
"""Of the chosen set's certain gain: sets that gain more compete with it for the name, whether or not they passed the gate."""

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
    """

    chosen: Fitted | None
    gates: tuple[Gate, ...]
    contenders: tuple[Contender, ...]
    screened: tuple[Screened, ...]
    closest: Fitted | None
    further: float = np.inf


def select(
    runs: FreeRuns,
    tuning: Tuning,
    held_out: HeldOut | None,
    noise_energy: float,
    candidates_of: Callable[[Fitted | None], Sequence[Candidate]],
    report: Report,
) -> Selection:
    """Add effects one at a time.

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
    """
    measured = runs.measured()
    judgement = Judgement(runs, tuning, held_out, noise_energy, partial(form_error, runs))
    nothing = stand = judgement.nothing
    gates: list[Gate] = []
    contenders: tuple[Contender, ...] = ()
    first: list[Screened] = []
    singles: list[Fitted] = []
    smaller: list[Fitted] = []
    closest: Fitted | None = None
    limits: dict[EffectAt, float] = {}
    tried: Tried | None = None
    further = np.inf
    for size in range(MOST_EFFECTS):
        chosen = stand.fitted
        if len(stand.effects) >= MOST_EFFECTS:
            break
        report("screening" if size == 0 else f"screening beside {size}", 0.25 + 0.2 * size)
        found = [candidate for candidate in candidates_of(chosen) if candidate.effect not in stand.effects]
        tried = Tried(found, tried)
        residual = measured - stand.tuning.predicted
        screened = screen(runs, stand.tuning, found, residual, () if chosen is None else chosen.settings)
        screened.sort(key=lambda s: -s.score / judgement.scatter.along(s.response[: len(residual)].astype(float)))
        if not screened:
            break
        most = REFITTED if size == 0 else REFITTED_BESIDE
        worth = shortlist(screened, most, WORTH_A_FIT)
        report("fitting", 0.35 + 0.2 * size)
        starts = [*(_beside(chosen, s) for s in worth), *_instead(chosen, worth[0])]
        fits = sorted((fit for fit in refit(runs, stand.tuning, measured, starts) if fit is not None), key=lambda fit: fit.cost)
        if not fits:
            break
        fits = _finished(runs, tuning, measured, fits, _worth_finishing(fits, stand.cost, len(residual)))
        best = min(fits, key=lambda fit: fit.cost)  # those that were finished are no longer in order
        if stand.cost - best.cost > needed_gain(tried.sets(best.effects[-1:]), best.freedom, best.cost, len(residual)):
            fits = with_half_orders(runs, tuning, measured, fits)
        if size == 0:
            first, singles = screened, fits
            limits = {candidate.effect: candidate.limit for candidate in found}
            ordered = in_order(fits, nothing.cost, noise_energy, tried, nothing)
            starts = _pairs_worth_a_fit(tuning, residual, ordered, screened, nothing.cost, tried)
            twos = sorted((fit for fit in refit(runs, tuning, measured, starts) if fit is not None), key=lambda fit: fit.cost)
            fits = [*fits, *polish(runs, tuning, measured, twos[:1]), *twos[1:]]
        exact = [fit for fit in fits if _needs_all(fit, stand, singles, None, tried, len(residual))]
        fits = [fit for fit in exact if _needs_all(fit, stand, singles, nothing.cost, tried, len(residual))]
        doubtful = [] if stand.effects else [fit for fit in exact if fit not in fits]
        if not fits:  # none of those beside the stand could be simulated, and none in its place gains enough
            break
        fits = in_order(fits, nothing.cost, noise_energy, tried, stand)
        closest = min(fits, key=lambda fit: fit.cost)
        placebo = placebo_gain(runs, stand.tuning, screened, residual)
        judged = judgement.contenders(stand, fits, tried, placebo, limits)
        further = least_by_chance(judged, stand)
        needed = [one for one in judged if has_no_surplus(one.fitted, stand, smaller, tried, len(residual))]
        smaller = [*smaller, *fits]
        passed = [one for one in needed if one.passed]
        gates.append(passed[0].gate if passed else _refused(judged[0], needed))
        if not passed and chosen is not None:
            break
        least = RIVAL_SHARE * passed[0].gate.certain_gain if passed else 0.0
        rivals = [one for one in needed if one.passed or (one.gate.certain_gain > least and not one.gate.lost_form)]
        if passed:  # naming weighs pairs whose second effect may be the first one's error
            rivals += [one for one in judgement.contenders(stand, doubtful, tried, placebo, limits, len(fits)) if one.passed]
            known = _not_told_apart(contenders, rivals, nothing.cost, noise_energy)
            there = [set(one.fitted.effects) for one in (*contenders, *rivals)]
            starts = beside_rivals(known, stand.fitted, passed[0].fitted, there)
            also = [fit for fit in refit(runs, tuning, measured, starts) if fit is not None]
            more = judgement.contenders(stand, polish(runs, tuning, measured, also), tried, placebo, limits, len(fits))
            rivals += [one for one in more if one.passed and has_no_surplus(one.fitted, stand, smaller, tried, len(residual))]
        contenders = (*rivals, *_still_in(contenders, rivals))
        if not passed:
            break
        stand, further = judgement.after(passed[0]), np.inf
    return Selection(stand.fitted, tuple(gates), contenders, tuple(first), closest, further)


def _refused(best: Contender, needed: Sequence[Contender]) -> Gate:
    """The gate of the step that ends a search."""
    return best.gate if best in needed or best.gate.lost_form else replace(best.gate, lost_form=SURPLUS)


def least_by_chance(judged: Sequence[Contender], stand: Stand) -> float:
    """Of sets that add an effect to those that were found: the least expected number that gain as much in training by chance."""
    beside = [one.gate.trained for one in judged if stand.effects and set(stand.effects) < set(one.fitted.effects)]
    return min(beside, default=np.inf)


def _worth_finishing(fits: Sequence[Fitted], before: float, entries: int) -> int:
    """How many of the fits, the best first, are polished; `before` is the cost without what they add."""
    best = before - fits[0].cost
    near = sum(before - fit.cost > NEARLY * best for fit in fits) if best > needed_gain(1, 1, fits[0].cost, entries) else 0
    return min(max(near, POLISHED), 2 * POLISHED)


def _finished(runs: FreeRuns, tuning: Tuning, measured: np.ndarray, fits: Sequence[Fitted], unfinished: int) -> list[Fitted]:
    """The fits with the first of them polished."""
    began = runs.count
    done = polish(runs, tuning, measured, fits[: min(unfinished, POLISHED)])
    for fit in fits[len(done) : unfinished]:
        before = None
        for _ in range(POLISHING_ROUNDS):
            if runs.count - began > FINISHING_RUNS or (before is not None and before.cost - fit.cost < POLISHED_GAIN):
                break
            before = fit
            (fit,) = polish(runs, tuning, measured, [fit], 1)
        done.append(fit)
    return [*done, *fits[len(done) :]]


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
    least = 0.5 * (base - best.cost) / temper - _price(best, temper, tried) - PAIR_MARGIN

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


def _needs_all(fit: Fitted, stand: Stand, singles: Sequence[Fitted], base: float | None, tried: Tried, entries: int) -> bool:
    """Whether a pair without the chosen set gains more over each of its own effects than chance and, with the cost of no effect at all as
    `base`, that one's equation allow.
    """
    if set(stand.effects) <= set(fit.effects) and (stand.effects or len(fit.effects) == 1):
        return True
    for single in singles:
        if single.effects[0] in fit.effects:
            added = [effect for effect in fit.effects if effect not in single.effects]
            temper = 1.0 if base is None else temperature(base - single.cost, fit.cost - entries)
            if single.cost - fit.cost < temper * needed_gain(tried.sets(added), fit.freedom - single.freedom, fit.cost, entries):
                return False
    return True


def has_no_surplus(fit: Fitted, stand: Stand, smaller: Sequence[Fitted], tried: Tried, entries: int) -> bool:
    """Whether a set gains more than chance over every part of it that was fitted before, the stand apart, which the gate asks about: an
    effect that stood for others is surplus beside them.
    """
    for part in smaller:
        if set(part.effects) < set(fit.effects) and set(part.effects) != set(stand.effects):
            added = [effect for effect in fit.effects if effect not in part.effects]
            if part.cost - fit.cost < needed_gain(tried.sets(added), max(fit.freedom - part.freedom, 1), fit.cost, entries):
                return False
    return True


def _not_told_apart(earlier: Sequence[Contender], larger: Sequence[Contender], base: float, noise_energy: float) -> list[Fitted]:
    """Sets of a step before that passed the gate and that an equation's error may hold beside the larger sets of this one, though they
    leave more; `base` is the cost of no effect at all.
    """
    weighed = [(base - one.gained, one.by_numbers[0]) for one in (*earlier, *larger)]
    much = -2.0 * math.log(PLAUSIBLE) * temperature_of(weighed, base, noise_energy)
    most = max(one.gained for one in larger)
    return [one.fitted for one in earlier if one.passed and one.gained > most - much]


def _still_in(earlier: Sequence[Contender], larger: Sequence[Contender]) -> list[Contender]:
    """Sets of a step before that compete with the larger sets of this one: they gain as much, and are no part of one."""
    if not larger:
        return []
    most = max(rival.gained for rival in larger)
    return [
        one
        for one in earlier
        if one.gained > RIVAL_SHARE * most and not any(set(one.fitted.effects) <= set(other.fitted.effects) for other in larger)
    ]


def _beside(chosen: Fitted | None, added: Screened) -> tuple[tuple[EffectAt, ...], tuple[np.ndarray, ...]]:
    if chosen is None:
        return (added.effect,), (added.values,)
    return (*chosen.effects, added.effect), (*chosen.values, added.values)


def _instead(chosen: Fitted | None, added: Screened) -> list[Start]:
    """The most promising effect in place of each of a pair: one of two that were found together may have stood for it."""
    if chosen is None or len(chosen.effects) < 2:
        return []
    kept = [[k for k in range(len(chosen.effects)) if k != left_out] for left_out in range(len(chosen.effects))]
    return [((*(chosen.effects[k] for k in ks), added.effect), (*(chosen.values[k] for k in ks), added.values)) for ks in kept]


def in_order(fits: Sequence[Fitted], base: float, noise_energy: float, tried: Tried, stand: Stand) -> list[Fitted]:
    """Fitted sets by their evidence on the training recordings, see naming.py."""
    if not fits:
        return []
    known = sum(gate.gain for gate in stand.steps(numbers=True))

    def by_numbers(fit: Fitted) -> float:
        if set(fit.effects) <= numbers_of(fit):
            return base - fit.cost
        return known if set(stand.effects) <= set(fit.effects) else 0.0

    temper = temperature_of([(fit.cost, by_numbers(fit)) for fit in fits], base, noise_energy)
    return sorted(fits, key=lambda fit: 0.5 * fit.cost / temper + _price(fit, temper, tried))


def _price(fitted: Fitted, temper: float, tried: Tried) -> float:
    information = tuple(fitted.information.tolist())
    return Weighed(fitted, 0.0, 0.0, information, searched=tried.searched(fitted.effects)).price(temper)
