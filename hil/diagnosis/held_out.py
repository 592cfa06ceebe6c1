"""Judging on recordings that nothing was fitted to.

The effects stay as they were fitted. The machine file's numbers may move within what the training recordings left open of them: a number
that training could not see is no evidence against a name when the held-out motion shows it. How far they move is asked of the simulation
itself, not of its sensitivities at the tuned numbers: sweeps about one pose leave numbers of the C-arm open to 5 and 10 %, over which a
mode's answer is no longer linear, and what the linear answer was short of stood out of the noise by thousands.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from hil.diagnosis.free_run import HELD_OUT, FreeRuns, Trial
from hil.diagnosis.retune import LARGEST_CHANGE, PRIOR, Tuning, bounded_step, quick_sensitivities
from virtual_bus.settings import EffectSetting

OPEN = 10.0
"""Factor on the variances that the training recordings leave the tuned numbers: the noise along their responses is larger than the model's
in places, and where it is not they are known well all the same. Of 1, 2, 4, 10 and 30 the one from which on held-out falls on development
nulls became no rarer; of the deviations of true effects it takes less than a tenth, a fifth where a number imitates them. What is known
of the numbers beforehand is no noise and stays as it is."""

STEPS = 20
HALVED_AT_MOST = 5
SETTLED = 0.3
"""Expected decrease of the misfit, in units of noise, below which the numbers are where the recordings want them."""

FAIR = 0.3
"""Share of the expected decrease below which sensitivities are taken anew."""

LINEARISED_AGAIN = 5
"""Times at most for a set of effects, which begins with the sensitivities of the machine without them."""

ALIKE = 0.01
"""Energy, per entry in units of noise, up to which a run that differs from the one whose sensitivities were taken has them too. Numbers
that are nearly degenerate, masses, springs and constants scaled alike, move by small differences of large sensitivities: beside four times
the viscous friction, whose run differs by 9, they seemed settled 1130 above the misfit that sensitivities taken there led to, and after a
step with these 1070 above it still."""


@dataclass(frozen=True, eq=False)
class Followed:
    """A held-out free run with the machine's numbers moved to where the recordings want them.

    Attributes
    ----------
    predicted : (M,) array
        Whitened.
    moved : (P,) array
        Tuned coordinates, from where training left them.
    misfit : float
        |residual|^2 and what the move costs; its expectation is the number of entries where the machine and its effects are right.
    """

    predicted: np.ndarray
    moved: np.ndarray
    misfit: float


class HeldOut:
    """The held-out groups seen from a tuning.

    The misfit of a set of effects is min over d of |measured - f(offset + d)|^2 + d' W d with W = J'J / OPEN + 1, J the sensitivities of
    the training recordings: where f is linear, residual' (1 + K W^-1 K')^-1 residual, K its sensitivities, the misfit under a prediction
    whose numbers have the covariance W^-1.
    """

    def __init__(self, runs: FreeRuns, tuning: Tuning) -> None:
        self._runs = runs
        self._tuning = tuning
        self.measured = runs.measured(HELD_OUT)
        self._weights = tuning.jacobian.T @ tuning.jacobian / OPEN + np.eye(len(tuning.offset))
        self._moved = np.zeros(len(tuning.offset))  # of the machine without effects
        self._jacobian: np.ndarray | None = None
        self._linearised: np.ndarray | None = None  # the run whose sensitivities these are
        self._followed: dict[tuple[bytes, tuple[object, ...]], Followed | None] = {}
        at = self._at(tuning.offset, self._moved, ())
        for _ in range(STEPS):
            if at is None:
                break
            self._moved, self._jacobian = at.moved, self._sensitivities(tuning.offset, at, ())
            self._linearised = at.predicted
            at, _ = self._stepped(tuning.offset, at, (), self._jacobian)

    def follow(self, offset: np.ndarray, effects: tuple[EffectSetting, ...]) -> Followed | None:
        """These effects at these tuned coordinates; None where they cannot be simulated. A set that was chosen is asked for again."""
        asked = offset.tobytes(), tuple((one.name, one.at, *one.parameters.items()) for one in effects)
        if asked not in self._followed:
            self._followed[asked] = self._follow(offset, effects)
        return self._followed[asked]

    def _follow(self, offset: np.ndarray, effects: tuple[EffectSetting, ...]) -> Followed | None:
        bound = LARGEST_CHANGE / PRIOR
        starts = np.zeros(len(offset)), np.clip(offset + self._moved, -bound, bound) - offset
        found = [one for one in (self._at(offset, moved, effects) for moved in starts) if one is not None]
        if not found:
            return None
        at = min(found, key=lambda one: one.misfit)
        jacobian, linearised, again = self._jacobian, self._linearised, 0
        for _ in range(STEPS):
            if jacobian is None:
                jacobian, linearised = self._sensitivities(offset, at, effects), at.predicted
            better, share = self._stepped(offset, at, effects, jacobian)
            at = at if better is None else better
            here = at.predicted is linearised  # taken anew they would be the same
            if again < LINEARISED_AGAIN and not here and (share < FAIR or (better is None and not _alike(at.predicted, linearised))):
                jacobian, again = None, again + 1
            elif better is None:
                break
        return at

    def misfit(self, followed: Followed | None) -> float:
        """Of a run that could be simulated; else larger than any."""
        return 1e300 if followed is None else followed.misfit

    def information(self, response: np.ndarray) -> np.ndarray:
        """(F, F) on what changes held-out runs by these columns (M, F), the numbers free to follow as the linear machine has it."""
        if self._jacobian is None:
            return response.T @ response
        shared = self._jacobian.T @ response
        return response.T @ response - shared.T @ np.linalg.solve(self._jacobian.T @ self._jacobian + self._weights, shared)

    def deviations(self, before: Followed | None, after: Followed | None) -> float:
        """How far the residual goes along a predicted change, in standard deviations of noise, or of what is left if larger.

        Of a change of length L, z deviations lower the misfit by 2 L z - L^2.
        """
        if before is None or after is None:
            return -np.inf
        change, moved = after.predicted - before.predicted, after.moved - before.moved
        squared = float(change @ change + moved @ self._weights @ moved)
        level = max(1.0, after.misfit / max(len(self.measured), 1))
        return 0.5 * (before.misfit - after.misfit + squared) / np.sqrt(squared * level) if squared > 0.0 else 0.0

    def _at(self, offset: np.ndarray, moved: np.ndarray, effects: tuple[EffectSetting, ...]) -> Followed | None:
        predicted = self._runs.run_one(Trial(self._tuning.at(offset + moved), effects), HELD_OUT)
        if predicted is None:
            return None
        residual = self.measured - predicted
        return Followed(predicted, moved, float(residual @ residual + moved @ self._weights @ moved))

    def _sensitivities(self, offset: np.ndarray, at: Followed, effects: tuple[EffectSetting, ...]) -> np.ndarray:
        tuning = replace(self._tuning, offset=offset + at.moved)
        return quick_sensitivities(self._runs, tuning, at.predicted, effects, HELD_OUT)

    def _stepped(
        self, offset: np.ndarray, at: Followed, effects: tuple[EffectSetting, ...], jacobian: np.ndarray
    ) -> tuple[Followed | None, float]:
        """After a Gauss-Newton step within the tuned numbers' bounds, halved until it helps, and the share of the expected decrease that
        came of it; None where the numbers are where the recordings want them, or no step helps.
        """
        if not len(offset):
            return None, 1.0
        hessian = jacobian.T @ jacobian + self._weights
        gradient = jacobian.T @ (self.measured - at.predicted) - self._weights @ at.moved
        step = bounded_step(self._tuning, hessian, gradient, offset + at.moved)
        expected = float(2.0 * step @ gradient - step @ hessian @ step)
        if expected < SETTLED:
            return None, 1.0
        for halved in range(HALVED_AT_MOST):
            found = self._at(offset, at.moved + 0.5**halved * step, effects)
            if found is not None and found.misfit < at.misfit:
                return found, (at.misfit - found.misfit) / expected
        return None, 0.0


def _alike(predicted: np.ndarray, linearised: np.ndarray | None) -> bool:
    """Whether sensitivities hold for a run that were taken of another."""
    return linearised is not None and float(np.sum((predicted - linearised) ** 2)) < ALIKE * len(predicted)
