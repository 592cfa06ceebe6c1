"""What a shaper leaves of the vibration on the machine itself: drawn moves, simulated with feedback, friction and every effect of the file.

A verdict's shares are of the linear loop whose modes are where the file says. On a machine modes lie elsewhere, friction makes motion that
no shaper knows, and steps of drives and encoders ring it. So moves are drawn (size, direction, and how far the frequencies are off), each
is simulated without a shaper and with it, and what is left after the transient is compared with what moves of this kind leave without one.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from controllers.errors import DesignError
from controllers.settings import AxisLimits
from controllers.shapers.filter import ReferenceShaper
from controllers.shapers.sampled import AxisShaper
from controllers.trajectory import move
from hil.machine import Machine
from hil.shaping.plans import shaped
from hil.shaping.verdict import GAIN_LIMIT, VARIATION, Residual
from hil.simulation import Inputs, Simulator
from virtual_bus.settings import EffectSetting

DRAWN = 24
"""Moves. The next one of the same kind lies within the least and the greatest of n with a probability of (n - 1) / (n + 1): 92 %."""

SIZES = (0.02, 0.25)
"""Smallest and largest move, as a share of the axis's range."""

UNRANGED = 1.0
"""Range [rad or m] that is taken of an axis without one."""

LOOKED_AT_s = 1.0
"""Time after the transient in which the vibration is measured: eight periods of a mode at 8 Hz."""


@dataclass(frozen=True)
class DrawnMove:
    """A move of one axis, and by which share the machine's frequencies are off."""

    reference: np.ndarray  # (N, n_axes), standing from `arrived` on
    arrived: int  # row
    detuned: float


class Prediction:
    """The drawn moves of one axis from a pose, simulated without a shaper; `of` adds one with a shaper.

    Parameters
    ----------
    machine : Machine
        Its effects are in the simulation.
    axis : str
    pose : (n_axes,) array
    longest_samples : int
        Longest transient that will be asked for.
    seed : int
        Of the moves.

    Raises
    ------
    DesignError
        The axis has no limits of speed, acceleration or jerk, or stands still after every move.
    """

    def __init__(self, machine: Machine, axis: str, pose: np.ndarray, longest_samples: int, seed: int = 0) -> None:
        imus = tuple(replace(each, accelerometer_resolution_m_s2=0.0, gyro_resolution_rad_s=0.0) for each in machine.plant.imus)
        encoders = tuple(replace(each, resolution=0.0) if each.channel.startswith("link_") else each for each in machine.plant.encoders)
        # what moves is measured, not what a sensor resolves; the motors' encoders, which the loop closes on, keep their steps
        self._machine = replace(machine, plant=replace(machine.plant, imus=imus, encoders=encoders))
        self._axis, self._index = axis, machine.axis_index(axis)
        self._simulator = Simulator(self._machine)
        self._looked_at = round(LOOKED_AT_s * machine.sample_rate_Hz)
        self._moves = drawn_moves(machine, axis, pose, longest_samples + self._looked_at + 1, seed)
        # over all moves together: where friction holds the axis after some of them, those leave nothing that a share could be taken of
        self._without = float(np.sqrt(np.mean([self._vibration(each, each.reference, each.arrived) ** 2 for each in self._moves])))
        if not self._without > 0.0:
            raise DesignError(f"nothing of {axis} moves after a move, shaped or not")

    def shares(self, shaper: AxisShaper) -> np.ndarray:
        """Return what the shaper leaves after every move (moves,), as a share of the rms that all leave without one."""
        running = ReferenceShaper(self._machine.axes, [shaper], self._machine.limits, self._machine.sample_rate_Hz)
        left = []
        for each in self._moves:
            reference, _ = shaped(running, each.reference, each.reference[0])
            left.append(self._vibration(each, reference, each.arrived + shaper.transient_samples))
        return np.array(left) / self._without

    def of(self, shaper: AxisShaper) -> Residual:
        """Return what the shaper leaves: least, median and greatest share over the moves."""
        shares = self.shares(shaper)
        return Residual(float(np.min(shares)), float(np.median(shares)), float(np.max(shares)), len(shares))

    def _vibration(self, drawn: DrawnMove, reference: np.ndarray, begin: int) -> float:
        """Return the rms acceleration about its trend from a row on: by all IMUs, or by the axis's encoder where there is none."""
        still = np.zeros_like(reference)
        values, effects = detuned(self._machine, self._simulator, drawn.detuned)
        outputs = self._simulator.run(Inputs(reference, still, still, None, reference[0].copy()), values, effects)
        n = self._machine.plant.imus
        if n:
            seen = np.hstack([outputs.imu[:, 6 * k : 6 * k + 3] for k in range(len(n))])
        else:
            position = outputs.link_position if np.isfinite(outputs.link_position[:, self._index]).all() else outputs.position
            seen = np.gradient(np.gradient(position[:, [self._index]], axis=0), axis=0) * self._machine.sample_rate_Hz**2
        rows = seen[begin : begin + self._looked_at]
        time = np.linspace(-1.0, 1.0, len(rows))
        trend = np.polynomial.polynomial.polyfit(time, rows, 2)
        return float(np.sqrt(np.mean((rows - np.polynomial.polynomial.polyval(time, trend).T) ** 2)))


