"""Re-tuning of the machine file's own numbers: masses, inertias, centres of mass, springs, dampers, drive constants, IMU low passes.

Parameters are counted from their nominal value in units of their prior, PRIOR of it or CLOCKED_PRIOR. The free-run residual in units of
noise is made small together with that weak prior (Gaussian), so that a number the recordings do not show stays where the machine file has
it; beyond LARGEST_CHANGE it is no longer tuning but physics the file does not have. Gauss-Newton within bounds and a trust region; Nocedal
and Wright 2006, ch. 4 and 10. Where that ends far from the noise it begins once more, what is left counted as noise until it is near.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from hil.diagnosis.tuning.free_run import TRAIN, FreeRuns, Trial
from hil.diagnosis.tuning.least_squares import least_within
from hil.diagnosis.tuning.rigid_bodies import Shortage, rigid, shortages, some_are_short
from hil.errors import BadAnswerError
from virtual_bus.plant.parameters import PlantParameter
from virtual_bus.plant.same import Same
from virtual_bus.settings import EffectSetting

PRIOR = 0.1
"""Standard deviation of a nominal number, as a share of it."""

LARGEST_CHANGE = 0.15
"""As a share of the nominal value, of a number whose prior is PRIOR: one and a half times its prior of any."""

CLOCKED = ("accelerometer_bandwidth", "gyro_bandwidth")
CLOCKED_PRIOR = 0.02
"""Prior of corners that a sensor's clock makes: data sheets say 1 to 3 % of it. What lags by more than that is the effect of that name."""

DIFFERENCE = 1e-4
"""Of quick sensitivities, in units of a number's prior. Their error is in proportion to it, and along directions in which a machine hardly
changes large columns take each other away: of a hundredth, 54 columns of the C-arm say that the way to its truth leads uphill, and
re-tuning stops 1800 units of noise short of it. Of a hundredth of this, rounding is as large."""

FINE_DIFFERENCE = 5e-3
"""Of those that intervals are computed from, central ones: their error is in proportion to its square."""

INVISIBLE = 0.05
"""A parameter whose whole prior moves the simulation by less than this in units of noise, summed over the record, is not shown by it."""

UNDECIDED = 0.7
"""A parameter whose standard deviation is still above this share of the prior's is not determined by the recordings."""

FIRST_RADIUS = 0.3
"""Of the first step in every tuned coordinate, in units of its prior. Without one, the first step of a machine with lightly damped modes
runs into the bounds, and the search ends at 1.3 times the noise's energy."""

GOOD, FAIR, POOR = 0.7, 0.3, 0.1
"""Shares of the expected decrease of the cost above which the radius doubles and stays, and below which the step is not taken."""

SHRINK, SHRUNK_AT_MOST = 0.3, 4

ITERATIONS = 60
"""Steps at most. Where nothing is hidden the longest searches take 19; one that turns with a lightly damped mode's narrow valley takes
35."""

SETTLED = 1e-4
SETTLED_GAIN = 0.1
"""Decrease of the cost, as a share of it and in units of noise, below which re-tuning has ended."""

HELD_BY, HELD_AT_MOST = 1e3, 8
"""Weight of what holds a body rigid in a step, over the largest of the others, and times at most that a step is held."""

FAR = 2.0
"""Misfit, in units of the noise's, above which re-tuning begins once more. Coming near the noise, it has found the machine."""

ALIKE = 100.0
"""Rows that err alike: a simulation that is far off leaves no noise but its own errors, of which so many rows are one. Counted as noise row
by row, they drive numbers that hardly show beside gross motion to their bounds, from where a lightly damped mode that rings at another
frequency finds no way back. Of two C-arms with nothing hidden that end at 2.6 and 5.2 times the noise without this, the first one comes
near it with 1, neither with 10, both with 100."""

APPROACHED = 1e-3
"""Share of the cost by which a step must lower it for the approach to go on."""

LARGE_STEP = 0.05
"""In units of a number's prior: a longer way, by one step or by several, asks for new sensitivities."""

TUNED = ("mass", "center_of_mass", "inertia", "stiffness", "damping", "armature", "constant", "accelerometer_bandwidth", "gyro_bandwidth")


