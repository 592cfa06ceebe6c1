"""Judging on recordings that nothing was fitted to.

The effects stay as they were fitted. The machine file's numbers may move within what the training recordings left open of them: a number
that training could not see is no evidence against a name when the held-out motion shows it. How far they move is asked of the simulation
itself, not of its sensitivities at the tuned numbers: sweeps about one pose leave numbers of the C-arm open to 5 and 10 %, over which a
mode's answer is not linear, and what a linear answer misses stands out of the noise by thousands.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property, partial

import numpy as np

from hil.diagnosis.fitting.refit import WORTH_LINEARISING, Answers, Fitted, are_costly
from hil.diagnosis.residuals.own_lines import own_lines
from hil.diagnosis.tuning.free_run import HELD_OUT, TRAIN, WORTH_A_BATCH, FreeRuns, Trial
from hil.diagnosis.tuning.retune import LARGEST_CHANGE, PRIOR, Tuning, bounded_step, quick_sensitivities
from virtual_bus.settings import EffectSetting

OPEN = 10.0
"""Factor on the variances that the training recordings leave the tuned numbers: the noise along their responses is larger than the model's
in places, and where it is not they are known well all the same. Of 1, 2, 4, 10 and 30 it is the one from which on held-out falls become no
rarer where nothing is hidden; of the deviations of true effects it takes less than a tenth, a fifth where a number imitates them. What is
known of the numbers beforehand is no noise and stays as it is."""

STEPS = 20
HALVED_AT_MOST = 5
SETTLED = 0.3
"""Expected decrease of the misfit, in units of noise, below which the numbers are where the recordings want them."""

FAIR = 0.3
"""Share of the expected decrease below which sensitivities are taken anew. Where these are costly (`are_costly`) and less than
WORTH_LINEARISING is expected, only if they are not the run's own (`_hold`): a set may end so much above its least, and by which of them it
ends depends on the sets followed before. On a C-arm the likeliest set, asked again with its own, came down by 3.0 and the next one by 1.4:
1.6 of what tells them apart, 0.8 in log evidence where nothing else errs."""

LINEARISED_AGAIN = 5
"""Times at most for a set of effects, which begins with sensitivities of another run."""

KEPT = 2
"""Sensitivities kept of the sets followed last, where they are costly, and so most of what following costs: sets that compete are often
alike. 67 MB each for a minute of the C-arm."""

ALIKE = 0.01
"""Energy, per entry in units of noise, up to which a run that differs from the one whose sensitivities were taken has them too. Numbers
that are nearly degenerate, masses, springs and constants scaled alike, move by small differences of large sensitivities: beside four times
the viscous friction, whose run differs by 9, they seem settled 1130 above the misfit that sensitivities taken there lead to, and after a
step with these 1070 above it still."""


TWICE = 2.0
"""Where a run is quadratic in its numbers, sensitivities change along a step by twice what they missed of it."""

NOT_FOLLOWED = 1e300
"""Misfit of what cannot be simulated along the held-out motion."""

_Name = tuple[bytes, tuple[object, ...]]


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


@dataclass(frozen=True, eq=False)
class _Sensitivities:
    """Of the whitened free run with the tuned coordinates.

    Attributes
    ----------
    at : (P,) array
        Tuned coordinates that they were taken at.
    predicted : (M,) array
        The run there.
    jacobian : (M, P) array
    """

    at: np.ndarray
    predicted: np.ndarray
    jacobian: np.ndarray

    @cached_property
    def square(self) -> np.ndarray:
        """(P, P) of them."""
        return self.jacobian.T @ self.jacobian

    def difference(self, predicted: np.ndarray) -> float:
        """Energy, in units of noise, by which another run differs from theirs."""
        return float(np.sum((predicted - self.predicted) ** 2))

    def missed(self, at: np.ndarray, predicted: np.ndarray) -> float:
        """Energy by which it differs otherwise than they say."""
        return float(np.sum((predicted - self.predicted - self.jacobian @ (at - self.at)) ** 2))


class HeldOut:
    """The held-out groups seen from a tuning.

    The misfit of a set of effects is min over d of |measured - f(offset + d)|^2 + d' W d with W = J'J / OPEN + 1, J the sensitivities of
    the training recordings: where f is linear, residual' (1 + K W^-1 K')^-1 residual, K its sensitivities, the misfit under a prediction
    whose numbers have the covariance W^-1.
    """

    def __init__(self, runs: FreeRuns, tuning: Tuning) -> None:
        self._runs = runs
        self._tuning = tuning
        self._begin()

    def _begin(self) -> None:
        runs, tuning = self._runs, self._tuning
        self.measured = runs.measured(HELD_OUT)
        self._weights = tuning.jacobian.T @ tuning.jacobian / OPEN + np.eye(len(tuning.offset))
        self._moved = np.zeros(len(tuning.offset))  # of the machine without effects
        self._without_effects: _Sensitivities | None = None
        self._is_large = are_costly(tuning)
        self._worth = WORTH_LINEARISING if self._is_large else SETTLED
        self._beside_effects: deque[_Sensitivities] = deque(maxlen=KEPT if self._is_large else 0)
        self._followed: dict[_Name, Followed | None] = {}
        self._begun: dict[_Name, Callable[[], Answers]] = {}
        at = self._at(tuning.offset, self._moved, ())
        for _ in range(STEPS):
            if at is None:
                break
            self._moved, self._without_effects = at.moved, self._sensitivities(tuning.offset, at, ())
            at, _, _ = self._stepped(tuning.offset, at, (), self._without_effects)

    def leave_out_own_lines(self, fits: Sequence[Fitted]) -> bool:
        """Count lines that only these recordings have, and none of the fits explains, by their own power (`own_lines.py`).

        Returns
        -------
        bool
            Whether there are any: all that was followed before is followed anew.
        """
        runs, none = self._runs, self.follow(self._tuning.offset, ())
        if none is None:
            return False
        self.expect(fits)
        there, here = [runs.measured() - self._tuning.predicted], [self.measured - none.predicted]
        for fit in fits:
            followed = self.follow(fit.offset, fit.settings)
            if followed is not None:
                there.append(runs.measured() - fit.predicted)
                here.append(self.measured - followed.predicted)
        held_out = list(zip(*(runs.by_group(one, HELD_OUT) for one in here), strict=True))
        training = list(zip(*(runs.by_group(one, TRAIN) for one in there), strict=True))
        weights = own_lines(held_out, training, runs.machine.sample_rate_Hz, len(runs.machine.plant.drives))
        if all(one is None for one in weights):
            return False
        runs.weigh_lines(HELD_OUT, weights)
        self._begin()
        return True

    def expect(self, fits: Sequence[Fitted]) -> None:
        """Begin with the runs that following each of these sets begins with: together they take less than one after another."""
        sets = {_named(fit.offset, fit.settings): (fit.offset, fit.settings) for fit in fits}
        new = {name: one for name, one in sets.items() if name not in self._followed and name not in self._begun}
        trials = [self._trial(offset, moved, effects) for offset, effects in new.values() for moved in self._starts(offset)]
        if len(trials) < WORTH_A_BATCH:  # they would wait, and go with the single run of a step
            return
        answers, each = cache(self._runs.begin(trials, HELD_OUT)), len(trials) // len(new)
        for number, name in enumerate(new):
            self._begun[name] = partial(_part, answers, slice(each * number, each * (number + 1)))

    def follow(self, offset: np.ndarray, effects: tuple[EffectSetting, ...]) -> Followed | None:
        """These effects at these tuned coordinates; None where they cannot be simulated. A set that was chosen is asked for again."""
        asked = _named(offset, effects)
        if asked not in self._followed:
            self._followed[asked] = self._follow(offset, effects)
        return self._followed[asked]

    def _follow(self, offset: np.ndarray, effects: tuple[EffectSetting, ...]) -> Followed | None:
        starts = self._starts(offset)
        begun = self._begun.pop(_named(offset, effects), None)
        answers = self._answers(offset, starts, effects) if begun is None else begun()
        found = [one for one in self._followed_by_all(answers, starts) if one is not None]
        if not found:
            return None
        at = min(found, key=lambda one: one.misfit)
        known = [*self._beside_effects, *([] if self._without_effects is None else [self._without_effects])]
        taken = min(known, key=lambda one: one.difference(at.predicted), default=None)
        again = 0
        for _ in range(STEPS):
            if taken is None:
                taken = self._sensitivities(offset, at, effects)
                self._beside_effects.append(taken)
            better, share, expected = self._stepped(offset, at, effects, taken)
            fresh = taken.predicted is at.predicted  # taken anew they would be the same
            at = at if better is None else better
            if better is not None and share >= FAIR:
                continue
            if expected < self._worth and (fresh or self._hold(taken, offset, at)):
                break
            if not (fresh and better is None) and again < LINEARISED_AGAIN:
                taken, again = None, again + 1
            elif better is None:
                break
        return at

    def misfit(self, followed: Followed | None) -> float:
        """Of a run that could be simulated; else larger than any."""
        return NOT_FOLLOWED if followed is None else followed.misfit

    def information(self, response: np.ndarray, acts: np.ndarray) -> np.ndarray:
        """(F, F) on what changes held-out runs by these columns (M, F), the numbers that do something (P,) free to follow as the linear
        machine has it.
        """
        if self._without_effects is None:
            return response.T @ response
        jacobian, weights = self._without_effects.jacobian[:, acts], self._weights[np.ix_(acts, acts)]
        shared = jacobian.T @ response
        return response.T @ response - shared.T @ np.linalg.solve(jacobian.T @ jacobian + weights, shared)

    def change_by_numbers(self, numbers: np.ndarray, acts: np.ndarray) -> np.ndarray:
        """(M, F) change of held-out runs by columns (P, F) of tuned coordinates, those that do something, of the linear machine."""
        if self._without_effects is None:
            return np.zeros((len(self.measured), numbers.shape[1]))
        return self._without_effects.jacobian[:, acts] @ numbers[acts]

    def deviations(self, before: Followed | None, after: Followed | None) -> float:
        """How far the residual goes along a predicted change, in standard deviations of noise, or of what is left if larger.

        Of a change of length L, z deviations lower the misfit by 2 L z - L^2.
        """
        if before is None or after is None:
            return -np.inf
        squared = self.squared_change(before, after)
        level = max(1.0, after.misfit / max(len(self.measured), 1))
        return 0.5 * (before.misfit - after.misfit + squared) / np.sqrt(squared * level) if squared > 0.0 else 0.0

    def squared_change(self, before: Followed, after: Followed) -> float:
        """L^2 of a predicted change, what the numbers' move costs in it: see `deviations`."""
        change, moved = after.predicted - before.predicted, after.moved - before.moved
        return float(change @ change + moved @ self._weights @ moved)

    def _at(self, offset: np.ndarray, moved: np.ndarray, effects: tuple[EffectSetting, ...]) -> Followed | None:
        return self._followed_by_all(self._answers(offset, [moved], effects), [moved])[0]

    def _starts(self, offset: np.ndarray) -> tuple[np.ndarray, ...]:
        """Moves that following begins with: none, and that of the machine without effects."""
        bound = LARGEST_CHANGE / PRIOR
        return np.zeros(len(offset)), np.clip(offset + self._moved, -bound, bound) - offset

    def _trial(self, offset: np.ndarray, moved: np.ndarray, effects: tuple[EffectSetting, ...]) -> Trial:
        return Trial(self._tuning.at(offset + moved), effects)

    def _answers(self, offset: np.ndarray, moves: Sequence[np.ndarray], effects: tuple[EffectSetting, ...]) -> Answers:
        return self._runs.run([self._trial(offset, moved, effects) for moved in moves], HELD_OUT)

    def _followed_by_all(self, answers: Answers, moves: Sequence[np.ndarray]) -> list[Followed | None]:
        return [None if predicted is None else self._followed_by(predicted, moved) for predicted, moved in zip(answers, moves, strict=True)]

    def _followed_by(self, predicted: np.ndarray, moved: np.ndarray) -> Followed:
        residual = self.measured - predicted
        return Followed(predicted, moved, float(residual @ residual + moved @ self._weights @ moved))

    def _sensitivities(self, offset: np.ndarray, at: Followed, effects: tuple[EffectSetting, ...]) -> _Sensitivities:
        tuning = replace(self._tuning, offset=offset + at.moved)
        jacobian = quick_sensitivities(self._runs, tuning, at.predicted, effects, HELD_OUT)
        return _Sensitivities(tuning.offset, at.predicted, jacobian)

    def _hold(self, taken: _Sensitivities, offset: np.ndarray, at: Followed) -> bool:
        """Whether sensitivities are those of this run, too: of one that hardly differs, or differs as they say."""
        change = taken.difference(at.predicted)
        if self._is_large:
            change = min(change, TWICE**2 * taken.missed(offset + at.moved, at.predicted))
        return change < ALIKE * len(at.predicted)

    def _stepped(
        self, offset: np.ndarray, at: Followed, effects: tuple[EffectSetting, ...], taken: _Sensitivities
    ) -> tuple[Followed | None, float, float]:
        """After a Gauss-Newton step within the tuned numbers' bounds, halved until it helps, the share of the expected decrease that came
        of it, and that decrease; None where the numbers are where the recordings want them, or no step helps.
        """
        if not len(offset):
            return None, 1.0, 0.0
        hessian = taken.square + self._weights
        gradient = taken.jacobian.T @ (self.measured - at.predicted) - self._weights @ at.moved
        step = bounded_step(self._tuning, hessian, gradient, offset + at.moved)
        expected = float(2.0 * step @ gradient - step @ hessian @ step)
        if expected < SETTLED:
            return None, 1.0, expected
        for halved in range(HALVED_AT_MOST):
            found = self._at(offset, at.moved + 0.5**halved * step, effects)
            if found is not None and found.misfit < at.misfit:
                return found, (at.misfit - found.misfit) / expected, expected
        return None, 0.0, expected


def _named(offset: np.ndarray, effects: tuple[EffectSetting, ...]) -> _Name:
    """By which a set at these tuned coordinates is known again."""
    return offset.tobytes(), tuple((one.name, one.at, *one.parameters.items()) for one in effects)


def _part(answers: Callable[[], Answers], places: slice) -> Answers:
    return answers()[places]
