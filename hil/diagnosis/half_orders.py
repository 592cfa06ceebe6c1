"""A wave over position that was fitted at twice its order.

Twice the order of a law's first harmonic is its second: a resonance, or an acceleration that grows with the square of the order, shows that
one first. From half the order the second harmonic stands for what was found, and the first is free.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hil.diagnosis.free_run import FreeRuns
from hil.diagnosis.refit import POLISHED_GAIN, Fitted, polish, refit
from hil.diagnosis.result import EffectAt
from hil.diagnosis.retune import Tuning
from virtual_bus.effects.registry import effects

FIRST_AND_SECOND = {
    "cogging": ("Np", ("A1", "phi1"), ("A2", "phi2")),
    "torque_ripple": ("Np", ("A1", "phi1"), ("A2", "phi2")),
    "transmission_error": ("k", ("e1", "phi1"), ("e2", "phi2")),
}
"""Order, and amplitude and phase of either harmonic."""

NO_SECOND = 0.5
"""Amplitude of the second harmonic, as a share of the first's, from which on the order is no other one's second harmonic. Where it is one,
a second harmonic of its own is fitted to what the missing first leaves: to a quarter, in the test."""

FIRST = 0.3
"""The same of a first harmonic that a fit starts with."""

PHASES = (0.0, 2.0 * np.pi / 3.0, -2.0 * np.pi / 3.0)


def from_half_the_order(effect: EffectAt, values: np.ndarray) -> list[np.ndarray]:
    """Starts of a wave from half its order; none where it has a second harmonic of its own, is at its lowest order or is no wave."""
    if effect.effect not in FIRST_AND_SECOND:
        return []
    order, (a1, phi1), (a2, phi2) = FIRST_AND_SECOND[effect.effect]
    parameters = effects()[effect.effect].parameters
    place = {parameter.name: k for k, parameter in enumerate(parameters)}
    half = 0.5 * float(values[place[order]])
    if values[place[a2]] > NO_SECOND * values[place[a1]] or half < parameters[place[order]].low:
        return []
    starts = []
    for phase in PHASES:
        start = np.array(values, dtype=float)
        found, at = values[place[a1]], values[place[phi1]]
        start[[place[name] for name in (order, a1, phi1, a2, phi2)]] = half, FIRST * found, phase, found, at
        starts.append(start)
    return starts


def with_half_orders(runs: FreeRuns, tuning: Tuning, measured: np.ndarray, fits: Sequence[Fitted]) -> list[Fitted]:
    """The fits; where the best one's last effect is a wave, it is also fitted from half its order, if that brings it closer."""
    best, *others = sorted(fits, key=lambda fit: fit.cost)  # those that were finished are no longer in order
    starts = [(best.effects, (*best.values[:-1], values)) for values in from_half_the_order(best.effects[-1], best.values[-1])]
    again = [fit for fit in refit(runs, tuning, measured, starts) if fit is not None] if starts else []
    closest = min(again, key=lambda fit: fit.cost, default=best)
    if closest.cost > best.cost - POLISHED_GAIN:
        return list(fits)
    return [*polish(runs, tuning, measured, [closest]), *others]