@dataclass(frozen=True, eq=False)
class Tuning:
    """A machine's numbers after re-tuning.

    Attributes
    ----------
    indices : (P,) int array
        Which plant parameters were tuned.
    scale : (P,) array
        One unit of the tuned coordinates.
    offset : (P,) array
        Tuned coordinates.
    values : (all parameters,) array
    predicted : (M,) array
        Whitened free run at `values`.
    jacobian : (M, P) array
        Of the prediction with the tuned coordinates.
    covariance : (P, P) array
        Of the tuned coordinates, prior included.
    """

    parameters: tuple[PlantParameter, ...]
    indices: np.ndarray
    scale: np.ndarray
    offset: np.ndarray
    values: np.ndarray
    predicted: np.ndarray
    jacobian: np.ndarray
    covariance: np.ndarray

    def at(self, offset: np.ndarray) -> np.ndarray:
        """Plant parameters at these tuned coordinates, every body a rigid one."""
        return rigid(self.parameters, self._said(offset))

    def shortages(self, offset: np.ndarray) -> list[Shortage]:
        """Of bodies that are none at these tuned coordinates."""
        return shortages(self.parameters, self._said(offset))

    def some_are_short(self, offsets: np.ndarray) -> np.ndarray:
        """(K,) whether bodies are none at each of these tuned coordinates (K, P)."""
        return some_are_short(self.parameters, np.stack([self._said(offset) for offset in offsets]))

    def _said(self, offset: np.ndarray) -> np.ndarray:
        values = _nominal(Same(self.parameters)).copy()
        values[self.indices] += offset * self.scale
        return values

    @property
    def names(self) -> list[str]:
        return [f"{self.parameters[i].owner}.{self.parameters[i].quantity}" for i in self.indices]


@lru_cache(maxsize=16)
def _nominal(parameters: Same[tuple[PlantParameter, ...]]) -> np.ndarray:
    return np.array([parameter.value for parameter in parameters.it])


def tunable(parameters: Sequence[PlantParameter]) -> np.ndarray:
    """(P,) indices of the plant parameters that re-tuning may change."""
    return np.array(
        [k for k, p in enumerate(parameters) if p.tolerance is not None or (p.quantity.startswith(TUNED) and p.value != 0.0)], dtype=int
    )


def units(parameters: Sequence[PlantParameter], indices: np.ndarray) -> np.ndarray:
    """(P,) one unit of these tuned coordinates: the number's prior."""
    shares = [CLOCKED_PRIOR if parameters[k].quantity.startswith(CLOCKED) else PRIOR for k in indices]
    stated = [parameters[k].tolerance for k in indices]
    return np.array(
        [
            share * abs(parameters[k].value) if tolerance is None else tolerance * PRIOR / LARGEST_CHANGE
            for k, share, tolerance in zip(indices, shares, stated, strict=True)
        ]
    )


def retune(runs: FreeRuns) -> Tuning:
    """Tune all of them to the training groups.

    Raises
    ------
    BadAnswerError
        The nominal machine cannot be simulated.
    """
    indices = tunable(runs.parameters)
    scale = units(runs.parameters, indices)
    runs.correct(Trial(runs.nominal))
    measured, predicted = runs.measured(), runs.run_one(Trial(runs.nominal))
    if predicted is None:
        raise BadAnswerError(f"{runs.machine.name}: its free run cannot be simulated; check the machine with `isocenter machine check`")
    tuning = Tuning(
        runs.parameters, indices, scale, np.zeros(len(indices)), runs.nominal, predicted,
        np.zeros((len(predicted), len(indices))), np.eye(len(indices)),
    )  # fmt: skip
    tuning = linearised(runs, tuning)
    begun = _only(tuning, np.linalg.norm(tuning.jacobian, axis=0) > INVISIBLE)
    tuning = descend(runs, begun, measured)
    if _is_far(measured, tuning):
        again = approach(runs, begun, measured)
        if not _is_far(measured, again):
            tuning = descend(runs, linearised(runs, again), measured)
    return corrected(runs, tuning)


def corrected(runs: FreeRuns, tuning: Tuning) -> Tuning:
    """With the plant steps' correction taken where re-tuning ended, re-tuned once more."""
    runs.correct(Trial(tuning.values))
    predicted = runs.run_one(Trial(tuning.values))
    if predicted is not None:
        tuning = descend(runs, linearised(runs, replace(tuning, predicted=predicted)), runs.measured())
    return with_covariance(tuning)


