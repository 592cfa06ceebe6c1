"""The closest fit's last effect from its other starts, where it leaves something for certain: the start that screening wanted may be in
another valley.

A hysteresis that ended with a travel of 0.12 mm left 5775 of 8238 in units of noise, and from a start that screening liked less it came to
0.03 mm and left 4385 (10051, spent).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hil.diagnosis.fitting.refit import POLISHED_GAIN, Fitted, polish, refit
from hil.diagnosis.fitting.screening import screen
from hil.diagnosis.judging.judgement import Stand
from hil.diagnosis.residuals.excess import certain_excess
from hil.diagnosis.starting.candidates import Candidate
from hil.diagnosis.tuning.free_run import FreeRuns
from hil.diagnosis.tuning.retune import Tuning

MOST_STARTS = 4
"""Of those that screening liked next best, that are fitted."""

NEARLY_AS_CLOSE = 0.5
"""Share of the closest fit's gain from which one from another start is worth polishing."""


def with_other_starts(
    runs: FreeRuns, tuning: Tuning, stand: Stand, measured: np.ndarray, fits: Sequence[Fitted], found: Sequence[Candidate], noise: float
) -> list[Fitted]:
    """The fits, the closest of which gives way to one of the same set from another start that leaves less.

    Parameters
    ----------
    runs : FreeRuns
    tuning : Tuning
        Without effects.
    stand : Stand
        What was found before, to which the last effect of the best fit was added.
    measured : (M,) array
    fits : sequence of Fitted
    found : sequence of Candidate
        All that may act.
    noise : float
        Expected |residual|^2 of a perfect simulation.
    """
    best = min(fits, key=lambda fit: fit.cost)
    candidate = next((one for one in found if best.effects == (*stand.effects, one.effect)), None)
    if candidate is None or len(candidate.starts) < 2 or best.cost - noise <= certain_excess(noise):
        return list(fits)
    present = () if stand.fitted is None else stand.fitted.settings
    residual = measured - stand.tuning.predicted
    each = [
        one for start in candidate.starts for one in screen(runs, stand.tuning, [replace(candidate, starts=(start,))], residual, present)
    ]
    each.sort(key=lambda one: -one.score)
    next_best = [one for one in each[1 : 1 + MOST_STARTS] if one.score > 0.0]
    starts = [((*best.effects[:-1], one.effect), (*best.values[:-1], one.values)) for one in next_best]
    least = NEARLY_AS_CLOSE * (stand.cost - best.cost)
    more = [fit for fit in refit(runs, stand.tuning, measured, starts) if fit is not None and stand.cost - fit.cost > least]
    closest = polish(runs, tuning, measured, sorted(more, key=lambda fit: fit.cost)[:1])
    closer = [fit for fit in closest if fit.cost < best.cost - POLISHED_GAIN]
    return [*(fit for fit in fits if fit is not best or not closer), *closer]
