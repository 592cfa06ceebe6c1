"""Which fits are continued to their end, and the closest fit of every set."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hil.diagnosis.fitting.refit import NEARLY, POLISHED_GAIN, POLISHING_ROUNDS, Fitted, polish
from hil.diagnosis.judging.gate import needed_gain
from hil.diagnosis.tuning.free_run import FreeRuns
from hil.diagnosis.tuning.retune import Tuning

POLISHED = 3
"""Fits that are continued with sensitivities taken where they are, and as many again of those that gain nearly as much (NEARLY): an
unfinished fit of a law that holds another is no evidence against it."""

FINISHING_RUNS = 450
"""Free runs of polishing after which no more than POLISHED go on: a machine of 49 numbers takes 60 to 150 for each that is near its end,
600 for one that is far from it."""


def closest_of_each(fits: Sequence[Fitted], more: Sequence[Fitted]) -> list[Fitted]:
    """The fits and these, of which each is of another set or closer than what was fitted of its set, which it replaces."""
    kept = list(fits)
    for one in more:
        same = [fit for fit in kept if set(fit.effects) == set(one.effects)]
        if all(one.cost < fit.cost for fit in same):
            kept = [*(fit for fit in kept if all(fit is not other for other in same)), one]
    return kept


def worth_finishing(fits: Sequence[Fitted], before: float, entries: int) -> int:
    """How many of the fits, the best first, are polished; `before` is the cost without what they add."""
    best = before - fits[0].cost
    near = sum(before - fit.cost > NEARLY * best for fit in fits) if best > needed_gain(1, 1, fits[0].cost, entries) else 0
    return min(max(near, POLISHED), 2 * POLISHED)


def finished(runs: FreeRuns, tuning: Tuning, measured: np.ndarray, fits: Sequence[Fitted], unfinished: int) -> list[Fitted]:
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


def rarer_by_chance(fits: Sequence[Fitted], finished: int, by_chance: Sequence[float]) -> list[Fitted]:
    """Unfinished fits that chance gains less often than any finished one, the rarest first: a wave in all its shapes gains by chance what
    a law of one or two numbers does not.
    """
    least = min(by_chance[:finished])
    rarer = sorted((k for k in range(finished, len(fits)) if by_chance[k] < least), key=lambda k: by_chance[k])
    return [fits[k] for k in rarer[:POLISHED]]