def approach(runs: FreeRuns, tuning: Tuning, measured: np.ndarray) -> Tuning:
    """Come near the noise from these values, what is left meanwhile counted as noise (ALIKE)."""
    radius = FIRST_RADIUS
    for _ in range(ITERATIONS):
        weight = 1.0 / max(1.0, ALIKE * float(np.mean((measured - tuning.predicted) ** 2)))
        cost = _cost(measured, tuning.predicted, tuning.offset, weight)
        found = _trusted_step(runs, tuning, measured, cost, radius, (), weight)
        if found is None:
            break
        tuning, left, radius = found
        if not _is_far(measured, tuning) or cost - left < APPROACHED * cost:
            break
        tuning = linearised(runs, tuning)
    return tuning


def descend(runs: FreeRuns, tuning: Tuning, measured: np.ndarray, effects: tuple[EffectSetting, ...] = ()) -> Tuning:
    """Gauss-Newton in a trust region from these values, beside effects that stay as they are.

    Sensitivities are taken anew once steps with them have come far, or where they bring less than they say: thirty small steps with old
    ones can stop 250 units of noise short, which an effect that nobody hid then gains.
    """
    cost = _cost(measured, tuning.predicted, tuning.offset)
    radius, moved = FIRST_RADIUS, 0.0
    fresh = True
    for _ in range(ITERATIONS):
        found = _trusted_step(runs, tuning, measured, cost, radius, effects)
        settled = found is None or cost - found[1] < max(SETTLED * cost, SETTLED_GAIN)
        is_poor = found is None or found[2] <= radius
        if found is not None:
            moved += float(np.abs(found[0].offset - tuning.offset).max(initial=0.0))
            tuning, cost, radius = found
        if settled and fresh:
            break
        fresh = settled or is_poor or moved > LARGE_STEP
        if fresh:
            tuning, moved = linearised(runs, tuning, effects), 0.0
    return tuning


def linearised(runs: FreeRuns, tuning: Tuning, effects: tuple[EffectSetting, ...] = ()) -> Tuning:
    """With the sensitivities at its present values."""
    return replace(tuning, jacobian=quick_sensitivities(runs, tuning, tuning.predicted, effects))


def quick_sensitivities(
    runs: FreeRuns, tuning: Tuning, predicted: np.ndarray, effects: tuple[EffectSetting, ...] = (), name: str = TRAIN
) -> np.ndarray:
    """(M, P) of the whitened free run with the tuned coordinates, by differences towards nominal: never beyond the bounds."""
    trials, differences = sensitivity_trials(tuning, tuning.offset, effects)
    return sensitivities_from(runs.run(trials, name), differences, predicted)


def sensitivity_trials(tuning: Tuning, offset: np.ndarray, effects: tuple[EffectSetting, ...]) -> tuple[list[Trial], np.ndarray]:
    """A trial for every tuned coordinate, and (P,) how far each is moved."""
    differences = np.where(offset > 0.0, -DIFFERENCE, DIFFERENCE)
    if len(offset):  # what keeps a body a rigid one would be taken for the machine's answer
        differences[tuning.some_are_short(offset + np.diag(differences))] *= -1.0
    return [Trial(tuning.at(offset + move), effects) for move in np.diag(differences)], differences


def sensitivities_from(answers: Sequence[np.ndarray | None], differences: np.ndarray, predicted: np.ndarray) -> np.ndarray:
    """(M, P) of those trials' answers."""
    columns = np.empty((len(differences), len(predicted)))
    for column, answer, difference in zip(columns, answers, differences, strict=True):
        if answer is None:
            column[:] = 0.0
        else:
            np.subtract(answer, predicted, out=column)
            column /= difference
    return columns.T  # which are written and multiplied


def sensitivities(runs: FreeRuns, tuning: Tuning, offset: np.ndarray, effects: tuple[EffectSetting, ...]) -> np.ndarray:
    """(M, P) of the tuned coordinates at an offset and beside effects, by central differences.

    One-sided ones make directions look determined that are not, such as all numbers of a machine scaled alike: the columns are large, and
    it is their small differences that count.
    """
    units = FINE_DIFFERENCE * np.eye(len(offset))
    answers = runs.run([Trial(tuning.at(offset + way * unit), effects) for unit in units for way in (1.0, -1.0)])
    jacobian = np.zeros((len(offset), len(tuning.predicted))).T
    for k, (up, down) in enumerate(zip(answers[::2], answers[1::2], strict=True)):
        if up is not None and down is not None:
            jacobian[:, k] = (up - down) / (2.0 * FINE_DIFFERENCE)
    return jacobian