def drawn_moves(machine: Machine, axis: str, pose: np.ndarray, standing: int, seed: int = 0, count: int = DRAWN) -> list[DrawnMove]:
    """Draw moves of one axis that begin at a pose and stand for so many rows at their end.

    They are planned so that a shaper with the greatest gains keeps the limits.

    Raises
    ------
    DesignError
        The axis has no limits of speed, acceleration or jerk.
    """
    generator, index = np.random.default_rng(seed), machine.axis_index(axis)
    limits = tuple(_gentle(each) for each in machine.limits)
    lower, upper = limits[index].lower, limits[index].upper
    span = upper - lower if np.isfinite(upper - lower) else UNRANGED
    found = []
    for _ in range(count):
        size, detune = span * generator.uniform(*SIZES), float(generator.uniform(VARIATION[0], VARIATION[-1]))
        sign = 1.0 if generator.random() < 0.5 else -1.0
        goal = np.array(pose, dtype=float)
        goal[index] += sign * size if lower <= goal[index] + sign * size <= upper else -sign * size
        reference = move(np.asarray(pose, dtype=float), goal, limits, machine.sample_rate_Hz).position
        arrived = len(reference)
        found.append(DrawnMove(np.vstack([reference, np.tile(reference[-1], (standing, 1))]), arrived, detune))
    return found


def detuned(machine: Machine, simulator: Simulator, share: float) -> tuple[np.ndarray, tuple[EffectSetting, ...]]:
    """Return parameters and effects of a machine whose frequencies are off by a share: springs by its square, modes by itself."""
    driven = {drive.joint for drive in machine.plant.drives}
    values = np.array(simulator.plant.nominal, dtype=float)
    for number, parameter in enumerate(simulator.plant.parameters):
        if parameter.quantity == "stiffness" and parameter.owner not in driven:
            values[number] *= (1.0 + share) ** 2
    effects = tuple(
        replace(each, parameters={**each.parameters, "f": each.parameters["f"] * (1.0 + share)}) if each.name == "structural_mode" else each
        for each in machine.plant.effects
    )
    return values, effects


def _gentle(limit: AxisLimits) -> AxisLimits:
    if not np.isfinite([limit.speed, limit.acceleration, limit.jerk]).all():
        raise DesignError(f"{limit.axis}: no moves can be drawn without limits of speed, acceleration and jerk")
    return replace(limit, speed=limit.speed / GAIN_LIMIT, acceleration=limit.acceleration / GAIN_LIMIT, jerk=limit.jerk / GAIN_LIMIT)
