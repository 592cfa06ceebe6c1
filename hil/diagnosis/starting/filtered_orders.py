"""Orders of waves by the matched filter: what every order would do to the recordings, beside what they show.

What is missing at a joint, which other starts are read off, is taken from one encoder and weighs every frequency alike. A gear's error of a
tenth of a count moves no encoder, but an IMU and, where a resonance is near, its second harmonic the current. Here every order acts on its
joints, goes through the linear closed loop and counts in units of noise, with what re-tuning imitates taken out. One pass of the residual
back through the loop gives the products with all orders (`through_the_loop.py`); those that stand out are asked with both harmonics, whose
amplitudes and phases the filter gives.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.ndimage

from hil.diagnosis.starting.candidates import Candidate
from hil.diagnosis.starting.motion import Motion
from hil.diagnosis.starting.start_waves import FIRST_AND_SECOND, MOST_ORDERS, ORDERS_AROUND, ORDERS_PER_TRAVEL, range_of_orders
from hil.diagnosis.starting.through_the_loop import ThroughTheLoop
from hil.diagnosis.starting.typical import Typical
from hil.diagnosis.tuning.projection import Projection
from hil.diagnosis.tuning.retune import Tuning
from virtual_bus.effects.places import spring_at
from virtual_bus.effects.registry import effects
from virtual_bus.effects.residual import Residual, joined

ASKED = 6
"""Orders that stand out most, of which each, and the one half as large, is asked with both harmonics."""

SLOW_ASKED = 3
"""The same of the slowest, up to ORDERS_AROUND cycles per travel above the lowest, besides: what a wave does changes much from one of them
to the next, and none stands out of those around it by as much as some of a thousand quick ones do by chance. A gear's error of two cycles
per travel and 42 in energy need not be among the six. It is one start more where it has more energy than they."""

SLOWEST_ASKED = 4
"""Orders that are asked whatever stands out, half a cycle per travel apart from the lowest on: how much a wave of one or two cycles moves
the recordings, and how much of that re-tuning imitates, differs more between these than any wave that is there makes them differ. A gear's
error of a cycle per travel and 69 in energy may stand out less than any."""

STARTS = 2
"""Orders of the largest energy that fits may start from."""

APART_STEPS = 3.25
"""Steps by which orders that stand out differ: a wave is two cycles per travel wide. Orders begin three whole steps from none, so that they
and their halves are multiples of half a step apart; at no such multiple rounding decides."""

HALF_APART_STEPS = 0.75
"""The same of their halves and these orders, and of their halves."""

RIDGE = 1e-6
"""Share of its energy by which a harmonic's response must differ from the others' to be told from them."""


@dataclass(frozen=True, eq=False)
class _Wave:
    """A candidate that is a wave, along one set's groups."""

    candidate: Candidate
    parts: tuple[Residual, ...]
    driven: int
    spring: int | None
    deflections: tuple[np.ndarray, ...]
    typical: Typical

    @cached_property
    def middles(self) -> tuple[np.ndarray, ...]:
        """Positions in the middle of every sample, over which the loop holds what a wave does in it."""
        return tuple(part.position + 0.5 * self.typical.sample_s * part.speed for part in self.parts)

    def factors(self, number: int) -> list[tuple[int, np.ndarray | float, int]]:
        """In one group every joint, the factor of the wave there, and how many times the wave is differentiated by position."""
        part = self.parts[number]
        if self.spring is not None:  # it rests elsewhere, and its effort along that acts back on the motor
            return [(self.spring, part.stiffness, 0), (self.driven, part.stiffness * self.deflections[number], 1)]
        return [(self.driven, part.drive_effort if self.candidate.effect.effect == "torque_ripple" else 1.0, 0)]

    def efforts(self, order: float, turned: complex) -> list[list[tuple[int, np.ndarray]]]:
        """Of a wave of amplitude and phase |turned| and arg(turned), order in radians per radian (or metre) of the joint."""
        found = []
        for number in range(len(self.parts)):
            wave = turned * np.exp(1j * order * self.middles[number])
            found.append([(joint, np.real(factor * wave * (1j * order) ** times)) for joint, factor, times in self.factors(number)])
        return found

    def products(self, behind: Sequence[np.ndarray], orders: np.ndarray) -> np.ndarray:
        """(K,) complex: of waves of phase 0 the real parts, a quarter of a cycle later less the imaginary ones. Orders in equal steps."""
        total = np.zeros(len(orders), dtype=complex)
        step = float(orders[1] - orders[0]) if len(orders) > 1 else 0.0
        for number, efforts in enumerate(behind):
            wave, turn = (np.exp(1j * order * self.middles[number]) for order in (orders[0], step))
            factors = self.factors(number)
            weights = np.stack([efforts[:, joint] * factor for joint, factor, _ in factors])
            times = np.array([each for _, _, each in factors])
            for k, order in enumerate(orders):
                total[k] += np.sum((weights @ wave) * (1j * order) ** times)
                wave = wave * turn
        return total


