"""Which two effects together a fit is worth, without a free run: a matched filter for two responses at once.

For responses a and b with re-tuning projected out and the residual r, the energy that both together take from it is v' G^-1 v with
v = (a'r, b'r) and G their Gram matrix (Kay 1998, ch. 4): two effects of which neither alone comes near the recordings show in it.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np

from hil.diagnosis.fitting.coordinates import fitted_parameters
from hil.diagnosis.fitting.refit import Fitted
from hil.diagnosis.fitting.screening import Screened, scaled
from hil.diagnosis.result import EffectAt
from hil.diagnosis.tuning.projection import Projection
from hil.diagnosis.tuning.retune import Tuning

PARTNERS = 30
"""Candidates, the best of the screening, that may stand beside one that was fitted."""

ALIKE = 0.98
"""Squared cosine of two responses above which they are one."""

MOST_RIVALS = 2
"""Sets that get what was found beside another one: each costs a fit and its polishing."""

Start = tuple[tuple[EffectAt, ...], tuple[np.ndarray, ...]]


@dataclass(frozen=True, eq=False)
class Pair:
    """Two effects with the parameters a fit may start from."""

    start: Start
    gain: float  # energy that their responses together take from the residual
    added: float  # of it, what the lesser of the two adds to the other
    freedom: int


@dataclass(frozen=True, eq=False)
class _One:
    effect: EffectAt
    values: np.ndarray
    response: np.ndarray
    freedom: int


def pairs(tuning: Tuning, residual: np.ndarray, singles: Sequence[Fitted], screened: Sequence[Screened]) -> list[Pair]:
    """Every pair of a fitted single effect with another or with one of the best screened, the largest gain first.

    Parameters
    ----------
    tuning : Tuning
        Without effects.
    residual : (M,) array
        At the tuning.
    singles : sequence of Fitted
    screened : sequence of Screened
        In their order.
    """
    projection = Projection.of(tuning)
    left = projection.left_of_residual(residual)
    bank = [_One(fit.effects[0], fit.values[0], projection.left(fit.predicted - tuning.predicted), fit.freedom) for fit in singles]
    known = {one.effect for one in bank}
    others = [s for s in screened if s.effect not in known][:PARTNERS]
    bank += [_One(s.effect, s.values, s.response.astype(float), fitted_parameters(s.effect)) for s in others]
    bank = [one for one in bank if one.response @ one.response > 0.0]
    responses = np.stack([one.response for one in bank]) if bank else np.zeros((0, len(left)))
    gram, along = responses @ responses.T, responses @ left
    found = []
    for i in range(min(len(singles), len(bank))):
        for j in range(i + 1, len(bank)):
            two = np.ix_((i, j), (i, j))
            if gram[i, j] ** 2 > ALIKE * gram[i, i] * gram[j, j]:
                continue
            strengths = np.linalg.solve(gram[two], along[[i, j]])
            starts = [scaled(one.effect, one.values, float(strength)) for one, strength in zip((bank[i], bank[j]), strengths, strict=True)]
            if starts[0] is None or starts[1] is None:
                continue
            start = (bank[i].effect, bank[j].effect), (starts[0], starts[1])
            gain = float(along[[i, j]] @ strengths)
            added = gain - max(float(along[k] ** 2 / gram[k, k]) for k in (i, j))
            found.append(Pair(start, gain, added, bank[i].freedom + bank[j].freedom))
    return sorted(found, key=lambda pair: -pair.gain)


def beside_rivals(rivals: Sequence[Fitted], stand: Fitted | None, found: Fitted, there: Sequence[set[EffectAt]] = ()) -> list[Start]:
    """Starts of sets that compete with the stand, each with what was found beside it: without it they stand for less than the larger set.

    Parameters
    ----------
    rivals : sequence of Fitted
        In the order in which they competed, the likeliest of the first step first, the stand among them.
    stand : Fitted or None
    found : Fitted
        The stand with what was added.
    there : sequence of set
        Sets that compete already.
    """
    if stand is None or not set(stand.effects) < set(found.effects):
        return []
    new = [k for k, effect in enumerate(found.effects) if effect not in stand.effects]
    added, values = tuple(found.effects[k] for k in new), tuple(found.values[k] for k in new)
    left_out = [set(stand.effects), *(each - set(added) for each in there if set(added) <= each)]
    others = [
        one
        for one in rivals
        if set(one.effects) not in left_out and not set(added) & set(one.effects) and len(one.effects) <= len(stand.effects)
    ]
    return [((*one.effects, *added), (*one.values, *values)) for one in others[:MOST_RIVALS]]


def beside(chosen: Fitted | None, added: Screened) -> Start:
    """An effect more than those that were chosen."""
    if chosen is None:
        return (added.effect,), (added.values,)
    return (*chosen.effects, added.effect), (*chosen.values, added.values)


def instead(chosen: Fitted | None, added: Screened) -> list[Start]:
    """The most promising effect in place of each of a pair: one of two that were found together may have stood for it."""
    if chosen is None or len(chosen.effects) < 2:
        return []
    kept = [[k for k in range(len(chosen.effects)) if k != left_out] for left_out in range(len(chosen.effects))]
    return [((*(chosen.effects[k] for k in ks), added.effect), (*(chosen.values[k] for k in ks), added.values)) for ks in kept]


def without_what_stood(chosen: Fitted | None, larger: Fitted) -> list[Start]:
    """A set with one effect more, without one of those it was added to: alone, a fit may not have come to where it is beside the one that
    had stood for it.
    """
    if chosen is None or not set(chosen.effects) < set(larger.effects):
        return []
    return [_without(larger, left_out) for left_out in chosen.effects]


def without_one(pair: Fitted) -> list[Start]:
    """Every set that lacks one of these effects, from where the others are beside it: alone their fits may have ended elsewhere."""
    return [_without(pair, left_out) for left_out in pair.effects] if len(pair.effects) > 1 else []


def only(larger: Fitted, kept: Collection[EffectAt]) -> Start:
    """A part of a set, from where it is in it."""
    each = [k for k, effect in enumerate(larger.effects) if effect in kept]
    return tuple(larger.effects[k] for k in each), tuple(larger.values[k] for k in each)


def _without(larger: Fitted, left_out: EffectAt) -> Start:
    return only(larger, [effect for effect in larger.effects if effect != left_out])