def bounded_step(tuning: Tuning, hessian: np.ndarray, gradient: np.ndarray, offset: np.ndarray, radius: float = np.inf) -> np.ndarray:
    """Change of the tuned coordinates that lowers |residual|^2 most within LARGEST_CHANGE, in each of them the radius, and rigid bodies.

    A step that ends where a body is none is taken again with that body's least second moment held at its end.
    """
    if not len(offset):
        return np.zeros(0)
    rows = np.linalg.cholesky(hessian).T
    wanted = np.linalg.solve(rows.T, gradient)
    heavy = HELD_BY * float(np.sqrt(hessian.diagonal().max()))
    bound = LARGEST_CHANGE / PRIOR
    low, high = np.minimum(np.maximum(-bound - offset, -radius), -1e-9), np.maximum(np.minimum(bound - offset, radius), 1e-9)
    place = {int(index): k for k, index in enumerate(tuning.indices)}
    for _ in range(HELD_AT_MOST):
        step = least_within(rows, wanted, low, high)
        found = tuning.shortages(offset + step)
        if not found:
            break
        for short in found:
            slopes = np.zeros(len(step))
            for index, slope in zip(short.places, short.slopes, strict=True):
                if int(index) in place:
                    slopes[place[int(index)]] = slope * tuning.scale[place[int(index)]]
            size = float(np.linalg.norm(slopes))
            if size > 0.0:
                rows = np.vstack([rows, heavy / size * slopes])
                wanted = np.append(wanted, heavy / size * (slopes @ step + short.missing))
    return step


def with_covariance(tuning: Tuning) -> Tuning:
    """With the covariance of the tuned coordinates from sensitivities and prior."""
    count = len(tuning.offset)
    return replace(tuning, covariance=np.linalg.inv(tuning.jacobian.T @ tuning.jacobian + np.eye(count)) if count else np.eye(0))


def _trusted_step(
    runs: FreeRuns,
    tuning: Tuning,
    measured: np.ndarray,
    cost: float,
    radius: float,
    effects: tuple[EffectSetting, ...],
    weight: float = 1.0,
) -> tuple[Tuning, float, float] | None:
    """The tuning after one step, its cost, and the radius for the next; None where no step within any radius helps.

    The radius grows while the cost falls as the sensitivities say, and shrinks where it does not (Nocedal and Wright 2006, algorithm 4.1).
    """
    if not len(tuning.offset):
        return None
    residual = measured - tuning.predicted
    hessian = weight * (tuning.jacobian.T @ tuning.jacobian) + np.eye(len(tuning.offset))
    gradient = weight * (tuning.jacobian.T @ residual) - tuning.offset
    for _ in range(SHRUNK_AT_MOST):
        step = bounded_step(tuning, hessian, gradient, tuning.offset, radius)
        expected = float(2.0 * step @ gradient - step @ hessian @ step)
        offset = tuning.offset + step
        values = tuning.at(offset)
        predicted = runs.run_one(Trial(values, effects))
        gain = -np.inf if predicted is None else cost - _cost(measured, predicted, offset, weight)
        if predicted is not None and gain > max(POOR * expected, 0.0):
            radius *= 2.0 if gain > GOOD * expected else 1.0 if gain > FAIR * expected else 0.5
            return replace(tuning, offset=offset, values=values, predicted=predicted), cost - gain, radius
        radius = SHRINK * min(radius, float(np.abs(step).max()))
    return None


def _cost(measured: np.ndarray, predicted: np.ndarray, offset: np.ndarray, weight: float = 1.0) -> float:
    return float(weight * np.sum((measured - predicted) ** 2) + np.sum(offset**2))


def _is_far(measured: np.ndarray, tuning: Tuning) -> bool:
    return float(np.sum((measured - tuning.predicted) ** 2)) > FAR * len(measured)


def _only(tuning: Tuning, chosen: np.ndarray) -> Tuning:
    return replace(
        tuning,
        indices=tuning.indices[chosen],
        scale=tuning.scale[chosen],
        offset=tuning.offset[chosen],
        jacobian=tuning.jacobian[:, chosen],
    )