def order_starts(
    loop: ThroughTheLoop, tuning: Tuning, candidate: Candidate, motions: Sequence[Motion], behind: Sequence[np.ndarray], left: np.ndarray
) -> list[np.ndarray]:
    """(parameters,) of waves over position at the orders of the largest energy, the largest first.

    Parameters
    ----------
    loop : ThroughTheLoop
    tuning : Tuning
        Without effects.
    candidate : Candidate
        Of `start_waves.FIRST_AND_SECOND`.
    motions : sequence of Motion
        Of every training group, beside what was found.
    behind : sequence of (N, joints + axes) arrays
        The residual taken back through the loop (`ThroughTheLoop.efforts_behind`).
    left : (M + F,) array
        The residual with re-tuning taken out.
    """
    return _starts(loop, tuning, _wave(candidate, motions), behind, left)


def _wave(candidate: Candidate, motions: Sequence[Motion]) -> _Wave:
    at, plant = candidate.effect.at, motions[0].machine.plant
    joints = [joint.name for joint in plant.tree.joints]
    driven = joints.index(plant.drives[motions[0].axis_of(at)].joint)
    spring = spring_at(at, plant) if candidate.effect.effect == "transmission_error" else None
    behind = None if spring is None else joints.index(spring)
    deflections = tuple(motion.deflection(behind) for motion in motions) if behind is not None else ()
    parts = tuple(motion.residual(at) for motion in motions)
    return _Wave(candidate, parts, driven, behind, deflections, Typical(motions[0], at, joined(parts)))


def _starts(loop: ThroughTheLoop, tuning: Tuning, wave: _Wave, behind: Sequence[np.ndarray], left: np.ndarray) -> list[np.ndarray]:
    """(parameters,) at the orders of the largest energy, the largest first."""
    whole = joined(wave.parts)
    lowest, highest = range_of_orders(whole, wave.typical)
    step = 2.0 * np.pi / wave.typical.travel / ORDERS_PER_TRAVEL
    orders = np.arange(lowest, max(highest, lowest + step), step)[:MOST_ORDERS]
    power = np.abs(wave.products(behind, orders)) ** 2
    # beyond the ends as next to them, and not (`nearest`) as the last alone, which may be a wave's
    around = scipy.ndimage.median_filter(power, round(ORDERS_AROUND * ORDERS_PER_TRAVEL), mode="reflect")
    standing_out = [float(orders[k]) for k in np.argsort(-power / np.maximum(around, 1e-300))]

    def with_halves(standing_out: Sequence[float], most: int) -> list[float]:
        first = _apart(standing_out, APART_STEPS * step, most)
        return _apart([*first, *(0.5 * order for order in first if 0.5 * order >= lowest)], HALF_APART_STEPS * step, 2 * most)

    asked = with_halves(standing_out, ASKED)
    slow = with_halves([order for order in standing_out if order < lowest + ORDERS_AROUND * ORDERS_PER_TRAVEL * step], SLOW_ASKED)
    slow = [*slow, *(float(order) for order in orders[: 2 * SLOWEST_ASKED : 2] if order not in slow)]
    scored = {order: _filtered(loop, tuning, wave, order, left) for order in dict.fromkeys([*asked, *slow])}

    def energy(order: float) -> float:
        return scored[order][0]

    best = _apart(sorted(asked, key=energy, reverse=True), APART_STEPS * step, STARTS)
    slowest = max(slow, key=energy)
    if energy(slowest) > energy(best[0]):
        best = _apart([slowest, *best], APART_STEPS * step, STARTS + 1)
    return [scored[order][1] for order in best]


def _apart(orders: Sequence[float], least: float, most: int) -> list[float]:
    """The first of them that differ by more than this."""
    chosen: list[float] = []
    for order in orders:
        if len(chosen) < most and all(abs(order - other) > least for other in chosen):
            chosen.append(order)
    return chosen


def _filtered(loop: ThroughTheLoop, tuning: Tuning, wave: _Wave, order: float, left: np.ndarray) -> tuple[float, np.ndarray]:
    """The residual's energy along both harmonics of an order, and the effect's parameters there."""
    columns = [wave.efforts(harmonic * order, turned) for harmonic in (1.0, 2.0) for turned in (1.0, 1j)]
    each = [[one for column in columns for one in column[group]] for group in range(len(wave.parts))]
    answers = loop.responses(each).reshape(len(columns), -1, len(tuning.predicted)).sum(axis=1)
    responses = Projection.of(tuning).left(answers)
    gram, products = responses @ responses.T, responses @ left
    gram[np.diag_indices_from(gram)] *= 1.0 + RIDGE
    weights = np.linalg.lstsq(gram, products, rcond=None)[0]
    turned = weights[::2] + 1j * weights[1::2]
    name = wave.candidate.effect.effect
    numbered, *harmonics = FIRST_AND_SECOND[name]
    named = {numbered: order / wave.parts[0].ratio}
    for (amplitude, phase), value in zip(harmonics, turned, strict=True):
        named |= {amplitude: float(np.abs(value)), phase: float(np.angle(value))}
    values = np.array([np.clip(named[p.name], p.low, p.high) for p in effects()[name].parameters])
    return float(weights @ products), values
