"""Numbers and a set of effects fitted for good: seen anew, and fitted anew, until nothing changes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hil.diagnosis.named.fitting import ITERATIONS, Fitted, fit
from hil.diagnosis.seen.along import Along
from hil.diagnosis.seen.beside import Levels
from hil.diagnosis.tuned.retuning import Tuned, tuned_at
from virtual_bus.settings import EffectSetting

LONGEST = 1.0
"""Standard deviations of a number's prior: how far it may go before the machine is seen anew, since equations are linear nearby only."""
SHORTENED, SHORTEST = 0.3, 0.02
"""Of a step that was too long, and where shortening ends, in standard deviations of a number's prior."""
SETTLED = 1.0
"""Decrease of the cost, in units of noise, below which nothing changes."""


def settled(alongs: Sequence[Along], levels: Levels, offset: np.ndarray, settings: Sequence[EffectSetting] = ()) -> tuple[Tuned, Fitted]:
    """Return the machine where numbers and effects fit best, and the fit there.

    While the equations are far off, their error counts as noise: squared innovations are weighed by their mean. A step that makes the
    machine that is seen anew worse is shortened.
    """
    settings = tuple(settings)
    best: tuple[Tuned, Fitted] | None = None
    longest, dispersion = LONGEST, np.inf
    for _ in range(ITERATIONS):
        tuned = tuned_at(alongs, levels, offset, settings)
        here = fit(tuned, settings, offset, longest=0.0)
        if here is None:
            break
        dispersion = min(dispersion, max(here.dispersion, here.squares / tuned.readings))
        gained = np.inf if best is None else best[1].cost(dispersion) - here.cost(dispersion)
        if gained > 0.0:
            best = (tuned, here)
        else:
            longest *= SHORTENED
        assert best is not None
        tuned, here = best
        if 0.0 < gained < SETTLED or longest < SHORTEST:
            break
        further = fit(tuned, here.settings, here.offset, dispersion, longest)
        if further is None:
            break
        offset, settings = further.offset, further.settings
    assert best is not None
    tuned, here = best
    last = fit(tuned, here.settings, here.offset, max(here.dispersion, here.squares / tuned.readings))
    assert last is not None
    return tuned, last
