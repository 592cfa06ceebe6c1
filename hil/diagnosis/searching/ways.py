"""Ways of a search: how far effects were added from one first effect or another, how two ways are put together, and what competes."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from hil.diagnosis.fitting.refit import Fitted
from hil.diagnosis.fitting.screening import UNLIKE, Screened, squared_cosine
from hil.diagnosis.judging.errors_of_laws import Removing, are_of_the_file, numbers_of, share_of_numbers, temperature_of, whole_signs_of
from hil.diagnosis.judging.gate import Gate
from hil.diagnosis.judging.judgement import Contender, Stand, are_added_to_the_same, steps_of
from hil.diagnosis.judging.placebos import NO_PLACEBOS, Placebos
from hil.diagnosis.judging.tried import Tried
from hil.diagnosis.ranking.naming import PLAUSIBLE, Weighed
from hil.diagnosis.result import EffectAt
from hil.diagnosis.tuning.projection import Projection

RIVAL_SHARE = 0.5
"""Of the chosen set's certain gain: sets that gain more compete with it for the name, whether or not they passed the gate. What is held out
counts for a rival as it counts in naming: a set that gains a little less than half in training, in units of its scatter, may gain more than
that held out."""

UNRELATED = 0.1
"""Share of a set's response, what re-tuning imitates taken out, below which another one explains nothing of it."""

SAME = 1e-6
"""Share of the largest singular value below which directions are none of their own."""


@dataclass(frozen=True, eq=False)
class Way:
    """How far effects were added, and what was fitted and judged on the way; see `Selection`."""

    stand: Stand
    gates: tuple[Gate, ...] = ()
    contenders: tuple[Contender, ...] = ()
    screened: tuple[Screened, ...] = ()
    closest: Fitted | None = None
    further: float = np.inf
    singles: tuple[Fitted, ...] = ()
    smaller: tuple[Fitted, ...] = ()  # of all steps
    limits: Mapping[EffectAt, tuple[float, float]] = field(default_factory=dict)
    tried: Tried | None = None
    is_at_its_end: bool = False
    formless: tuple[Contender, ...] = ()  # of all steps
    unsure: tuple[Contender, ...] = ()
    is_wider: bool = False  # whether candidates behind the best were fitted as well
    placebos: Placebos = NO_PLACEBOS  # of the first step


def joined(one: Way, other: Way, base: float, noise_energy: float) -> Way:
    """The likelier of two ways by training, with the sets of both; `base` is the cost of no effect at all."""
    ends = [next(c for c in way.contenders if c.fitted is way.stand.fitted) for way in (one, other)]
    temper = temperature_of([_removing(end, base) for end in ends], base, noise_energy)
    evidence = [0.5 * end.gained / temper - price_in_training(end.fitted, temper, end.searched) for end in ends]
    likelier, less = (one, other) if evidence[0] >= evidence[1] else (other, one)
    closest = min((way.closest for way in (one, other) if way.closest is not None), key=lambda fit: fit.cost)
    formless = (*one.formless, *(each for each in other.formless if each not in one.formless))
    return replace(
        likelier,
        contenders=tuple(each_once((*one.contenders, *other.contenders))),
        closest=closest,
        formless=formless,
        limits={**less.limits, **likelier.limits},
        tried=Tried((), less.tried, likelier.tried),  # either way may have tried what was a candidate beside its own sets only
    )


def from_another(way: Way, found: Contender, stand: Stand) -> Way:
    """A way that goes on from another of the sets that this one came to, at whichever step."""
    steps = tuple({id(gate): gate for gate in found.gates}.values())
    return replace(way, stand=stand, gates=steps, further=np.inf, is_at_its_end=False, unsure=())


def continued(way: Way, other: Way) -> Way:
    """The way that went on from the likeliest set of the one before, with the sets of both where it found more."""
    if all(one in way.contenders for one in other.contenders):
        return other
    closest = min((one.closest for one in (way, other) if one.closest is not None), key=lambda fit: fit.cost)
    return replace(other, contenders=tuple(each_once((*way.contenders, *other.contenders))), closest=closest)


