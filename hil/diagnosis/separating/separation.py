"""How far apart an experiment puts hypotheses.

What of the difference of the free runs of A and B no local refit of B takes away, where A is right:

    d^2 = min over changes p of |W (y_A - y_B(p))|^2 + |p_tuned|^2

with W the whitening of the noise that the recordings showed, p B's tuned numbers and effect parameters, and the prior of re-tuning on the
former; Gauss-Newton steps find the minimum. d is a distance in standard deviations of the noise of one recording: the misfit of B,
refitted to a recording of A, exceeds that of A by d^2 on average. Where B is right, A is refitted instead: a law that has another one as
its special case follows it wherever it goes, d = 0, and is told from it only in the other direction. |W (y_A - y_B)| is never smaller than
either and needs no sensitivities. A is the likeliest hypothesis so far, B each of its rivals. Sensitivities of tuned numbers are taken at A
for all of them: a small effect hardly changes them.
"""

from __future__ import annotations

import threading
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from types import TracebackType

import numpy as np

from hil.diagnosis.fitting.coordinates import ORDER_UNIT
from hil.diagnosis.fitting.refit import Fitted
from hil.diagnosis.residuals.carried import CarriedImu, carried_imu
from hil.diagnosis.residuals.noise import NoiseModel
from hil.diagnosis.starting.candidates import setting_of
from hil.diagnosis.tuning.least_squares import least_within
from hil.diagnosis.tuning.retune import LARGEST_CHANGE, PRIOR, Tuning
from hil.errors import BadAnswerError
from hil.experiments import Plan
from hil.machine import Machine
from hil.simulation import Inputs, Simulator
from hil.simulation.smooth import simulated_matrix, smooth
from virtual_bus.effects.effect import Parameter
from virtual_bus.effects.registry import effects
from virtual_bus.plant.lanes import LANES
from virtual_bus.settings import EffectSetting

TUNED_STEP = 0.1
"""Of the sensitivities, in units of the prior."""

EFFECT_STEP = 0.02
"""Of the sensitivities, as a share of a parameter."""

ROUNDS = 3
"""Gauss-Newton steps of a refit at most. One alone leaves some per cent of the distance that it goes."""

LARGEST_STEP = 1.0
"""Of a tuned number in one round, in units of its prior: sensitivities hold about there."""

DECIDED = 2.0
"""Standard deviations from which a strength is not zero."""

SETTLED = 0.01
"""Of d^2: a step that brings less is not taken."""


@dataclass(frozen=True, eq=False)
class Model:
    """One hypothesis as a simulation with free numbers.

    Attributes
    ----------
    values : (parameters,) array
        Of the plant.
    effects : tuple of EffectSetting
    indices, scale : (P,) arrays
        Tuned plant parameters and one unit of their prior.
    free : tuple of (effect number, parameter name)
    name : str
        What it is called in an experiment's file.
    """

    values: np.ndarray
    effects: tuple[EffectSetting, ...]
    indices: np.ndarray
    scale: np.ndarray
    free: tuple[tuple[int, str], ...]
    name: str = ""

    @classmethod
    def of(cls, tuning: Tuning, fitted: Fitted) -> Model:
        """The model that a fit describes, without what it does not need (`_needed`)."""
        offset, own = _needed(tuning, fitted)
        settings = tuple(setting_of(effect, values) for effect, values in zip(fitted.effects, own, strict=True))
        free = tuple((e, effects()[fitted.effects[e].effect].parameters[k].name) for e, k in fitted.free)
        name = " and ".join(str(effect) for effect in fitted.effects)
        return cls(tuning.at(offset), settings, tuning.indices, tuning.scale, free, name)

    def tuned_moves(self, plan: Plan) -> list[_Task]:
        """A run with each tuned number moved by TUNED_STEP of its prior."""
        found = []
        for index, scale in zip(self.indices, self.scale, strict=True):
            values = self.values.copy()
            values[index] += TUNED_STEP * scale
            found.append(_Task(values, self.effects, plan))
        return found

    def at(self, change: np.ndarray) -> Model:
        """With its numbers changed within `bounds`: (P + F,) tuned ones in units of their prior, the effects' in units of their size."""
        tuned = len(self.indices)
        values = self.values.copy()
        values[self.indices] += change[:tuned] * self.scale
        changed = self.effects
        for (number, name), move in zip(self.free, change[tuned:], strict=True):
            parameter, size = _parameter(changed[number], name), _size(self.effects[number], name)
            value = np.clip(changed[number].parameters[name] + move * size, parameter.low, parameter.high)
            changed = _with(changed, number, name, float(value))
        return replace(self, values=values, effects=changed)

    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """(P + F,) each, least and largest change of its numbers in one round: LARGEST_STEP, and what an effect's parameter may be."""
        least, most = [-LARGEST_STEP] * len(self.indices), [LARGEST_STEP] * len(self.indices)
        for number, name in self.free:
            parameter, size = _parameter(self.effects[number], name), _size(self.effects[number], name)
            value = self.effects[number].parameters[name]
            least.append((parameter.low - value) / size)
            most.append((parameter.high - value) / size)
        return np.array(least), np.array(most)

    def effect_moves(self, plan: Plan) -> list[tuple[_Task, float]]:
        """A run with each of the effects' free numbers moved, and by how much in units of its size."""
        found = []
        for number, name in self.free:
            changed, step = _moved(self.effects, number, name)
            found.append((_Task(self.values, changed, plan), step))
        return found


