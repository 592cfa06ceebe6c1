"""Sets without those of their effects that were fitted to nothing: what stands beside an effect of no strength is the smaller set."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from hil.diagnosis.fitting.information import is_in_proportion
from hil.diagnosis.fitting.refit import Fitted, polish
from hil.diagnosis.result import EffectAt
from hil.diagnosis.tuning.free_run import FreeRuns
from hil.diagnosis.tuning.retune import Tuning
from virtual_bus.effects.registry import effects


def with_what_acts(
    runs: FreeRuns,
    tuning: Tuning,
    measured: np.ndarray,
    fits: Sequence[Fitted],
    stand: Sequence[EffectAt],
    may_stand: Callable[[Fitted], bool],
) -> list[Fitted]:
    """The fits, each larger set of which an effect has no strength without that effect and fitted on.

    Where effects are added one at a time, what stood for another is left over beside it. Only a smaller set pays for no more than it has.

    Parameters
    ----------
    runs : FreeRuns
    tuning : Tuning
        Without effects.
    measured : (M,) array
    fits : sequence of Fitted
    stand : sequence of EffectAt
        The effects that the fits add to; a fit that adds nothing to them, or to a part of them, stays as it is.
    may_stand : callable
        Whether a smaller set, once it is fitted, may take a fit's place.
    """
    found: list[Fitted] = []
    there = {frozenset(fit.effects) for fit in fits}
    for fit in fits:
        kept = [k for k, (effect, values) in enumerate(zip(fit.effects, fit.values, strict=True)) if acts(effect, values)]
        smaller = tuple(fit.effects[k] for k in kept)
        if len(kept) == len(fit.effects) or set(smaller) <= set(stand) or frozenset(smaller) in there:
            found.append(fit)
            continue
        there.add(frozenset(smaller))
        begun = replace(fit, effects=smaller, values=tuple(fit.values[k] for k in kept), cost=np.inf)  # any end is better
        (done,) = polish(runs, tuning, measured, [begun])
        found.append(done if done is not begun and may_stand(done) else fit)
    return found


def acts(effect: EffectAt, values: np.ndarray) -> bool:
    """Whether an effect does anything: not where all its strengths are none."""
    parameters = effects()[effect.effect].parameters
    strengths = [value for parameter, value in zip(parameters, values, strict=True) if is_in_proportion(parameter)]
    limits = any(parameter.is_strength and not is_in_proportion(parameter) for parameter in parameters)
    return limits or not strengths or bool(np.any(strengths))
