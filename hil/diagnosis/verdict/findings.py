"""Findings and hypotheses: the effects of an answer, and what might act in their place."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from hil.diagnosis.model_choice.alternatives import Alternative
from hil.diagnosis.model_choice.search import NOT_TOLD_APART
from hil.diagnosis.result import EffectAt, Finding, Hypothesis, ParameterEstimate
from hil.diagnosis.verdict.values import acting
from virtual_bus.effects.registry import effects
from virtual_bus.settings import EffectSetting

Names = frozenset[tuple[str, str]]
MOST_HYPOTHESES = 12


def words(settings: Sequence[EffectSetting]) -> str:
    """Return effects with their places."""
    return " and ".join(f"{setting.name} at {setting.at}" for setting in settings) or "no effect"


def is_variant(settings: Sequence[EffectSetting], other: Alternative) -> bool:
    """Whether an alternative has another law of the same family at the same place."""
    own, its = settings[other.without[0]], other.settings[-1]
    is_one = len(other.without) == 1 and len(other.settings) == len(settings)
    return is_one and own.at == its.at and effects()[own.name].family == effects()[its.name].family


def rivals_of(settings: Sequence[EffectSetting], others: Sequence[Alternative], given_up: Names = frozenset()) -> list[Alternative]:
    """Return the alternatives with another effect that are not told apart from an answer.

    Variants of its laws are none where they are not likelier, but for those of the set that was `given_up` for it.
    """
    near = [other for other in others if other.has_another and other.told_apart < NOT_TOLD_APART]
    own = [other for other in near if {(one.name, one.at) for one in other.settings} == given_up]
    return [other for other in near if other.told_apart < 0.0 or other in own or not is_variant(settings, other)]


def weights(others: Sequence[Alternative]) -> tuple[float, list[float]]:
    """Return the shares of the answer and of each alternative: their evidences, which sum to one."""
    least = min([0.0, *(other.told_apart for other in others)])
    own = math.exp(0.5 * least)
    each = [math.exp(-0.5 * min(other.told_apart - least, 1400.0)) for other in others]
    total = own + sum(each)
    return own / total, [one / total for one in each]


def told(
    settings: Sequence[EffectSetting],
    others: Sequence[Alternative],
    rivals: Sequence[Alternative],
    estimates: Sequence[Mapping[str, ParameterEstimate]],
) -> tuple[Finding, ...]:
    """Return the effects of an answer as findings, each with its share of the evidence and what might act in its place."""
    found = []
    for number, (setting, table) in enumerate(zip(settings, estimates, strict=True)):
        if setting not in acting(settings):
            continue
        mine = [other for other in others if number in other.without]
        own, shares = weights(mine)
        at, family = EffectAt(setting.name, setting.at), effects()[setting.name].family
        variants = [(at, own)]
        against, missing = [other for other in mine if other in rivals], 0.0
        for other, share in zip(mine, shares, strict=True):
            if other.has_another and other not in rivals and is_variant(settings, other):
                variants.append((EffectAt(other.settings[-1].name, other.settings[-1].at), share))
            elif not other.has_another:
                missing = other.behind
        confidence = sum(share for _, share in variants)
        found.append(
            Finding(
                at,
                confidence=min(confidence, 1.0),
                parameters=table,
                ambiguous_with=tuple(EffectAt(other.settings[-1].name, other.settings[-1].at) for other in against),
                ambiguous_sets=tuple(tuple(EffectAt(one.name, one.at) for one in other.settings) for other in against),
                evidence_for=(f"without it, twice the log of the evidence falls by {missing:.4g}",),
                evidence_against=tuple(f"{words(other.settings)} is {_behind(other.told_apart)}" for other in against),
                family=family,
                variants=tuple(sorted(variants, key=lambda pair: -pair[1])),
            )
        )
    return tuple(found)


def _behind(units: float) -> str:
    return "as likely" if abs(units) < 1.0 else f"{abs(units):.3g} such units {'behind' if units > 0.0 else 'likelier'}"


def hypotheses_of(
    settings: Sequence[EffectSetting],
    parameters: int,
    gained: tuple[float, float | None],
    others: Sequence[Alternative],
    shown: tuple[EffectAt, ...],
) -> tuple[Hypothesis, ...]:  # fmt: skip
    """Return the sets of effects that were weighed, the surest first; the answer gained so much in training, and held out."""
    own, shares = weights(others)
    named = tuple(EffectAt(one.name, one.at) for one in acting(settings))
    sets = [Hypothesis((*named, *shown), own, *gained, parameters, True)]
    for other, share in list(zip(others, shares, strict=True))[:MOST_HYPOTHESES]:
        what = tuple(EffectAt(one.name, one.at) for one in other.settings)
        sets.append(Hypothesis((*what, *shown), share, other.gained, None, other.parameters, False))
    return tuple(sorted(sets, key=lambda each: -each.confidence))
