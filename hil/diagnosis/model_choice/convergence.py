"""Numbers and a set of effects fitted for good: seen anew, and fitted anew, until nothing changes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hil.diagnosis.model_choice.fitting import ITERATIONS, Fitted, fit
from hil.diagnosis.residuals.equation_errors import Levels
from hil.diagnosis.residuals.trajectory import Trajectory
from hil.diagnosis.retuning.linear_model import LinearModel, linear_at
from virtual_bus.settings import EffectSetting

LONGEST = 1.0
"""Standard deviations of a number's prior: how far it may go before the machine is seen anew, since equations are linear nearby only."""
SHORTENED, SHORTEST = 0.3, 0.02
"""Of a step that was too long, and where shortening ends, in standard deviations of a number's prior."""
CONVERGED = 1.0
"""Decrease of the cost, in units of noise, below which nothing changes."""


def converged(
    trajectories: Sequence[Trajectory], levels: Levels, offset: np.ndarray, settings: Sequence[EffectSetting] = ()
) -> tuple[LinearModel, Fitted]:
    """Return the machine where numbers and effects fit best, and the fit there.

    While the equations are far off, their error counts as noise: squared innovations are weighed by their mean. A step that makes the
    machine that is seen anew worse is shortened.
    """
    settings = tuple(settings)
    best: tuple[LinearModel, Fitted] | None = None
    longest, dispersion = LONGEST, np.inf
    for _ in range(ITERATIONS):
        linear = linear_at(trajectories, levels, offset, settings)
        here = fit(linear, settings, offset, longest=0.0)
        if here is None:
            break
        dispersion = min(dispersion, max(here.dispersion, here.squares / linear.readings))
        gained = np.inf if best is None else best[1].cost(dispersion) - here.cost(dispersion)
        if gained > 0.0:
            best = (linear, here)
        else:
            longest *= SHORTENED
        assert best is not None
        linear, here = best
        if 0.0 < gained < CONVERGED or longest < SHORTEST:
            break
        further = fit(linear, here.settings, here.offset, dispersion, longest)
        if further is None:
            break
        offset, settings = further.offset, further.settings
    assert best is not None
    linear, here = best
    last = fit(linear, here.settings, here.offset, max(here.dispersion, here.squares / linear.readings))
    assert last is not None
    return linear, last
