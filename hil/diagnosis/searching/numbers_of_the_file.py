"""Numbers of the machine file that are further off than re-tuning may go are fitted before what is mistaken for them is named.

Screening takes out what re-tuned numbers could imitate, as if these had no bounds. Beyond its bound such a number scores next to nothing,
and its filter wants any strength, whatever a fit would come to: a compliance of a fifth of the C-arm's spring would be no candidate, and a
spring that softens from its first microradian on, which is the same, would be the only name. Where what comes closest leaves more than
noise all the same, any number there may be meant: a torque constant a fifth off beside a gyro's lost sign may be called a spring that
hardens, which the catalogue does not take for it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hil.diagnosis.fitting.refit import Fitted, polish, refit
from hil.diagnosis.fitting.screening import Screened
from hil.diagnosis.judging.errors_of_laws import NUMBERS
from hil.diagnosis.judging.judgement import Stand
from hil.diagnosis.residuals.excess import certain_excess
from hil.diagnosis.result import EffectAt
from hil.diagnosis.searching.pairs import beside
from hil.diagnosis.tuning.free_run import FreeRuns
from hil.diagnosis.tuning.retune import Tuning
from virtual_bus.effects.places import part_at
from virtual_bus.effects.registry import effects
from virtual_bus.settings import PlantSettings

RETUNED = tuple(name for name in NUMBERS if name != "rectified_sensor")
"""Whose screening means nothing beyond re-tuning's bounds; a sign has none."""

WORTH_POLISHING = 0.5
"""Of the closest fit's gain: what gains less seldom competes for the name (`ways.RIVAL_SHARE`)."""


def with_numbers_of_the_file(
    runs: FreeRuns, tuning: Tuning, measured: np.ndarray, fits: Sequence[Fitted], screened: Sequence[Screened], stand: Stand
) -> list[Fitted]:
    """Fits of one effect more than were found, and of those numbers at the closest one's place that the catalogue says are mistaken for it;
    of all numbers at that part of the machine, where it leaves more than noise for certain.

    Parameters
    ----------
    runs : FreeRuns
    tuning : Tuning
        Without effects.
    measured : (M,) array
    fits : sequence of Fitted
        Their last effect is the one that was added.
    screened : sequence of Screened
    stand : Stand
        What they are added to.
    """
    best = min(fits, key=lambda fit: fit.cost)
    fitted = {effect for fit in fits for effect in fit.effects}
    numbers = [one for one in screened if one.effect.effect in NUMBERS and one.effect not in fitted]
    closest, entries = best.effects[-1], float(len(measured))
    leaves_more = best.cost - entries > certain_excess(entries)

    def is_meant(number: EffectAt) -> bool:
        if are_neighbours(number, closest):
            return True
        return leaves_more and number.effect in RETUNED and is_there_too(number, closest, runs.machine.plant)

    numbers = [one for one in numbers if is_meant(one.effect)]
    starts = [beside(stand.fitted, one) for one in numbers]
    if not starts:
        return list(fits)
    least = WORTH_POLISHING * (stand.cost - best.cost)
    worth = [fit for fit in refit(runs, stand.tuning, measured, starts) if fit is not None and stand.cost - fit.cost > least]
    return [*fits, *polish(runs, tuning, measured, worth)]


def is_there_too(one: EffectAt, other: EffectAt, settings: PlantSettings) -> bool:
    """Whether two effects act at one part of the machine."""
    return part_at(one.at, settings) == part_at(other.at, settings)


def are_neighbours(one: EffectAt, other: EffectAt) -> bool:
    """Whether the catalogue says of either of two effects at one place that it is mistaken for the other."""
    each = effects()
    return one.at == other.at and (one.effect in each[other.effect].neighbours or other.effect in each[one.effect].neighbours)
