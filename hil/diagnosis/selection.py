"""Which sets of effects are worth weighing: the best candidates singly, then added to the best set as long as each is there for certain."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from hil.diagnosis.candidates import Candidate
from hil.diagnosis.form import lost_form
from hil.diagnosis.free_run import FreeRuns
from hil.diagnosis.gate import Gate, Scatter, certain_excess, needed_gain, placebo_gain
from hil.diagnosis.held_out import HeldOut
from hil.diagnosis.naming import Weighed, price_of_a_parameter, temperature
from hil.diagnosis.pairs import Start, pairs
from hil.diagnosis.projection import Projection
from hil.diagnosis.refit import Fitted, polish, refit
from hil.diagnosis.result import EffectAt
from hil.diagnosis.retune import Tuning
from hil.diagnosis.screening import Screened, screen

REFITTED = 8
"""Candidates refitted after the first screening."""

REFITTED_BESIDE = 5
"""Candidates refitted beside effects that were found already."""

POLISHED = 3
"""Fits that are continued with sensitivities taken where they are, and as many again of those that gain nearly as much (NEARLY): an
unfinished fit of a law that holds another is no evidence against it."""

NEARLY = 0.9

FINISHING_RUNS = 600
"""Free runs of polishing after which no more than POLISHED are: a machine of 59 numbers takes 1000 for each, one of 11 takes 20 to 200."""

PAIRED = 3
"""Pairs that are fitted beside single effects: a flexible law imitates two simple ones that act together, and alone neither of them comes
near it."""

PAIR_MARGIN = 5.0
"""Logarithm of the evidence by which a pair's filter may stay behind the best single effect and still be worth a fit."""

MOST_EFFECTS = 3
RIVAL_SHARE = 0.5
"""Of the chosen set's certain gain: sets that gain more compete with it for the name, whether or not they passed the gate."""

WORTH_A_FIT = 0.02
"""Of the best score: candidates below are not refitted."""

Report = Callable[[str, float], None]


