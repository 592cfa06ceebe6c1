"""Values with 95 % intervals, of effects' parameters and of re-tuned numbers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import scipy.optimize
import scipy.stats

from hil.diagnosis.answering.spread import TWO_SIDED_95, spread_of
from hil.diagnosis.fitting.coordinates import difference, is_phase
from hil.diagnosis.fitting.refit import Fitted
from hil.diagnosis.ranking.naming import Weighed, not_told_apart
from hil.diagnosis.result import Estimate, RetunedValue, Span
from hil.diagnosis.tuning.free_run import FreeRuns
from hil.diagnosis.tuning.retune import UNDECIDED, Tuning, tunable
from virtual_bus.effects.effect import DRIVE_UNIT
from virtual_bus.effects.places import drive_unit, is_prismatic
from virtual_bus.effects.registry import effects
from virtual_bus.settings import PlantSettings

FARTHEST = 40.0
"""Standard deviations of the widest part within which a mixture's 95 % are looked for."""


@dataclass(frozen=True, eq=False)
class Believed:
    """A fitted set, how likely it is, and how far its free parameters may be off."""

    fitted: Fitted
    confidence: float
    spread: np.ndarray  # (F,)

    def parameter(self, likeliest: Fitted, at: int, number: int) -> tuple[float, float, float] | None:
        """Confidence, value and spread of a parameter of the likeliest set's effect `at`; None where this set is without the effect.

        Of several at one place, numbered as they were found, that one of this set is meant which is nearest to it, and it to that one.
        """
        own = _nearest(self.fitted, likeliest, at)
        if own is None or _nearest(likeliest, self.fitted, own) != at:
            return None
        spread = dict(zip(self.fitted.free, self.spread, strict=True)).get((own, number), 0.0)
        return self.confidence, float(self.fitted.values[own][number]), float(spread)


def believed(runs: FreeRuns, tuning: Tuning, hypotheses: Sequence[Weighed], spread: np.ndarray) -> list[Believed]:
    """The likeliest set, the spread of whose coordinates is known, and those not told apart from it that share an effect with it."""
    first, count = hypotheses[0], len(tuning.offset)
    assert first.fitted is not None
    found = [Believed(first.fitted, first.confidence, spread[count:])]
    for other in not_told_apart(hypotheses)[1:]:
        if other.fitted is not None and set(other.fitted.effects) & set(first.fitted.effects):
            found.append(Believed(other.fitted, other.confidence, spread_of(runs, tuning, other.fitted)[count:]))
    return found


def effect_estimates(settings: PlantSettings, sets: Sequence[Believed]) -> list[Mapping[str, Estimate]]:
    """Parameters of every effect of the likeliest set, the first: its values, in intervals that hold 95 % of what all sets that have the
    effect say together.
    """
    found: list[Mapping[str, Estimate]] = []
    likeliest = sets[0].fitted
    for at, (effect, values) in enumerate(zip(likeliest.effects, likeliest.values, strict=True)):
        table = {}
        for k, (parameter, value) in enumerate(zip(effects()[effect.effect].parameters, values, strict=True)):
            parts = [part for part in (one.parameter(likeliest, at, k) for one in sets) if part is not None]
            if is_phase(parameter):
                parts = [(share, float(value) + difference(parameter, other, float(value)), spread) for share, other, spread in parts]
            low, high = interval(parts)
            low, high = max(min(low, float(value)), parameter.low), min(max(high, float(value)), parameter.high)
            unit = parameter.unit_at(is_prismatic(effect.at, settings), drive_unit(effect.at, settings) or DRIVE_UNIT)
            table[parameter.name] = Estimate(float(value), unit, (low, high))
        found.append(table)
    return found


def _nearest(fitted: Fitted, other: Fitted, at: int) -> int | None:
    """Which of a set's effects is another set's effect `at`: of several at its place the one that differs least; None where it has none."""
    effect = other.effects[at]
    same = [k for k, own in enumerate(fitted.effects) if (own.effect, own.at) == (effect.effect, effect.at)]
    names = [parameter.name for parameter in effects()[effect.effect].parameters]
    if not same or effects()[effect.effect].several not in names:
        return same[0] if same else None
    apart = names.index(effects()[effect.effect].several)
    return min(same, key=lambda k: abs(float(fitted.values[k][apart] - other.values[at][apart])))


def interval(parts: Sequence[tuple[float, float, float]]) -> Span:
    """The central 95 % of normal distributions, each with its weight, mean and standard deviation."""
    weights, means, spreads = (np.array(each) for each in zip(*parts, strict=True))
    widest = float(spreads.max())
    if widest == 0.0:
        return float(means.min()), float(means.max())
    weights = weights / weights.sum() if weights.sum() > 0.0 else np.full(len(weights), 1.0 / len(weights))
    spreads = np.maximum(spreads, 1e-9 * widest)
    around = float(means.min()) - FARTHEST * widest, float(means.max()) + FARTHEST * widest

    def below(x: float) -> float:
        return float(weights @ scipy.stats.norm.cdf(x, means, spreads))

    low, high = (scipy.optimize.brentq(lambda x, share=share: below(x) - share, *around, xtol=1e-9 * widest) for share in (0.025, 0.975))
    return float(low), float(high)


def retuned_values(tuning: Tuning, fitted: Fitted | None, spread: np.ndarray) -> tuple[dict[str, RetunedValue], dict[str, str]]:
    """Re-tuned numbers that the recordings show; and those that they do not show, which stay, or do not decide, with the reason."""
    offset = tuning.offset if fitted is None else fitted.offset
    count = len(offset)  # effects beside a number never narrow it
    spread = np.maximum(spread[:count], np.sqrt(np.diag(tuning.covariance)))
    values = tuning.at(offset)
    shown, frozen = {}, {}
    tuned = {int(index): k for k, index in enumerate(tuning.indices)}
    for index in tunable(tuning.parameters):
        parameter, value = tuning.parameters[index], float(values[index])
        name = f"{parameter.owner}.{parameter.quantity}"
        if index not in tuned:
            frozen[name] = f"these recordings do not show it; it stays at {value:.5g} {parameter.unit}".rstrip()
            continue
        k = tuned[int(index)]
        if spread[k] > UNDECIDED:
            narrowed = f"these recordings narrow it to {spread[k]:.0%} of what was assumed before, others do the same to them"
            frozen[name] = f"{narrowed}; machine.toml has {value:.5g} {parameter.unit}".rstrip() + ", beside which the rest was fitted"
            continue
        reach = TWO_SIDED_95 * spread[k] * tuning.scale[k]
        shown[name] = RetunedValue(parameter.value, value, parameter.unit, (float(value - reach), float(value + reach)))
    return shown, frozen
