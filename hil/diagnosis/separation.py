"""How far apart an experiment puts hypotheses.

What of the difference of their free runs no local refit of the other one takes away:

    d^2 = min over changes p of |W (y_A - y_B - J_B p)|^2 + |p_tuned|^2

with W the whitening of the noise that the recordings showed, J_B the sensitivities of B's tuned numbers and effect parameters, and the
prior of re-tuning on the former. d is a distance in standard deviations of the noise of one recording: the misfit of B, refitted to a
recording of A, exceeds that of A by d^2 on average. A is the likeliest hypothesis so far, B each of its rivals.
|W (y_A - y_B)| is never smaller and needs no sensitivities.
"""

from __future__ import annotations

import multiprocessing
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from types import TracebackType

import numpy as np

from controllers.errors import ControlError
from hil.diagnosis.free_run import smooth
from hil.diagnosis.mismatch import simulated_matrix
from hil.diagnosis.noise import NoiseModel
from hil.diagnosis.refit import Fitted
from hil.diagnosis.retune import Tuning
from hil.errors import BadAnswer, BenchError
from hil.experiments import Plan
from hil.machine import Machine
from hil.simulation import Inputs, Simulator
from virtual_bus.effects.registry import effects
from virtual_bus.errors import EmulatorError
from virtual_bus.settings import EffectSetting

TUNED_STEP = 0.1
"""Of the sensitivities, in units of the prior."""

EFFECT_STEP = 0.02
"""Of the sensitivities, as a share of a parameter."""


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
    """

    values: np.ndarray
    effects: tuple[EffectSetting, ...]
    indices: np.ndarray
    scale: np.ndarray
    free: tuple[tuple[int, str], ...]

    @classmethod
    def of(cls, tuning: Tuning, fitted: Fitted) -> Model:
        """The model that a fit describes."""
        free = tuple((e, effects()[fitted.effects[e].effect].parameters[k].name) for e, k in fitted.free)
        return cls(tuning.at(fitted.offset), fitted.settings, tuning.indices, tuning.scale, free)

    def moved(self, plan: Plan) -> list[tuple[_Task, float]]:
        """A run with each free number moved, and by how much: tuned ones in units of their prior, effects' in units of their size."""
        found = []
        for index, scale in zip(self.indices, self.scale, strict=True):
            values = self.values.copy()
            values[index] += TUNED_STEP * scale
            found.append((_Task(values, self.effects, plan), TUNED_STEP))
        for number, name in self.free:
            changed, step = _moved(self.effects, number, name)
            found.append((_Task(self.values, changed, plan), step))
        return found


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

    def answer(self, task: _Task) -> np.ndarray | None:
        """(M,); None where it cannot be simulated."""
        plan = task.plan
        still = np.zeros_like(plan.reference)
        inputs = Inputs(plan.reference, plan.excitation, still if plan.feedforward is None else plan.feedforward, None, plan.start_pose)
        try:
            outputs = self._simulator.run(inputs, task.values, (*self._machine.plant.effects, *task.effects))
        except (BenchError, EmulatorError, ControlError):
            return None
        rows = simulated_matrix(self._machine, outputs, self._channels)
        return self._noise.whiten(rows[_kept(plan) :])


_runner: _Runner | None = None  # of a worker process


def _start_worker(machine: Machine, noise: NoiseModel, channels: tuple[str, ...]) -> None:
    global _runner
    _runner = _Runner(machine, noise, channels)


