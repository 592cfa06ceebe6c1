"""Where a fit of free runs begins: the machine whose equations take, along the smoothed motion, what the drives gave.

Errors of the inverse model have no false minima, but noise of accelerations in them: numbers come out biased, and near.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hil.diagnosis.likelihood.fitting import REACH, prior
from hil.diagnosis.residuals.assumed_noise import efforts_by_encoders
from hil.diagnosis.residuals.trajectory import Motion, Trajectory
from hil.diagnosis.retuning.bounded import bounded_least_squares
from hil.diagnosis.unknowns.unknowns import Machine, Point, Unknowns
from virtual_bus.errors import EffectError

ITERATIONS = 20
CONVERGED = 1e-3
"""Share of the cost that a further step must gain."""
ROWS = 4000
"""Of all recordings, at most: neighbouring rows say the same."""
INDEPENDENT = 0.05
"""Share of the rows that are independent readings: errors of a smoothed motion go together."""
DAMPINGS = (0.0, 1e-2, 1.0, 100.0)
WEAK = 0.01
"""Share of the prior from which a second fit begins: numbers that are wrong by far lie beyond a hill of the whole prior's cost."""


class Inverse:
    """The inverse model of some recordings.

    Parameters
    ----------
    trajectories : sequence of Trajectory
    unknowns : Unknowns
    """

    def __init__(self, trajectories: Sequence[Trajectory], unknowns: Unknowns) -> None:
        self.unknowns = unknowns
        self.trajectories, self.motions = list(trajectories), [_slow(trajectory) for trajectory in trajectories]
        self._joints = sorted(trajectories[0].smooth)
        self._every = max(1, sum(trajectory.observed.rows for trajectory in trajectories) // ROWS)

    def errors(self, point: Point) -> np.ndarray:
        """Return what the motion takes less what is given (rows, followed joints)."""
        return self._errors(self.unknowns.machine(point))

    def _errors(self, machine: Machine) -> np.ndarray:
        found = []
        for trajectory, motion in zip(self.trajectories, self.motions, strict=True):
            signals = trajectory.signals(motion, trajectory.model(machine.values, machine.effects), machine.effects)
            found.append((signals.needed - signals.given)[:: self._every, self._joints])
        return np.vstack(found)

    def fits(self, point: Point) -> list[Point]:
        """Return points that leave least, from another one on, the better one first: found at once, and with hardly any prior at first."""
        floor = 1e-6 * np.mean(self.errors(point) ** 2, axis=0) + 1e-300
        found = [self._fit(point, floor, 1.0), self._fit(self._fit(point, floor, WEAK), floor, 1.0)]
        return sorted(found, key=lambda each: self._cost(self.errors(each), floor, each, 1.0))

    def _columns(self, point: Point, errors: np.ndarray) -> np.ndarray:
        """Return what errors change by (P, rows, joints) per unit of each unknown and parameter."""
        steps = point.steps()
        columns = np.zeros((len(steps), *errors.shape))
        for k, step in enumerate(steps):
            try:
                moved = self.errors(point.moved(np.where(np.arange(len(steps)) == k, step, 0.0)))
            except EffectError:
                continue
            columns[k] = (moved - errors) / step
        return columns

    def _fit(self, point: Point, floor: np.ndarray, share: float) -> Point:
        errors = self.errors(point)
        for _ in range(ITERATIONS):
            weight = 1.0 / (np.mean(errors**2, axis=0) + floor)
            columns = self._columns(point, errors)
            squares = INDEPENDENT * np.einsum("pnj,qnj,j->pq", columns, columns, weight, optimize=True)
            slopes = -INDEPENDENT * np.einsum("pnj,nj,j->p", columns, errors, weight, optimize=True)
            pull, stiffness = (share * each for each in prior(point))
            cost, tried = self._cost(errors, floor, point, share), []
            whole = squares + np.diag(stiffness)
            for damping in DAMPINGS:
                step = bounded_least_squares(whole + damping * np.diag(np.diag(whole)), slopes - pull, *point.room(self.unknowns, REACH))
                there = point.moved(step)
                its = self.errors(there)
                tried.append((self._cost(its, floor, there, share), there, its))
            best, there, its = min(tried, key=lambda each: each[0])
            if not best < cost - CONVERGED * abs(cost):
                return there if best < cost else point
            point, errors = there, its
        return point

    def _cost(self, errors: np.ndarray, floor: np.ndarray, point: Point, share: float) -> float:
        mean = np.mean(errors**2, axis=0) + floor
        return float(0.5 * INDEPENDENT * len(errors) * np.sum(np.log(mean)) + share * np.sum(np.log1p(point.numbers**2)))


def _slow(trajectory: Trajectory) -> Motion:
    """Return the motion with the slow accelerations that encoders show: what is faster is noise for the most part."""
    motion = efforts_by_encoders(trajectory)[0]
    for joint, one in trajectory.smooth.items():
        motion.acceleration[:, joint] = one.slow[:, 2]
    return motion
