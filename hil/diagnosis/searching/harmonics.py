"""The harmonics of a wave over position: a fit that lacks its second one, or is at twice its order or at half of it.

Twice the order of a law's first harmonic is its second: a resonance, or an acceleration that grows with the square of the order, shows that
one first. From half the order the second harmonic stands for what was found, and the first is free. A fit that began at the wrong phase of
its own second harmonic leaves that at zero, where its phase does nothing, and half the order then wins with what the missing harmonic
leaves: so both orders are tried from the same phases, whichever of them the fit is at.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hil.diagnosis.fitting.refit import POLISHED_GAIN, Fitted, polish, refit
from hil.diagnosis.result import EffectAt
from hil.diagnosis.starting.start_waves import FIRST_AND_SECOND
from hil.diagnosis.tuning.free_run import FreeRuns
from hil.diagnosis.tuning.retune import Tuning
from virtual_bus.effects.registry import effects

NO_SECOND = 0.5
"""Amplitude of the second harmonic, as a share of the first's, from which on the order is no other one's second harmonic. Where it is one,
a second harmonic of its own is fitted to what the missing first leaves: to a quarter, in the test."""

ADDED = 0.3
"""Amplitude of the harmonic that a fit starts with beside the one found, as a share of that."""

PHASES = (0.0, 2.0 * np.pi / 3.0, -2.0 * np.pi / 3.0)


def with_another_harmonic(effect: EffectAt, values: np.ndarray) -> list[np.ndarray]:
    """Starts of a wave without a second harmonic from its order with one, and from half its order; of a wave whose second harmonic is the
    larger from twice its order, with a second harmonic of that. None of any other wave, nor from orders beyond their range.
    """
    if effect.effect not in FIRST_AND_SECOND:
        return []
    order, (a1, phi1), (a2, phi2) = FIRST_AND_SECOND[effect.effect]
    parameters = effects()[effect.effect].parameters
    place = {parameter.name: k for k, parameter in enumerate(parameters)}
    k, first, at_first, second, at_second = (float(values[place[name]]) for name in (order, a1, phi1, a2, phi2))
    waves: list[tuple[float, ...]] = []
    if second <= NO_SECOND * first:
        waves += [(k, first, at_first, ADDED * first, phase) for phase in PHASES]
        if 0.5 * k >= parameters[place[order]].low:
            waves += [(0.5 * k, ADDED * first, phase, first, at_first) for phase in PHASES]
    elif second > first and 2.0 * k <= parameters[place[order]].high:
        waves += [(2.0 * k, second, at_second, ADDED * second, phase) for phase in PHASES]
    starts = []
    for wave in waves:
        start = np.array(values, dtype=float)
        start[[place[name] for name in (order, a1, phi1, a2, phi2)]] = wave
        starts.append(start)
    return starts


def with_other_harmonics(runs: FreeRuns, tuning: Tuning, measured: np.ndarray, fits: Sequence[Fitted]) -> list[Fitted]:
    """The fits; where the best one's last effect is a wave that may have another harmonic or order, it is also fitted from these, if that
    brings it closer.
    """
    best, *others = sorted(fits, key=lambda fit: fit.cost)  # those that were finished are no longer in order
    starts = [(best.effects, (*best.values[:-1], values)) for values in with_another_harmonic(best.effects[-1], best.values[-1])]
    again = [fit for fit in refit(runs, tuning, measured, starts) if fit is not None] if starts else []
    closest = min(again, key=lambda fit: fit.cost, default=best)
    if closest.cost > best.cost - POLISHED_GAIN:
        return list(fits)
    return [*polish(runs, tuning, measured, [closest]), *others]