def another_first(
    contenders: Sequence[Contender], found: Sequence[EffectAt], stand: Stand, nothing: Stand, noise_energy: float
) -> Contender | None:
    """A set of the first step from which effects should be added as well: one that an equation's error may hold beside the first stand and
    that does something else, where further effects were found beside that. None where there is none.
    """
    if stand.fitted is None or len(found) <= len(stand.effects):
        return None
    own = stand.fitted.predicted - nothing.tuning.predicted
    known = not_told_apart_in_training(contenders, contenders, nothing.cost, noise_energy)
    others = []
    for one in contenders:
        response = one.fitted.predicted - nothing.tuning.predicted
        is_another = not set(one.fitted.effects) <= set(found) and squared_cosine(own, response) < UNLIKE
        if one.fitted in known and is_another:
            others.append(one)
    return max(others, key=lambda one: one.gained, default=None)


def closer_parts(one: Contender, way: Way) -> list[Contender]:
    """Parts of a set that passed the gate and leave less than the stand that it was added to: beside each of these it must be there for
    certain as well, or its other effects are an error of that part's equation.
    """
    own, stand = set(one.fitted.effects), way.stand
    return [part for part in way.contenders if set(part.fitted.effects) < own and part.passed and part.fitted.cost < stand.cost]


def each_once(contenders: Sequence[Contender]) -> list[Contender]:
    """Of sets that were fitted twice the closer one, of those that passed the gate where one did; without those that gain too little to
    compete, or that are part of another. One that passed gives way to none that did not.
    """
    closest: dict[frozenset[EffectAt], Contender] = {}
    for one in contenders:
        known = closest.setdefault(frozenset(one.fitted.effects), one)
        if (not one.passed, one.fitted.cost) < (not known.passed, known.fitted.cost):
            closest[frozenset(one.fitted.effects)] = one
    sets = list(closest.values())
    there = [one for one in sets if one.passed]
    rivals = [one for one in sets if is_rival_of(one, there if one.passed else sets)]
    return [one for one in rivals if not any(is_replaced_by(one, other) for other in rivals)]


def is_replaced_by(one: Contender, other: Contender) -> bool:
    """Whether a set is part of a larger one that is there for certain, or as little as this one."""
    return set(one.fitted.effects) < set(other.fitted.effects) and (other.passed or not one.passed)


def with_others(contenders: Sequence[Contender], more: Sequence[Contender], stand: Fitted) -> list[Contender]:
    """Sets that compete, with more that do and leave more than the stand, which stays as it is: of a set that was fitted twice the closer
    fit.
    """
    kept = list(contenders)
    for one in more:
        own = set(one.fitted.effects)
        same = [other for other in kept if set(other.fitted.effects) == own]
        if own != set(stand.effects) and all(one.fitted.cost < other.fitted.cost for other in same):
            kept = [*(other for other in kept if other not in same), one]
    return kept


def is_rival_of(one: Contender, others: Sequence[Contender]) -> bool:
    """Whether a set gains enough beside the one of these that gains most, in training or in both motions together."""
    gains = [(each.gained, each.gained + max(each.gained_held_out, 0.0)) for each in (one, *others)]
    return any(gain > RIVAL_SHARE * max(of_all) for gain, of_all in zip(gains[0], zip(*gains, strict=True), strict=True))


def competes(one: Contender, chosen: Contender | None) -> bool:
    """Whether a set that did not pass gains enough beside the chosen one to compete with it, in training or in both motions together: over
    what both were added to, or over nothing where they were not added to the same and training shows what it was added for.
    """
    if one.gate.lost_form or one.gate.certain_gain <= 0.0:
        return False
    if chosen is None:
        return True
    if not are_added_to_the_same(one, chosen):
        return one.gate.shows and is_rival_of(one, [chosen])
    gains = [(gate.certain_gain, gate.certain_gain + max(gate.held_out_gain or 0.0, 0.0)) for gate in (one.gate, chosen.gate)]
    return any(gain > RIVAL_SHARE * most for gain, most in zip(*gains, strict=True))


