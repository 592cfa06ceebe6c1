"""Starts of waves over position: the orders that stand out of what is missing."""

from __future__ import annotations

from collections.abc import Callable
from itertools import product

import numpy as np
import scipy.ndimage

from hil.diagnosis.starting.motion import highest_seen_Hz
from hil.diagnosis.starting.typical import Start, Typical
from virtual_bus.effects.residual import Residual, harmonics

ORDERS_PER_TRAVEL = 4.0
"""Orders over position are looked for in steps of this part of a cycle per travel."""

ORDERS_AROUND = 10.0
"""Cycles per travel around an order whose median power is what noise has there: a wave is two wide."""

MOST_ORDERS = 8000
HIGHEST_ORDER_Hz, HIGHEST_MISSING_Hz = 40.0, 20.0
"""Orders that pass faster than the first while the joint moves slowly, or than the second at the usual speed in what is missing at a joint,
which is known up to some 30 Hz, are not looked for: the loop, the drive and the mass do not let them through."""

SLOW_SHARE = 0.2
"""Of the time in motion, in which a joint moves slowly: a wave that passes too fast at the usual speed shows there. Ripples that pass at 76
and 38 Hz at the usual speed may be 15 and 10 deviations long."""

ONE_HARMONIC = 0.5
TWO_HARMONICS = 0.75 * np.sqrt(2.5)
"""Gamma((s+1)/2) / (Gamma(s/2) sqrt(pi)) for two and for four amplitudes, the latter times the rms of 1 and 2 (see `shapes_of`)."""

WAVES = {
    "cogging": TWO_HARMONICS,
    "torque_ripple": TWO_HARMONICS,
    "transmission_error": TWO_HARMONICS,
    "position_dependent_friction": ONE_HARMONIC,
    "encoder_eccentricity": ONE_HARMONIC,
}

TURNING_WITH_THE_MOTOR = ("cogging", "torque_ripple", "transmission_error")
"""Waves that come several times a turn of the motor. Friction over position may change slowly, and an encoder's first error does so once a
turn, whatever part of it is driven."""

FIRST_AND_SECOND = {
    "cogging": ("Np", ("A1", "phi1"), ("A2", "phi2")),
    "torque_ripple": ("Np", ("A1", "phi1"), ("A2", "phi2")),
    "transmission_error": ("k", ("e1", "phi1"), ("e2", "phi2")),
}
"""Order, and amplitude and phase of either harmonic."""

PERIODS_PER_TRAVEL = (0.6, 1.0, 1.5)
"""Of friction over position."""


def wave_orders(
    order: str,
    amplitudes: tuple[str, str],
    phases: tuple[str, str],
    per: Callable[[Residual], np.ndarray],
    scale: Callable[[Residual], float],
) -> Callable[[Start, Residual, Typical], list[Start]]:
    """The strongest orders over position of what is missing, whole or not."""

    def find(first: Start, residual: Residual, typical: Typical) -> list[Start]:
        found = []
        ratio = scale(residual)
        strongest = _strongest_orders(residual, per(residual), typical, 2)
        waves = {value: harmonics(value * residual.position, per(residual)) for value in strongest}
        for value, ((a1, p1), (a2, p2)) in waves.items():
            halves = [other for other in strongest if abs(value - 2.0 * other) < 2.0 * np.pi / typical.travel]
            if any(waves[half][0][0] > a1 for half in halves):
                continue  # the second harmonic of the other one, which starts with both
            found.append({**first, order: value / ratio, amplitudes[0]: a1, phases[0]: p1, amplitudes[1]: a2, phases[1]: p2})
        return found

    return find


def searched_orders(name: str, residual: Residual, typical: Typical) -> tuple[float, float]:
    """Radians per radian (or metre) between which this wave's orders are looked for, by the matched filter or in the missing effort."""
    return range_of_orders(residual, typical) if name in TURNING_WITH_THE_MOTOR else range_in_what_is_missing(residual, typical)


