"""Waves over one joint's position have an order in common, whichever law brings it: what one of them was found at, the others are tried at.

Every law looks for its orders in what it would explain itself: a cogging in the missing effort, a gear's error in how its spring gives way,
an encoder's in what two encoders differ by. Where only one of these shows the order, the other laws are fitted at orders that are none and
lose to the one that stands alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hil.diagnosis.fitting.refit import POLISHED_GAIN, Fitted, polish, refit
from hil.diagnosis.fitting.screening import screen
from hil.diagnosis.judging.judgement import Stand
from hil.diagnosis.result import EffectAt
from hil.diagnosis.searching.numbers_of_the_file import WORTH_POLISHING
from hil.diagnosis.starting.candidates import Candidate
from hil.diagnosis.starting.start_waves import TURNING_WITH_THE_MOTOR
from hil.diagnosis.tuning.free_run import TRAIN, FreeRuns
from hil.diagnosis.tuning.retune import Tuning
from virtual_bus.effects.places import part_at
from virtual_bus.effects.registry import effects
from virtual_bus.settings import PlantSettings

ORDER = {
    "cogging": "Np",
    "torque_ripple": "Np",
    "transmission_error": "k",
    "position_dependent_friction": "k",
    "encoder_eccentricity": "Nl",
}

AROUND = (-0.25, 0.0, 0.25)
"""Cycles per travel around the order found: a law whose phase is not free, an encoder's, has its order moved by what that misses."""

THE_SAME = 0.5
"""Cycles per travel within which two orders are one."""


def with_others_of_its_order(
    runs: FreeRuns, tuning: Tuning, stand: Stand, measured: np.ndarray, fits: Sequence[Fitted], found: Sequence[Candidate]
) -> list[Fitted]:
    """The fits; where the best one's last effect is a wave over an axis' position, the other waves over that are fitted at its order too.

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
    """
    beside = [fit for fit in fits if set(stand.effects) < set(fit.effects)]  # one in its place may be closer by rounding
    best = min(beside or fits, key=lambda fit: fit.cost)
    name = best.effects[-1]
    if name.effect not in ORDER or best.effects[:-1] != stand.effects:
        return list(fits)
    settings = runs.machine.plant
    part = part_at(name.at, settings)
    if part not in runs.machine.axes:
        return list(fits)
    order = _order(name, best.values[-1], settings)
    cycle = 2.0 * np.pi / _travel(runs, part)
    waves = [*zip(best.effects, best.values, strict=True), *((fit.effects[-1], fit.values[-1]) for fit in fits)]
    known = {
        (wave.effect, wave.at)
        for wave, values in waves
        if wave.effect in ORDER and abs(_order(wave, values, settings) - order) < THE_SAME * cycle
    }
    others = [
        _at_orders(candidate, [order + share * cycle for share in AROUND], settings)
        for candidate in found
        if candidate.effect.effect in ORDER
        and (candidate.effect.effect, candidate.effect.at) not in known
        and part_at(candidate.effect.at, settings) == part
    ]
    others = [candidate for candidate in others if candidate.starts]
    if not others:
        return list(fits)
    present = () if stand.fitted is None else stand.fitted.settings
    screened = screen(runs, stand.tuning, others, measured - stand.tuning.predicted, present)
    starts = [((*best.effects[:-1], one.effect), (*best.values[:-1], one.values)) for one in screened if one.score > 0.0]
    least = WORTH_POLISHING * (stand.cost - best.cost)
    again = [fit for fit in refit(runs, stand.tuning, measured, starts) if fit is not None and stand.cost - fit.cost > least]
    again = [fit for fit in again if all(fit.cost < one.cost - POLISHED_GAIN for one in fits if one.effects == fit.effects)]
    kept = [fit for fit in fits if fit.effects not in [one.effects for one in again]]
    return [*kept, *polish(runs, tuning, measured, again)]


def _order(effect: EffectAt, values: np.ndarray, settings: PlantSettings) -> float:
    """Radians per radian (or metre) of the joint."""
    return float(values[_place(effect)]) * _ratio(effect, settings)


def _place(effect: EffectAt) -> int:
    return [parameter.name for parameter in effects()[effect.effect].parameters].index(ORDER[effect.effect])


def _ratio(effect: EffectAt, settings: PlantSettings) -> float:
    """Of the motor's coordinate, where the law counts in it."""
    if effect.effect not in TURNING_WITH_THE_MOTOR:
        return 1.0
    return next((drive.ratio for drive in settings.drives if drive.axis == part_at(effect.at, settings)), 1.0)


def _at_orders(candidate: Candidate, orders: Sequence[float], settings: PlantSettings) -> Candidate:
    """With its own first start moved to these orders, as far as they are within its range."""
    place = _place(candidate.effect)
    parameter = effects()[candidate.effect.effect].parameters[place]
    starts = []
    for order in orders:
        start = np.array(candidate.starts[0], dtype=float)
        start[place] = order / _ratio(candidate.effect, settings)
        if parameter.low <= start[place] <= parameter.high:
            starts.append(start)
    return replace(candidate, starts=tuple(starts))


def _travel(runs: FreeRuns, axis: str) -> float:
    """Of an axis over the training recordings [rad or m]."""
    number = list(runs.machine.axes).index(axis)
    position = np.concatenate([group.position[:, number] for group in runs.sets[TRAIN].groups])
    return max(float(np.ptp(position)), 1e-9)
