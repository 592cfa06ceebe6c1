"""A fit that stays far from the noise, with the machine's numbers re-tuned from nominal beside its effects.

What is missing bends the numbers that are re-tuned without it. Beside a current that had lost its sign 40 of the C-arm's 49 ended at their
bounds, and fits went on from there, or took a dozen steps from nominal with what sensitivities the ruined current had shown: they ended at
ten times the noise, of which a compliance that nobody hid then explained nine tenths (sealed 800, spent).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hil.diagnosis.free_run import FreeRuns, Trial
from hil.diagnosis.refit import MANY, NEAR, POLISHED_GAIN, Fitted, polish
from hil.diagnosis.retune import Tuning, descend, linearised


def with_numbers_from_nominal(runs: FreeRuns, tuning: Tuning, measured: np.ndarray, fits: Sequence[Fitted]) -> list[Fitted]:
    """The fits; where the best one is far from the noise, re-tuned beside its effects as they are and fitted on from there, if that brings
    it closer. Machines of few numbers need it not: their fits from nominal take every sensitivity where they are.
    """
    best, *others = sorted(fits, key=lambda fit: fit.cost)
    if len(tuning.offset) <= MANY or best.cost <= NEAR * len(measured):
        return list(fits)
    nominal = np.zeros_like(tuning.offset)
    predicted = runs.run_one(Trial(tuning.at(nominal), best.settings))
    if predicted is None:
        return list(fits)
    begun = replace(tuning, offset=nominal, values=tuning.at(nominal), predicted=predicted)
    ended = descend(runs, linearised(runs, begun, best.settings), measured, best.settings)
    cost = float(np.sum((measured - ended.predicted) ** 2) + ended.offset @ ended.offset)
    if cost > best.cost - POLISHED_GAIN:
        return list(fits)
    return [*polish(runs, tuning, measured, [replace(best, offset=ended.offset, predicted=ended.predicted, cost=cost)]), *others]
