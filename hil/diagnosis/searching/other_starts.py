"""Fits' last effects from their other starts, where the closest leaves more than noise: the start that screening wanted may be in another
valley.

A hysteresis may end with a travel of 0.12 mm and leave 5775 of 8238 in units of noise, where it comes to 0.03 mm and leaves 4385 from a
start that screening likes less. A stop may gain 1701 from a start with a score of 1503, and 2793, where it is, from one of 1378.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hil.diagnosis.fitting.refit import POLISHED_GAIN, Fitted, polish, refit
from hil.diagnosis.fitting.screening import Screened, screen
from hil.diagnosis.judging.judgement import Stand
from hil.diagnosis.residuals.excess import certain_excess
from hil.diagnosis.searching.pairs import Start
from hil.diagnosis.starting.candidates import Candidate
from hil.diagnosis.tuning.free_run import FreeRuns
from hil.diagnosis.tuning.retune import Tuning

MOST_STARTS = 4
"""Of those that screening liked next best, that are fitted."""

LEFT = 0.5
"""Of what may be left for noise, from which other starts are tried."""

OF_RIVALS, AS_LIKED = 1, 0.7
"""So many of an effect that is not the closest, with at least this share of its best start's score."""

NEARLY_AS_CLOSE = 0.5
"""Share of the closest fit's gain from which another set is a rival, and a fit from another start worth polishing."""


def with_other_starts(
    runs: FreeRuns, tuning: Tuning, stand: Stand, measured: np.ndarray, fits: Sequence[Fitted], found: Sequence[Candidate], noise: float
) -> list[Fitted]:
    """The fits, the closest of which, and those that gain nearly as much, give way to one of the same set from another start that leaves
    less.

    Parameters
    ----------
    runs : FreeRuns
    tuning : Tuning
        Without effects.
    stand : Stand
        What was found before, to which the last effect of the fits was added.
    measured : (M,) array
    fits : sequence of Fitted
    found : sequence of Candidate
        All that may act.
    noise : float
        Expected |residual|^2 of a perfect simulation.
    """
    best = min(fits, key=lambda fit: fit.cost)
    if best.cost - noise <= LEFT * certain_excess(noise):
        return list(fits)
    least = NEARLY_AS_CLOSE * (stand.cost - best.cost)
    candidates = {(*stand.effects, one.effect): one for one in found}
    more: list[Fitted] = []
    for fit in fits:
        candidate = candidates.get(fit.effects)
        if candidate is None or len(candidate.starts) < 2 or stand.cost - fit.cost < least:
            continue
        liked = _liked(runs, stand, measured, candidate)
        most, least_score = (MOST_STARTS, 0.0) if fit is best else (OF_RIVALS, AS_LIKED * liked[0].score if liked else 0.0)
        next_best = [one for one in liked[1 : 1 + most] if one.score > least_score]
        starts: list[Start] = [((*fit.effects[:-1], one.effect), (*fit.values[:-1], one.values)) for one in next_best]
        if starts:  # each set by itself: starts of several would be given up where one of another set gains more
            more += [one for one in refit(runs, stand.tuning, measured, starts) if one is not None and stand.cost - one.cost > least]
    own = {fit.effects: fit for fit in fits}
    closest = {fit.effects: fit for fit in sorted(more, key=lambda fit: -fit.cost)}  # of each the one that leaves least
    near = [fit for fit in closest.values() if fit.effects == best.effects or fit.cost < own[fit.effects].cost]  # polishing costs time
    if not near:
        return list(fits)
    closer = {fit.effects: fit for fit in polish(runs, tuning, measured, near) if fit.cost < own[fit.effects].cost - POLISHED_GAIN}
    return [closer.get(fit.effects, fit) for fit in fits]


def _liked(runs: FreeRuns, stand: Stand, measured: np.ndarray, candidate: Candidate) -> list[Screened]:
    """A candidate from each of its starts that may gain anything, the one that screening likes best first."""
    present = () if stand.fitted is None else stand.fitted.settings
    residual = measured - stand.tuning.predicted
    each = [
        one for start in candidate.starts for one in screen(runs, stand.tuning, [replace(candidate, starts=(start,))], residual, present)
    ]
    return sorted((one for one in each if one.score > 0.0), key=lambda one: -one.score)