def without_unrelated(rivals: Sequence[Contender], passed: Sequence[Contender], stand: Stand) -> list[Contender]:
    """Sets without those that did not pass, gain no more than those that passed and do nothing of what they do, all added to this stand:
    what passed is there whatever these gain, and they are asked for beside the best of it.

    What a set does is anything that its effects can at other values of their parameters, and what re-tuning can beside them.
    """
    own = set(stand.effects)

    def left(change: np.ndarray) -> np.ndarray:
        change = Projection.of(stand.tuning).left(change)
        sizes = np.linalg.norm(change, axis=-1, keepdims=True)
        return change / np.where(sizes > 0.0, sizes, 1.0)

    def are_added(sets: Sequence[Contender]) -> bool:
        return all(own <= set(each.fitted.effects) for each in sets)

    asked = [one for one in rivals if not one.passed and are_added([one]) and all(one.gained <= each.gained for each in passed)]
    if not asked or not are_added(passed):
        return list(rivals)
    wanted = left(np.stack([each.fitted.predicted - stand.tuning.predicted for each in passed]))

    def is_unrelated(one: Contender) -> bool:
        does = left(np.vstack([one.fitted.predicted - stand.tuning.predicted, one.fitted.jacobian.T]))
        _, sizes, basis = np.linalg.svd(does, full_matrices=False)
        return float(np.sum((wanted @ basis[sizes > SAME * sizes[0]].T) ** 2, axis=1).max()) < UNRELATED

    unrelated = [one for one in asked if is_unrelated(one)]
    return [one for one in rivals if one not in unrelated]


def not_told_apart_in_training(earlier: Sequence[Contender], larger: Sequence[Contender], base: float, noise_energy: float) -> list[Fitted]:
    """Sets of a step before that passed the gate and that an equation's error may hold beside the larger sets of this one, though they
    leave more; `base` is the cost of no effect at all.
    """
    sets = [_removing(one, base) for one in (*earlier, *larger)]
    much = -2.0 * math.log(PLAUSIBLE) * temperature_of(sets, base, noise_energy)
    most = max(one.gained for one in larger)
    return [one.fitted for one in earlier if one.passed and one.gained > most - much]


def _removing(one: Contender, base: float) -> Removing:
    """In training."""
    return Removing(base - one.gained, one.by_numbers[0], are_of_the_file(one.fitted), one.by_signs[0])


def price_in_training(fitted: Fitted, temper: float, searched: float) -> float:
    """Of a set's parameters and of what was searched for it, in log evidence, before held-out recordings are asked."""
    return Weighed(None, 0.0, 0.0, searched=searched).priced_as(fitted).price(temper)


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

    def removing(fit: Fitted) -> Removing:
        by_numbers = _by_numbers(fit, base, stand, numbers_of, share_of_numbers)
        return Removing(fit.cost, by_numbers, are_of_the_file(fit), _by_numbers(fit, base, stand, whole_signs_of, lambda _: 1.0))

    temper = temperature_of([removing(fit) for fit in fits], base, noise_energy)
    return sorted(fits, key=lambda fit: 0.5 * fit.cost / temper + price_in_training(fit, temper, tried.searched_for(fit)))


def _by_numbers(
    fit: Fitted,
    base: float,
    stand: Stand,
    numbers_in: Callable[[Fitted | None], frozenset[EffectAt]],
    share_of: Callable[[Collection[EffectAt]], float],
) -> float:
    """Energy that a set's numbers remove: those found before what they did, and what was added the rest, where that is numbers too."""
    effects, own = frozenset(fit.effects), numbers_in(fit)
    if not set(stand.effects) <= effects:
        return share_of(effects) * (base - fit.cost) if effects <= own else 0.0
    found = steps_of(stand.effects, stand.gates, numbers_in(stand.fitted))
    before = sum(share_of(step) * gate.gain for step, gate in found.items())
    return before + share_of(effects - set(stand.effects)) * (stand.cost - fit.cost) if effects <= own else before