@dataclass(frozen=True, eq=False)
class Distances:
    """How far apart a plan puts the first model and its rivals.

    Attributes
    ----------
    separations : (rivals, 2) array
        d where the first model is right, and where the rival is; 0 where a model cannot be simulated.
    removed : float
        |residual|^2 that the first model's effects take away from a recording of it.
    """

    separations: np.ndarray
    removed: float


@dataclass(frozen=True, eq=False)
class _Task:
    """One free run of a plan."""

    values: np.ndarray
    effects: tuple[EffectSetting, ...]
    plan: Plan


class _Runner:
    """Whitened free runs of plans."""

    def __init__(self, machine: Machine, noise: NoiseModel, channels: tuple[str, ...]) -> None:
        self._machine = machine
        self._noise = noise
        self._channels = channels
        self._simulator = Simulator(smooth(machine))
        self._along: tuple[bytes, CarriedImu | None] = b"", None

    def answers(self, tasks: Sequence[_Task]) -> list[np.ndarray | None]:
        """(M,) of tasks of one plan; None where one cannot be simulated."""
        plan = tasks[0].plan
        still = np.zeros_like(plan.reference)
        inputs = Inputs(plan.reference, plan.excitation, still if plan.feedforward is None else plan.feedforward, None, plan.start_pose)
        machines = [(task.values, (*self._machine.plant.effects, *task.effects)) for task in tasks]
        outputs = self._simulator.run_all(inputs, machines)
        return [
            None if isinstance(one, Exception) else self.whitened(plan, simulated_matrix(self._machine, one, self._channels))
            for one in outputs
        ]

    def whitened(self, plan: Plan, rows: np.ndarray) -> np.ndarray:
        """(M,) of a plan's channels (N, C)."""
        reference = plan.reference[_kept(plan) :]
        key = reference.tobytes()
        if self._along[0] != key:  # a plan's runs come one after the other
            self._along = key, carried_imu(self._machine, self._channels, reference)
        return self._noise.of_mean(1).whiten(rows[_kept(plan) :], self._along[1])