def _run_in_worker(task: _Task) -> np.ndarray | None:
    assert _runner is not None
    return _runner.answer(task)


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
        Processes. 1: all in this one.

    Attributes
    ----------
    count : int
        Free runs so far.
    """

    def __init__(self, machine: Machine, models: Sequence[Model], noise: NoiseModel, channels: tuple[str, ...], jobs: int = 1) -> None:
        self.machine = machine
        self.count = 0
        self._models = models
        self._noise = noise
        self._runner = _Runner(machine, noise, channels)
        self._pool: ProcessPoolExecutor | None = None
        if jobs > 1:
            how = "fork" if "fork" in multiprocessing.get_all_start_methods() else "spawn"
            context = multiprocessing.get_context(how)
            self._pool = ProcessPoolExecutor(jobs, mp_context=context, initializer=_start_worker, initargs=(machine, noise, channels))

    def __enter__(self) -> Separation:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        if self._pool is not None:
            self._pool.shutdown(cancel_futures=True)

    def at_most(self, plans: Sequence[Plan]) -> list[float]:
        """|W (y_A - y_B)| of every plan, the smallest of its pairs: no separation is larger. 0 where a model cannot be simulated."""
        answers = self._run([_Task(model.values, model.effects, plan) for plan in plans for model in self._models])
        size = len(self._models)
        found = []
        for own in (answers[k : k + size] for k in range(0, len(answers), size)):
            whole = [answer for answer in own if answer is not None]
            found.append(min(float(np.linalg.norm(whole[0] - other)) for other in whole[1:]) if len(whole) == size else 0.0)
        return found

    def of_plan(self, plan: Plan) -> float:
        """Smallest d over the pairs; 0 where a model cannot be simulated."""
        pairs = self._answers(plan)
        if pairs is None:
            return 0.0
        first = pairs[0][0]
        return min(left_over(first - other, jacobian, model) for (other, jacobian), model in zip(pairs[1:], self._models[1:], strict=True))

    def of_recording(self, plan: Plan, measured: np.ndarray) -> float:
        """The separation that a recording of a plan shows, where the first model is right: by how much the closest other one, refitted
        locally, is further from it. Negative where another one is nearer.

        Parameters
        ----------
        plan : Plan
        measured : (N, C) array
            The recording's channels.
        """
        pairs = self._answers(plan, sensitive_first=True)
        if pairs is None:
            raise BadAnswer("a hypothesis cannot be simulated along this plan; its separation is not known")
        recorded = self._noise.whiten(measured[_kept(plan) :])
        squares = [
            left_over(recorded - answer, jacobian, model) ** 2 for (answer, jacobian), model in zip(pairs, self._models, strict=True)
        ]
        excess = min(squares[1:]) - squares[0]
        return float(np.sign(excess) * np.sqrt(abs(excess)))

    def _answers(self, plan: Plan, *, sensitive_first: bool = False) -> list[tuple[np.ndarray, np.ndarray]] | None:
        """(M,) answer and (M, P + F) sensitivities of each model; without those of the first where nobody asks for them.

        Columns: tuned numbers in units of their prior, then effect parameters in units of their own size.
        """
        tasks: list[_Task] = []
        steps: list[list[float]] = []
        for number, model in enumerate(self._models):
            moved = model.moved(plan) if number or sensitive_first else []
            tasks += [_Task(model.values, model.effects, plan), *(task for task, _ in moved)]
            steps.append([step for _, step in moved])
        found = iter(self._run(tasks))
        pairs = []
        for own in steps:
            answer, *others = [next(found) for _ in range(1 + len(own))]
            if answer is None or any(other is None for other in others):
                return None
            columns = [(other - answer) / step for other, step in zip(others, own, strict=True) if other is not None]
            pairs.append((answer, np.column_stack(columns) if columns else np.zeros((len(answer), 0))))
        return pairs

    def _run(self, tasks: Sequence[_Task]) -> list[np.ndarray | None]:
        self.count += len(tasks)
        if self._pool is None:
            return [self._runner.answer(task) for task in tasks]
        return list(self._pool.map(_run_in_worker, tasks))


def _kept(plan: Plan) -> int:
    """First row after the settling periods."""
    return int(plan.metadata.get("settle_periods", 0)) * int(plan.metadata.get("period_samples", 0))


def left_over(difference: np.ndarray, jacobian: np.ndarray, model: Model) -> float:
    """Distance that remains after the best local refit."""
    tuned = len(model.indices)
    size = np.maximum(np.linalg.norm(jacobian, axis=0), 1e-300)
    size[:tuned] = 1.0  # whose prior has the unit size
    columns = jacobian / size
    hessian = columns.T @ columns
    hessian[:tuned, :tuned] += np.eye(tuned)
    change = np.linalg.lstsq(hessian, columns.T @ difference, rcond=1e-13)[0]
    return float(np.hypot(np.linalg.norm(difference - columns @ change), np.linalg.norm(change[:tuned])))


def _moved(settings: tuple[EffectSetting, ...], number: int, name: str) -> tuple[tuple[EffectSetting, ...], float]:
    """Effects with one parameter moved within its bounds, and by how much in units of its size."""
    setting = settings[number]
    parameter = next(p for p in effects()[setting.name].parameters if p.name == name)
    value = setting.parameters[name]
    size = max(abs(value), 1e-3 * (parameter.high - parameter.low))
    step = EFFECT_STEP if value + EFFECT_STEP * size <= parameter.high else -EFFECT_STEP
    changed = EffectSetting(setting.name, setting.at, {**setting.parameters, name: value + step * size})
    return (*settings[:number], changed, *settings[number + 1 :]), step
