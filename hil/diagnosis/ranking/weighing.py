"""What is weighed for the name: the sets that a search has come to, on training and on held-out recordings."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from hil.diagnosis.fitting.refit import Fitted
from hil.diagnosis.judging.errors_of_laws import are_of_the_file, numbers_of, share_of_numbers, whole_signs_of
from hil.diagnosis.judging.gate import Gate, Scatter, needed_gain
from hil.diagnosis.judging.held_out import HeldOut
from hil.diagnosis.judging.judgement import Contender, Stand, are_added_to_the_same, steps_of
from hil.diagnosis.ranking.compared import Compared
from hil.diagnosis.ranking.naming import CAP_ASSUMED, Evidence, Weighed, not_told_apart
from hil.diagnosis.ranking.rarity import rarity_of
from hil.diagnosis.result import EffectAt
from hil.diagnosis.tuning.free_run import FreeRuns
from hil.diagnosis.tuning.projection import Projection
from hil.diagnosis.tuning.retune import Tuning

LARGEST_TIE = 0.999
"""No hypothesis is more certain than this: what is in no catalogue always has a share."""


def evidence_of(
    runs: FreeRuns,
    tuning: Tuning,
    judged: HeldOut | None,
    contenders: Sequence[Contender],
    formless: Sequence[Contender] = (),
    *,
    tried: int,
    found: bool,
) -> Evidence:
    """Every set that competes, beside no effect at all.

    Parameters
    ----------
    runs : FreeRuns
    tuning : Tuning
        Without effects.
    judged : HeldOut or None
    contenders, formless : sequence of Contender
        See `selection.Selection`.
    tried : int
        Candidates that were screened.
    found : bool
        Whether a set passed the gate.
    """
    train = min(((c.fitted if c.moved is None else c.moved).cost for c in contenders), default=0.0) + max(
        (c.gained for c in contenders), default=0.0
    )
    held_out = min((c.left_held_out for c in contenders), default=0.0) + max((c.gained_held_out for c in contenders), default=0.0)

    best = max(contenders, key=lambda c: c.gained + c.gained_held_out, default=None)
    scatter, projection = Scatter(runs), Projection.of(tuning)

    def compared(c: Contender) -> Compared | None:
        if best is None or c is best or len(c.fitted.effects) != len(best.fitted.effects):
            return None
        difference = projection.left(c.fitted.predicted - best.fitted.predicted)[: len(tuning.predicted)]
        if not are_added_to_the_same(c, best):  # what each of their steps is charged for depends on which effect was added first
            apart = _less(best.uncharged_at_all, c.uncharged_at_all)
            reference = train - best.gained, held_out - best.gained_held_out
            return Compared(reference, apart, apart, _less(best.by_moving, c.by_moving), scatter.along(difference))
        return Compared(
            (train - best.gained, held_out - best.gained_held_out),
            _less(best.uncharged, c.uncharged),
            _less(best.beyond_errors, c.beyond_errors),
            _less(best.by_moving, c.by_moving),
            scatter.along(difference),
            c.known,
        )

    alone: dict[frozenset[EffectAt], Gate] = {}  # steps of numbers alone that passed, of each the one that gains least
    for c in contenders:
        for effects, gate in steps_of(c.fitted.effects, c.gates, numbers_of(c.fitted)).items():
            if gate.passed:
                alone[effects] = min(alone.get(effects, gate), gate, key=lambda step: step.gain)

    def with_shared(c: Contender, own: tuple[float, float], known: frozenset[EffectAt]) -> tuple[float, float]:
        """With what known effects that came in one step with others remove by themselves in another set, as far as that step gains it."""
        shared = known - frozenset[EffectAt]().union(*steps_of(c.fitted.effects, c.gates, known))
        by_itself = alone.get(shared)
        if by_itself is None:
            return own
        steps = {id(gate): gate for effect, gate in zip(c.fitted.effects, c.gates, strict=True) if effect in shared}.values()
        here, there = sum(gate.gain for gate in steps), sum(gate.held_out_gain or 0.0 for gate in steps)
        share = share_of_numbers(shared)
        return own[0] + share * _within(by_itself.gain, here), own[1] + share * _within(by_itself.held_out_gain or 0.0, there)

    def weighing(c: Contender) -> Weighed:
        return Weighed(
            None,
            train - c.gained,
            held_out - c.gained_held_out,
            searched=c.searched,
            passed=c.passed,
            by_numbers=with_shared(c, c.by_numbers, numbers_of(c.fitted)),
            by_signs=with_shared(c, c.by_signs, whole_signs_of(c.fitted)),
            of_the_file=are_of_the_file(c.fitted),
            rarity=rarity_of(c.fitted.effects, runs.machine.plant),
            narrowed=c.narrowed,
            compared=compared(c),
        ).priced_as(c.fitted)

    return Evidence(
        sets=tuple(weighing(c) for c in contenders),
        base=Weighed(None, train, held_out),
        entries_train=float(len(tuning.predicted)),
        entries_held_out=0.0 if judged is None else float(len(judged.measured)),
        tried=tried,
        found=found,
        cap=cap_of(runs),
        formless=tuple(weighing(c) for c in formless),
        is_noise_known=runs.noise.kind != "assumed",
    )


def _less(one: tuple[float, float], other: tuple[float, float]) -> tuple[float, float]:
    return one[0] - other[0], one[1] - other[1]


def _within(energy: float, most: float) -> float:
    return min(max(energy, 0.0), max(most, 0.0))


def cap_of(runs: FreeRuns) -> float:
    """Largest share of what has a name."""
    return CAP_ASSUMED if runs.noise.kind == "assumed" else LARGEST_TIE


def plausible_among(unsure: Sequence[Contender], hypotheses: Sequence[Weighed]) -> tuple[Weighed, ...]:
    """Those of the sets whose last effect is not there for certain that are not told apart from the likeliest of all, weighed with them.

    The gate asks whether an effect is there for certain, a list of what may be there asks whether it is plausible.
    """
    doubted = {id(one.fitted) for one in unsure}
    return tuple(h for h in not_told_apart(hypotheses) if id(h.fitted) in doubted)


def with_unsure(hypotheses: Sequence[Weighed], unsure: Sequence[Weighed], whole: float) -> tuple[Weighed, ...]:
    """Hypotheses in their order, with sets whose last effect is not there for certain among them, never before the first.

    Parameters
    ----------
    hypotheses, unsure : sequence of Weighed
        The latter with the confidences that they have when they are weighed with all others.
    whole : float
        Confidence that all names have together; the unsure ones share what the others leave of it.
    """
    if not hypotheses or not unsure:
        return tuple(hypotheses)
    first, *others = hypotheses
    most = min(first.confidence, max(whole - sum(h.confidence for h in hypotheses), 0.0) / len(unsure))
    others += [replace(h, confidence=min(h.confidence, most)) for h in unsure]
    return first, *sorted(others, key=lambda h: -h.confidence)


def closer_than(
    stand: Stand, contenders: Sequence[Contender], entries: tuple[int, int], likeliest_of: Callable[[Sequence[Contender]], Fitted | None]
) -> Contender | None:
    """The likeliest set where it passed the gate, is not the one that a search ended with and leaves less than that by more than chance,
    in training or in both motions together.

    Where both leave as much, what is missing is the same beside both. Each motion counts in units of the level that the set leaves there,
    as at the gate: no noise model knows the held-out motion's disturbances.

    Parameters
    ----------
    stand : Stand
    contenders : sequence of Contender
    entries : pair of int
        Of training and held-out recordings.
    likeliest_of : callable
    """
    if stand.fitted is None:
        return None
    freedom = stand.fitted.freedom

    def leaves_less(one: Contender) -> bool:
        in_training = stand.cost - one.fitted.cost
        here, there = (max(1.0, left / max(count, 1)) for left, count in zip((one.fitted.cost, one.left_held_out), entries, strict=True))
        held_out = 0.0 if stand.held_out is None else (stand.held_out.misfit - one.left_held_out) * here / there
        needed = needed_gain(1.0, max(one.fitted.freedom - freedom, 1), one.fitted.cost, entries[0])
        return max(in_training, in_training + held_out) > needed

    others = [one for one in contenders if set(one.fitted.effects) != set(stand.effects) and one.passed and leaves_less(one)]
    likeliest = likeliest_of(contenders) if others else None
    return next((one for one in others if one.fitted is likeliest), None)


def without_form(judged: Sequence[Contender]) -> list[Contender]:
    """Those that would have passed but for their form."""
    return [one for one in judged if one.gate.lost_form and one.gate.something_is_there]


def least_by_chance(judged: Sequence[Contender], stand: Stand) -> float:
    """Of sets that add an effect to those that were found: the least expected number that gain as much in training by chance."""
    beside = [one.gate.trained for one in judged if stand.effects and set(stand.effects) < set(one.fitted.effects)]
    return min(beside, default=np.inf)
