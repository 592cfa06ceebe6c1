"""What a shaper leaves of the vibration as simulated: drawn moves, with feedback, friction and every effect of the file.

A verdict's shares are of the linear loop whose modes are where the file says. On a machine modes lie elsewhere, friction makes motion that
no shaper knows, and steps of drives and encoders ring it. So moves are drawn (size, direction, and how far the frequencies are off), each
is simulated without a shaper and with it, and what is left after the transient is compared with what moves of this kind leave without one.

What follows a move is a sum over the closed loop's poles. Those that ring are the vibration; the others are the loop's own settling, which
a shaper neither knows nor leaves out. Waiting for the slowest of these would outlast the ringing: an integrator's pole decays in seconds,
a mode in tenths. So all are fitted together to what is seen, and the settling ones are taken off. What neither explains counts as
vibration, since a joint that friction holds rings at other frequencies.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from controllers.errors import DesignError
from controllers.shapers.conditions import LIGHTLY_DAMPED
from controllers.shapers.filter import ReferenceShaper
from controllers.shapers.sampled import AxisShaper
from controllers.trajectory import move
from hil.errors import ExperimentError
from hil.experiments.safety import Safety
from hil.machine import Machine
from hil.shaping.plans import GENTLER, GENTLEST, gentler, shaped
from hil.shaping.plants import closed_loop
from hil.shaping.poses import subject_at
from hil.shaping.shaper_design import poles_to_cancel
from hil.shaping.verdict import VARIATION, Residual
from hil.simulation import Inputs, Simulator

DRAWN = 40
"""Moves. The next one of the same kind lies within the least and the greatest of n with a probability of (n - 1) / (n + 1): 95 %."""

SIZES = (0.02, 0.25)
"""Smallest and largest move, as a share of the axis's range."""

UNRANGED = 1.0
"""Range [rad or m] that is taken of an axis without one."""

LOOKED_AT = 8.0
"""Periods of the slowest mode that the axis rings, after the transient, in which the vibration is measured."""

DISTINCT = 1e-6
"""Singular values below this share of the largest are those of settling motions that differ by nothing within that time."""


@dataclass(frozen=True)
class DrawnMove:
    """A move of one axis, and by which share the machine's frequencies are off."""

    raw: np.ndarray  # (N, n_axes), standing from `arrived` on
    shaped: np.ndarray  # (N, n_axes)
    arrived: int  # row
    detuned: float


class Prediction:
    """Drawn moves of one axis from a pose, simulated without a shaper and with one.

    Parameters
    ----------
    machine : Machine
        Its effects are in the simulation.
    axis : str
    pose : (n_axes,) array
    seed : int
        Of the moves.

    Raises
    ------
    DesignError
        The axis has no limits of speed, acceleration or jerk, or rings no mode.
    """

    def __init__(self, machine: Machine, axis: str, pose: np.ndarray, seed: int = 0) -> None:
        imus = tuple(replace(each, accelerometer_resolution_m_s2=0.0, gyro_resolution_rad_s=0.0) for each in machine.plant.imus)
        encoders = tuple(replace(each, resolution=0.0) if each.channel.startswith("link_") else each for each in machine.plant.encoders)
        # what moves is measured, not what a sensor resolves; the motors' encoders, which the loop closes on, keep their steps
        self._machine = replace(machine, plant=replace(machine.plant, imus=imus, encoders=encoders))
        self._axis, self._index, self._pose, self._seed = axis, machine.axis_index(axis), np.asarray(pose, dtype=float), seed
        limit = machine.limits[self._index]
        if not np.isfinite([limit.speed, limit.acceleration, limit.jerk]).all():
            raise DesignError(f"{axis}: no moves can be drawn without limits of speed, acceleration and jerk")
        (ringing,) = poles_to_cancel([subject_at(self._machine, pose, axis)], machine.sample_rate_Hz)
        if not ringing:
            raise DesignError(f"no mode of {axis} rings")
        self._looked_at = math.ceil(LOOKED_AT * 2.0 * np.pi / min(map(abs, ringing)) * machine.sample_rate_Hz)

    def left(self, shaper: AxisShaper) -> tuple[np.ndarray, float]:
        """Return what moves leave with the shaper (moves,), as shares of the rms that all leave without one, and that.

        Raises
        ------
        DesignError
            The axis stands still after every move, or no move is gentle enough for the shaper.
        """
        moves = planned_moves(self._machine, self._axis, self._pose, shaper, shaper.transient_samples + self._looked_at + 1, self._seed)
        left = np.array([self._of(each, shaper) for each in moves])
        whole = float(np.sqrt(np.mean(left[:, 0] ** 2)))
        # over all moves together: where friction holds the axis after some of them, those leave nothing that a share could be taken of
        if not whole > 0.0:
            raise DesignError(f"nothing of {self._axis} moves after a move, shaped or not")
        return left[:, 1] / whole, whole

    def of(self, shaper: AxisShaper) -> Residual:
        """Return what the shaper leaves: least, median and greatest share over the moves."""
        shares, rms = self.left(shaper)
        unit = "m/s^2" if self._machine.plant.imus else f"{self._machine.limits[self._index].unit}/s^2"
        least, median, greatest = (float(np.quantile(shares, at)) for at in (0.0, 0.5, 1.0))
        return Residual(least, median, greatest, len(shares), rms, unit)

    def _of(self, move: DrawnMove, shaper: AxisShaper) -> tuple[float, float]:
        machine = detuned(self._machine, move.detuned)
        after = _After(Simulator(machine), closed_loop(machine, move.raw[-1], self._axis, "motor").poles)
        begins = move.arrived, move.arrived + shaper.transient_samples
        plain, with_it = (self._vibration(after, each, row) for each, row in zip((move.raw, move.shaped), begins, strict=True))
        return plain, with_it

    def _vibration(self, of: _After, reference: np.ndarray, begin: int) -> float:
        """Return the rms acceleration without settling from a row on: by all IMUs, or by the axis's encoder where there is none."""
        still = np.zeros_like(reference)
        outputs = of.simulator.run(Inputs(reference, still, still, None, reference[0].copy()))
        n = self._machine.plant.imus
        if n:
            seen = np.hstack([outputs.imu[:, 6 * k : 6 * k + 3] for k in range(len(n))])
        else:
            position = outputs.link_position if np.isfinite(outputs.link_position[:, self._index]).all() else outputs.position
            seen = np.gradient(np.gradient(position[:, [self._index]], axis=0), axis=0) * self._machine.sample_rate_Hz**2
        rows = seen[begin : begin + self._looked_at]
        return float(np.sqrt(np.mean(without_settling(rows, of.poles, 1.0 / self._machine.sample_rate_Hz) ** 2)))