def range_in_what_is_missing(residual: Residual, typical: Typical) -> tuple[float, float]:
    """Radians per radian (or metre) of the joint between which orders of the missing effort are looked for."""
    return _lowest_order(typical), _order_at(float(np.sqrt(np.mean(residual.speed**2))), HIGHEST_MISSING_Hz, typical)


def range_of_orders(residual: Residual, typical: Typical) -> tuple[float, float]:
    """Radians per radian (or metre) of the joint between which orders are looked for by the matched filter."""
    slow_speed = float(np.quantile(np.abs(residual.speed[residual.moves]), SLOW_SHARE)) if np.any(residual.moves) else 0.0
    return _lowest_order(typical), _order_at(slow_speed, HIGHEST_ORDER_Hz, typical)


def _lowest_order(typical: Typical) -> float:
    return 2.0 * np.pi / typical.travel * 0.75


def _order_at(speed: float, highest_Hz: float, typical: Typical) -> float:
    return 2.0 * np.pi * highest_seen_Hz(highest_Hz, 1.0 / typical.sample_s) / max(speed, 1e-6)


def _strongest_orders(residual: Residual, values: np.ndarray, typical: Typical, count: int) -> list[float]:
    """Cycles per radian (or metre) times 2 pi of the joint that explain most, beside a smooth motion's own effort.

    As many (`count`) that stand out most of the orders around them, and as many of the largest power: what is missing is an effort, and
    noise of positions grows in it with the square of frequency, so the largest power is that of noise at high orders.
    """
    lowest, highest = range_in_what_is_missing(residual, typical)
    step = 2.0 * np.pi / typical.travel / ORDERS_PER_TRAVEL
    orders = np.arange(lowest, max(highest, lowest + step), step)[:MOST_ORDERS]
    every = max(1, len(values) // 3000)
    q, v = residual.position[::every], values[::every]
    smooth = [np.ones_like(q), q, q**2, residual.speed[::every], np.sign(residual.speed[::every]), residual.acceleration[::every]]
    basis, _ = np.linalg.qr(np.column_stack(smooth))
    v = v - basis @ (basis.T @ v)
    power = np.array([abs(np.exp(-1j * order * q) @ v) for order in orders])
    around = scipy.ndimage.median_filter(power**2, round(ORDERS_AROUND * ORDERS_PER_TRAVEL), mode="nearest")
    found: list[float] = []
    for measure in (power**2 / np.maximum(around, 1e-300), power):
        chosen: list[float] = []
        for k in np.argsort(-measure):
            if all(abs(orders[k] - other) > 3.0 * step for other in chosen):
                chosen.append(float(orders[k]))
            if len(chosen) == count:
                break
        found += [order for order in chosen if all(abs(order - other) > 3.0 * step for other in found)]
    return found


def position_friction(first: Start, residual: Residual, typical: Typical) -> list[Start]:
    """The strongest orders of what acts against the motion, and slow ones at several phases."""
    moving = residual.moves
    against = -np.sign(residual.speed) * residual.effort * moving
    found = []
    for value in _strongest_orders(residual, against, typical, 2):
        (amplitude, phase), _ = harmonics(value * residual.position[moving], against[moving])
        found.append({**first, "Fc": 2.0 * amplitude, "k": value, "phi": phase})
    # where nothing stands out of the noise
    for periods, phase in product(PERIODS_PER_TRAVEL, (0.0, 2.0 * np.pi / 3.0, -2.0 * np.pi / 3.0)):
        found.append({**first, "k": 2.0 * np.pi * periods / typical.travel, "phi": phase})
    return found


def encoder_orders(first: Start, residual: Residual, typical: Typical) -> list[Start]:
    """The strongest order of what two encoders of a joint differ by, and an eccentricity alone."""
    found = []
    for value in _strongest_orders(residual, residual.difference, typical, 1):
        (b, _), _ = harmonics(value * residual.position, residual.difference)
        found.append({**first, "b": b, "Nl": value})
    return [*found, {**first, "a": max(first["a"], 1e-4 * typical.travel), "b": 0.0}]