class Separation:
    """Predicted separation of hypotheses by any plan.

    Parameters
    ----------
    machine : Machine
    models : sequence of Model
        The likeliest first; each other one is held against it.
    noise : NoiseModel
    channels : tuple of str
    jobs : int
        Threads besides the caller's. 1: all in that one.

    Attributes
    ----------
    count : int
        Free runs so far.
    """

    def __init__(self, machine: Machine, models: Sequence[Model], noise: NoiseModel, channels: tuple[str, ...], jobs: int = 1) -> None:
        self.machine = machine
        self.count = 0
        self._models = models
        self._runner = _Runner(machine, noise, channels)
        self._channels = channels
        self._noise = noise
        self._pool = ThreadPoolExecutor(jobs) if jobs > 1 else None
        self._of_thread = threading.local()

    def __enter__(self) -> Separation:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        if self._pool is not None:
            self._pool.shutdown(cancel_futures=True)

    def at_most(self, plans: Sequence[Plan]) -> list[Distances]:
        """The same without a refit: no distance is larger."""
        size = len(self._models)
        tasks = [task for plan in plans for task in (*(_Task(m.values, m.effects, plan) for m in self._models), self._bare(plan))]
        answers = self._run(tasks)
        found = []
        for number in range(len(plans)):
            own = [answer for answer in answers[number * (size + 1) : (number + 1) * (size + 1)] if answer is not None]
            if len(own) < size + 1:
                found.append(self._nothing())
                continue
            far = [float(np.linalg.norm(own[0] - other)) for other in own[1:]]
            found.append(Distances(np.column_stack([far[:-1], far[:-1]]), far[-1] ** 2))
        return found

    def of_plan(self, plan: Plan) -> Distances:
        """After the best local refits."""
        answers = self._run([*(_Task(model.values, model.effects, plan) for model in self._models), self._bare(plan)])
        own = [answer for answer in answers if answer is not None]
        tuned = self._tuned(plan)
        if len(own) < len(answers) or tuned is None:
            return self._nothing()
        first, *others, bare = own
        separations = [
            (self._distance(model, plan, tuned, first), self._distance(self._models[0], plan, tuned, other))
            for model, other in zip(self._models[1:], others, strict=True)
        ]
        return Distances(np.array(separations), _left_over(first - bare, tuned, np.zeros(tuned.shape[1]))[0])

    def of_recording(self, plan: Plan, measured: np.ndarray) -> np.ndarray:
        """(rivals,) the separations that a recording of a plan shows: by how much each rival, refitted locally, is further from it than the
        first model, refitted locally. Negative where the rival is nearer.

        Parameters
        ----------
        plan : Plan
        measured : (N, C) array
            The recording's channels.
        """
        tuned = self._tuned(plan)
        if tuned is None:
            raise BadAnswerError("a hypothesis cannot be simulated along this plan; its separation is not known")
        recorded = self._runner.whitened(plan, measured)
        squares = np.array([self._distance(model, plan, tuned, recorded) ** 2 for model in self._models])
        excess = squares[1:] - squares[0]
        return np.sign(excess) * np.sqrt(np.abs(excess))

    def _bare(self, plan: Plan) -> _Task:
        """The first model without its effects."""
        return _Task(self._models[0].values, (), plan)

    def _nothing(self) -> Distances:
        return Distances(np.zeros((len(self._models) - 1, 2)), 0.0)

    def _tuned(self, plan: Plan) -> np.ndarray | None:
        """(M, P) sensitivities of the tuned numbers, in units of their prior."""
        first = self._models[0]
        answers = self._run([_Task(first.values, first.effects, plan), *first.tuned_moves(plan)])
        base, *moved = answers
        if base is None or any(answer is None for answer in moved):
            return None
        columns = [(answer - base) / TUNED_STEP for answer in moved if answer is not None]
        return np.column_stack(columns) if columns else np.zeros((len(base), 0))

    def _distance(self, model: Model, plan: Plan, tuned: np.ndarray, target: np.ndarray) -> float:
        """Of a model, refitted, from whitened rows (M,); 0 where it cannot be simulated."""
        offset, before, best = np.zeros(tuned.shape[1]), np.inf, np.inf
        for _ in range(ROUNDS):
            moves = model.effect_moves(plan)
            answers = self._run([_Task(model.values, model.effects, plan), *(task for task, _ in moves)])
            answer, *others = answers
            if answer is None or any(other is None for other in others):
                break
            columns = [(other - answer) / step for other, (_, step) in zip(others, moves, strict=True) if other is not None]
            far = float(np.sum((target - answer) ** 2) + offset @ offset)
            square, change = _left_over(target - answer, np.column_stack([tuned, *columns]), offset, model.bounds())
            best = min(best, square)
            if far > before or square > (1.0 - SETTLED) * far:
                break
            before = far
            offset = offset + change[: len(offset)]
            model = model.at(change)
        return float(np.sqrt(best)) if np.isfinite(best) else 0.0

    def _run(self, tasks: Sequence[_Task]) -> list[np.ndarray | None]:
        self.count += len(tasks)
        batches: list[list[_Task]] = []
        for task in tasks:
            if not batches or batches[-1][0].plan is not task.plan or len(batches[-1]) == LANES:
                batches.append([])
            batches[-1].append(task)
        answers = map(self._runner.answers, batches) if self._pool is None else self._pool.map(self._run_in_thread, batches)
        return [answer for batch in answers for answer in batch]

    def _run_in_thread(self, batch: Sequence[_Task]) -> list[np.ndarray | None]:
        if not hasattr(self._of_thread, "runner"):
            self._of_thread.runner = _Runner(self.machine, self._noise, self._channels)
        return self._of_thread.runner.answers(batch)


def _kept(plan: Plan) -> int:
    """First row after the settling periods."""
    return int(plan.metadata.get("settle_periods", 0)) * int(plan.metadata.get("period_samples", 0))