@dataclass(frozen=True, eq=False)
class Contender:
    """A fitted set that competes for the name."""

    fitted: Fitted
    gained: float  # fall of the training misfit from no effect at all, less what chance gains in it
    gained_held_out: float
    left_held_out: float  # the held-out misfit
    gates: tuple[Gate, ...]  # of the step that added each of its effects
    searched: float = 0.0  # logarithm of the number of shapes searched for its effects

    @property
    def passed(self) -> bool:
        return self.gates[-1].passed  # those before did, or there were no further step


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
    """

    chosen: Fitted | None
    gates: tuple[Gate, ...]
    contenders: tuple[Contender, ...]
    screened: tuple[Screened, ...]
    closest: Fitted | None


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
    scatter = Scatter(runs)
    chosen: Fitted | None = None
    gates: list[Gate] = []
    contenders: tuple[Contender, ...] = ()
    first: list[Screened] = []
    closest: Fitted | None = None
    present = tuning
    base = float(np.sum((measured - tuning.predicted) ** 2) + np.sum(tuning.offset**2))
    unseen_at_first = 0.0 if held_out is None else held_out.misfit(held_out.base)
    passed_so_far: tuple[Gate, ...] = ()
    searched = 0.0
    lowest: dict[EffectAt, float] = {}
    for size in range(MOST_EFFECTS):
        if chosen is not None and len(chosen.effects) >= MOST_EFFECTS:
            break
        report("screening" if size == 0 else f"screening beside {size}", 0.25 + 0.2 * size)
        settings = chosen.settings if chosen is not None else ()
        taken = set(chosen.effects) if chosen is not None else set()
        found = [candidate for candidate in candidates_of(chosen) if candidate.effect not in taken]
        residual = measured - present.predicted
        screened = screen(runs, present, found, residual, settings)
        screened.sort(key=lambda s: -s.score / scatter.along(s.response[: len(residual)].astype(float)))
        if size == 0:
            first = screened
        if not screened:
            break
        most = REFITTED if size == 0 else REFITTED_BESIDE
        worth = [s for s in screened[:most] if s.score > WORTH_A_FIT * max(other.score for other in screened)]
        report("fitting", 0.35 + 0.2 * size)
        starts = [_beside(chosen, s) for s in worth]
        starts += _instead(chosen, worth[0])
        fits = [fit for fit in refit(runs, present, measured, starts) if fit is not None]
        if not fits:
            break
        fits.sort(key=lambda fit: fit.cost)
        unfinished = _worth_finishing(fits, base, len(residual))
        fits = _finished(runs, tuning, measured, fits, unfinished)
        fits = in_order(fits, base, noise_energy)
        if size == 0:
            starts = _pairs_worth_a_fit(tuning, residual, fits, screened, base, noise_energy, found)
            twos = [fit for fit in refit(runs, tuning, measured, starts) if fit is not None]
            twos = [fit for fit in twos if _needs_both(fit, fits, found, len(residual))]
            twos.sort(key=lambda fit: fit.cost)
            twos = [polish(runs, tuning, measured, fit) for fit in twos[:1]] + twos[1:]
            fits = in_order([*fits, *twos], base, noise_energy)
            lowest = {candidate.effect: candidate.lowest for candidate in found}
        placebo = placebo_gain(runs, present, screened, residual)
        judged = [
            (fit, replace(gate, lost_form=lost_form(fit, lowest)))
            for fit in fits
            for gate in [_gate(scatter, present, held_out, chosen, fit, placebo, residual, base - noise_energy, noise_energy, found)]
        ]
        closest = min(fits, key=lambda fit: fit.cost)
        passed = [(fit, gate) for fit, gate in judged if gate.passed]
        gates.append(passed[0][1] if passed else judged[0][1])
        if not passed and chosen is not None:
            break
        before = float(residual @ residual + present.offset @ present.offset)
        unseen = 0.0 if held_out is None else held_out.misfit(held_out.predictions([(present.offset, settings)])[0])
        least = RIVAL_SHARE * passed[0][1].certain_gain if passed else 0.0
        earlier = passed_so_far
        rivals = tuple(
            Contender(
                fit,
                base - before + gate.certain_gain,
                unseen_at_first - unseen + (gate.held_out_gain or 0.0),
                unseen - (gate.held_out_gain or 0.0),
                (*earlier, *[gate] * (len(fit.effects) - len(earlier))),
                searched + _searched(_added(chosen, fit), found),
            )
            for fit, gate in judged
            if gate.passed or (gate.certain_gain > least and not gate.lost_form)
        )
        contenders = (*rivals, *_still_in(contenders, rivals))
        if not passed:
            break
        searched += _searched(_added(chosen, passed[0][0]), found)
        chosen = passed[0][0]
        passed_so_far = (*earlier, *[gates[-1]] * (len(chosen.effects) - len(earlier)))
        present = replace(tuning, offset=chosen.offset, values=tuning.at(chosen.offset), predicted=chosen.predicted)
    return Selection(chosen, tuple(gates), contenders, tuple(first), closest)


def _worth_finishing(fits: Sequence[Fitted], base: float, entries: int) -> int:
    """How many of the fits, the best first, are polished."""
    best = base - fits[0].cost
    near = sum(base - fit.cost > NEARLY * best for fit in fits) if best > needed_gain(1, 1, fits[0].cost, entries) else 0
    return min(max(near, POLISHED), 2 * POLISHED)


def _finished(runs: FreeRuns, tuning: Tuning, measured: np.ndarray, fits: Sequence[Fitted], unfinished: int) -> list[Fitted]:
    """The fits with the first of them polished."""
    done, began = list(fits), runs.count
    for number, fit in enumerate(fits[:unfinished]):
        if number >= POLISHED and runs.count - began > FINISHING_RUNS:
            break
        done[number] = polish(runs, tuning, measured, fit)
    return done


def _pairs_worth_a_fit(
    tuning: Tuning,
    residual: np.ndarray,
    singles: Sequence[Fitted],
    screened: Sequence[Screened],
    base: float,
    noise_energy: float,
    tried: Sequence[Candidate],
) -> list[Start]:
    """Starts of the pairs whose filter says that they may be likelier than the best single effect, and more than chance."""
    found = pairs(tuning, residual, singles, screened)
    if not found:
        return []
    best = singles[0]
    temper = temperature(base - min(best.cost, base - found[0].gain), min(best.cost, base - found[0].gain) - noise_energy)
    price = price_of_a_parameter(base - best.cost, temper)
    least = 0.5 * (base - best.cost) / temper - _price(best, temper) - PAIR_MARGIN
    worth = [
        pair
        for pair in found
        if 0.5 * pair.gain / temper - pair.freedom * price > least
        and best.effects[0] not in pair.start[0]  # what is to be added to it is looked for beside it
        and pair.added > needed_gain(len(tried), 1, base - pair.gain, len(residual))
    ]
    worth.sort(key=lambda pair: pair.freedom * price - 0.5 * pair.gain / temper)
    return [pair.start for pair in worth[:PAIRED]]


def _needs_both(pair: Fitted, singles: Sequence[Fitted], tried: Sequence[Candidate], entries: int) -> bool:
    """Whether a pair gains more over each of its own effects alone than chance does."""
    for single in singles:
        if single.effects[0] in pair.effects:
            trials = _trials([effect for effect in pair.effects if effect not in single.effects], tried)
            if single.cost - pair.cost < needed_gain(trials, pair.freedom - single.freedom, pair.cost, entries):
                return False
    return True


def _still_in(earlier: Sequence[Contender], larger: Sequence[Contender]) -> list[Contender]:
    """Sets of a step before that compete with the larger sets of this one: they gain as much, and are no part of one."""
    if not larger:
        return []
    most = max(rival.gained for rival in larger)
    return [
        one
        for one in earlier
        if one.gained > RIVAL_SHARE * most and not any(set(one.fitted.effects) < set(other.fitted.effects) for other in larger)
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


def _added(before: Fitted | None, after: Fitted) -> tuple[EffectAt, ...]:
    return after.effects if before is None else tuple(effect for effect in after.effects if effect not in before.effects)


def in_order(fits: Sequence[Fitted], base: float, noise_energy: float) -> list[Fitted]:
    """Fitted sets by their evidence on the training recordings, see naming.py."""
    best = min(fit.cost for fit in fits)
    temper = temperature(base - best, best - noise_energy)
    return sorted(fits, key=lambda fit: 0.5 * fit.cost / temper + _price(fit, temper))


def _price(fitted: Fitted, temper: float) -> float:
    return Weighed(fitted, 0.0, 0.0, tuple(fitted.information.tolist())).price(temper)


def _searched(added: Sequence[EffectAt], tried: Sequence[Candidate]) -> float:
    """Logarithm of the number of shapes that were searched for these effects together."""
    shapes = {candidate.effect: candidate.shapes for candidate in tried}
    return sum(math.log(shapes[effect]) for effect in added)


def _trials(added: Sequence[EffectAt], tried: Sequence[Candidate]) -> float:
    """Sets of so many effects among those that were tried, each in all its shapes."""
    return len(tried) ** len(added) / math.factorial(len(added)) * math.exp(_searched(added, tried))


def _gate(
    scatter: Scatter,
    present: Tuning,
    held_out: HeldOut | None,
    before: Fitted | None,
    after: Fitted,
    placebo: float,
    residual: np.ndarray,
    explainable: float,
    noise_energy: float,
    tried: Sequence[Candidate],
) -> Gate:
    added = _added(before, after)
    gain = float(residual @ residual + present.offset @ present.offset) - after.cost
    projection = Projection.of(present)
    deviations = fall = None
    if held_out is not None:
        settings = before.settings if before is not None else ()
        predicted = held_out.predictions([(present.offset, settings), (after.offset, after.settings)])
        deviations = held_out.deviations(*predicted)
        fall = held_out.misfit(predicted[0]) - held_out.misfit(predicted[1])
    return Gate(
        gain=gain,
        needed=needed_gain(_trials(added, tried), after.freedom - (before.freedom if before is not None else 0), after.cost, len(residual)),
        scatter=scatter.along(projection.left(after.predicted - present.predicted)[: len(residual)]),
        held_out_deviations=deviations,
        held_out_gain=fall,
        placebo_gain=placebo,
        share=gain / max(explainable, gain, 1e-9),
        share_of_left=gain / max(float(residual @ residual) - noise_energy - certain_excess(noise_energy), gain, 1e-9),
        is_first=before is None,
    )