@dataclass(frozen=True)
class _After:
    """A machine, with the poles of its loop where a move ends."""

    simulator: Simulator
    poles: np.ndarray


def without_settling(rows: np.ndarray, poles: np.ndarray, period_s: float) -> np.ndarray:
    """Return motion (N, k) after a move without that of a loop's poles [rad/s] that do not ring, and without its trend."""
    rows = rows - np.mean(rows, axis=0)  # gravity is ten thousand times as large as vibration, which rounding of the fit would drown
    time_s = period_s * np.arange(len(rows))[:, None]
    upper = poles[poles.imag >= 0.0]
    rings = -upper.real < LIGHTLY_DAMPED * np.abs(upper)
    settling = np.hstack([(time_s / time_s[-1]) ** np.arange(3), _decaying(time_s, upper[~rings])])
    weights = np.linalg.lstsq(np.hstack([settling, _decaying(time_s, upper[rings])]), rows, rcond=DISTINCT)[0]
    left: np.ndarray = rows - settling @ weights[: settling.shape[1]]
    return left


def _decaying(time_s: np.ndarray, poles: np.ndarray) -> np.ndarray:
    """Return e^(p t) of poles (m,) at times (N, 1), its real and imaginary parts (N, 2 m)."""
    terms = np.exp(time_s * poles)
    return np.hstack([terms.real, terms.imag])


def planned_moves(
    machine: Machine, axis: str, pose: np.ndarray, shaper: AxisShaper, standing: int, seed: int = 0, count: int = DRAWN
) -> list[DrawnMove]:
    """Draw moves of one axis that begin at a pose and stand for so many rows at their end.

    As `run` plans them: with so little acceleration and jerk that the shaped reference keeps all limits.

    Raises
    ------
    DesignError
        Not even the gentlest moves keep them.
    """
    generator, index, rate_Hz = np.random.default_rng(seed), machine.axis_index(axis), machine.sample_rate_Hz
    lower, upper = machine.limits[index].lower, machine.limits[index].upper
    span = upper - lower if np.isfinite(upper - lower) else UNRANGED
    goals, detunes = [], []
    for _ in range(count):
        size = span * generator.uniform(*SIZES)
        detunes.append(float(generator.uniform(VARIATION[0], VARIATION[-1])))
        sign = 1.0 if generator.random() < 0.5 else -1.0
        goals.append(pose + sign * size * (np.arange(len(pose)) == index))
        if not lower <= goals[-1][index] <= upper:
            goals[-1] = 2.0 * pose - goals[-1]
    running, safety, share = ReferenceShaper(machine.axes, [shaper], machine.limits, rate_Hz), Safety(machine, pose), 1.0
    while share >= GENTLEST:
        limits, found = gentler(machine, share).limits, []
        for goal, detune in zip(goals, detunes, strict=True):
            path = move(pose, goal, limits, rate_Hz).position
            raw = np.vstack([path, np.tile(path[-1], (standing, 1))])
            reference, held = shaped(running, raw, pose)
            if held >= 0 or not _keeps(safety, reference):
                break
            found.append(DrawnMove(raw, reference, len(path), detune))
        if len(found) == count:
            return found
        share *= GENTLER
    raise DesignError(f"{axis}: a shaped reference would exceed its limits even with {GENTLEST:.0%} of acceleration and jerk")


def _keeps(safety: Safety, reference: np.ndarray) -> bool:
    try:
        safety.check_reference("move", reference)
    except ExperimentError:
        return False
    return True


def detuned(machine: Machine, share: float) -> Machine:
    """Return a machine whose frequencies are off by a share: its springs by the square of it, structural modes by itself."""
    plant, driven = machine.plant, {drive.joint for drive in machine.plant.drives}
    bodies = tuple(
        body
        if body.joint is None or body.joint.name in driven
        else replace(body, joint=replace(body.joint, stiffness=body.joint.stiffness * (1.0 + share) ** 2))
        for body in plant.tree.bodies
    )
    effects = tuple(
        replace(each, parameters={**each.parameters, "f": each.parameters["f"] * (1.0 + share)}) if each.name == "structural_mode" else each
        for each in plant.effects
    )
    return replace(machine, plant=replace(plant, tree=replace(plant.tree, bodies=bodies), effects=effects))