def _needed(tuning: Tuning, fitted: Fitted) -> tuple[np.ndarray, list[np.ndarray]]:
    """Tuned coordinates and effects' values of a fit, strengths that may as well be zero at zero, the least certain first.

    The other numbers go where they are best without it. Carried on to another motion, a number that the recordings do not show would make
    differences of its own.
    """
    count = len(fitted.offset)
    parameters = [effects()[effect.effect].parameters for effect in fitted.effects]
    offset, own = fitted.offset.copy(), [values.copy() for values in fitted.values]
    columns = np.column_stack([tuning.jacobian, fitted.jacobian])
    size = np.maximum(np.linalg.norm(columns, axis=0), 1e-100)
    size[:count] = 1.0  # whose prior has the unit size
    precision = (columns / size).T @ (columns / size)
    precision[:count, :count] += np.eye(count)
    covariance = np.linalg.pinv(precision, rcond=1e-13, hermitian=True) / np.outer(size, size)
    strengths = {n: (e, k) for n, (e, k) in enumerate(fitted.free, count) if parameters[e][k].is_strength}
    while len(strengths) > 1:
        surplus = {n: own[e][k] - parameters[e][k].neutral for n, (e, k) in strengths.items()}
        deviations = {n: abs(value) / np.sqrt(covariance[n, n]) for n, value in surplus.items()}
        least = min(strengths, key=lambda n: deviations[n])
        if deviations[least] > DECIDED:
            break
        along = covariance[:, least] / covariance[least, least]
        offset = np.clip(offset - along[:count] * surplus[least], -LARGEST_CHANGE / PRIOR, LARGEST_CHANGE / PRIOR)
        for n, (e, k) in enumerate(fitted.free, count):
            own[e][k] = np.clip(own[e][k] - along[n] * surplus[least], parameters[e][k].low, parameters[e][k].high)
        covariance = covariance - np.outer(along, covariance[least])
        del strengths[least]
    return offset, own


def _left_over(
    difference: np.ndarray, jacobian: np.ndarray, offset: np.ndarray, bounds: tuple[np.ndarray, np.ndarray] | None = None
) -> tuple[float, np.ndarray]:
    """d^2 that remains after the best change of all numbers, within bounds if any, and that change; the tuned ones, first, are `offset` off
    their mean.
    """
    tuned = len(offset)
    size = np.maximum(np.linalg.norm(jacobian, axis=0), 1e-300)
    size[:tuned] = 1.0  # whose prior has the unit size
    columns = jacobian / size
    hessian = columns.T @ columns
    hessian[:tuned, :tuned] += np.eye(tuned)
    gradient = columns.T @ difference
    gradient[:tuned] -= offset
    change = np.linalg.lstsq(hessian, gradient, rcond=1e-13)[0]
    if bounds is not None:
        change = _within(change, columns, difference, offset, (bounds[0] * size, bounds[1] * size))
    left = difference - columns @ change
    return float(left @ left + np.sum((offset + change[:tuned]) ** 2)), change / size


def _within(
    change: np.ndarray, columns: np.ndarray, difference: np.ndarray, offset: np.ndarray, bounds: tuple[np.ndarray, np.ndarray]
) -> np.ndarray:
    """The change itself where it is within bounds; else the best one that is: where one number may not go all its way, others that do the
    same may not go all of theirs.
    """
    if np.all((change >= bounds[0]) & (change <= bounds[1])):
        return change
    prior = np.eye(len(offset), len(change))
    whole = np.column_stack([np.vstack([columns, prior]), np.append(difference, -offset)])
    triangle = np.asarray(np.linalg.qr(whole, mode="r"))
    found = least_within(triangle[:, :-1], triangle[:, -1], bounds[0], bounds[1])
    return np.clip(found, *bounds)


def _moved(settings: tuple[EffectSetting, ...], number: int, name: str) -> tuple[tuple[EffectSetting, ...], float]:
    """Effects with one parameter moved within its bounds, and by how much in units of its size."""
    value, size = settings[number].parameters[name], _size(settings[number], name)
    step = EFFECT_STEP if value + EFFECT_STEP * size <= _parameter(settings[number], name).high else -EFFECT_STEP
    return _with(settings, number, name, value + step * size), step


def _with(settings: tuple[EffectSetting, ...], number: int, name: str, value: float) -> tuple[EffectSetting, ...]:
    setting = settings[number]
    changed = EffectSetting(setting.name, setting.at, {**setting.parameters, name: value})
    return (*settings[:number], changed, *settings[number + 1 :])


def _parameter(setting: EffectSetting, name: str) -> Parameter:
    return next(parameter for parameter in effects()[setting.name].parameters if parameter.name == name)


def _size(setting: EffectSetting, name: str) -> float:
    """A large change of a parameter. An order's is itself: its range is made for turns and for metres."""
    parameter, value = _parameter(setting, name), abs(setting.parameters[name])
    return value if parameter.unit == ORDER_UNIT else max(value, 1e-3 * (parameter.high - parameter.low))
