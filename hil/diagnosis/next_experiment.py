"""The experiment that would tell hypotheses apart, found by optimisation within the machine's limits.

Two hypotheses are separated by what of the difference of their free runs no local refit of the other one takes away:

    d^2 = min over changes p of |W (y_A - y_B - J_B p)|^2 + |p_tuned|^2

with W the whitening of the noise that the recordings showed, J_B the sensitivities of B's tuned numbers and effect parameters, and the
prior of re-tuning on the former. d is a distance in standard deviations of the noise of one recording: the misfit of B, refitted to a
recording of A, exceeds that of A by d^2 on average. A is the likeliest hypothesis so far, B each of its rivals.
Atkinson and Fedorov 1975 (T-optimal designs), with a free run in place of a regression.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import scipy.optimize
from scipy.stats import qmc

from controllers.errors import ControlError
from hil.diagnosis.experiment_families import FAMILIES, Family, Request, requests
from hil.diagnosis.free_run import smooth
from hil.diagnosis.mismatch import simulated_matrix
from hil.diagnosis.noise import NoiseModel
from hil.diagnosis.refit import Fitted
from hil.diagnosis.retune import Tuning
from hil.errors import BenchError, ExperimentError
from hil.experiments import Experiment, Plan
from hil.machine import Machine
from hil.simulation import Inputs, Simulator
from virtual_bus.effects.registry import effects
from virtual_bus.errors import EmulatorError
from virtual_bus.settings import EffectSetting

DRAWS = 8
"""Quasi-random experiments of every family and axis that are looked at first: a power of two, as Sobol's sequence wants."""

REFINEMENTS = 30
"""Evaluations of the simplex search from the best of them."""

FIRST_STEP = 0.12
"""Of the simplex, as a share of every quantity's range."""

TUNED_STEP = 0.1
"""Of the sensitivities, in units of the prior."""

EFFECT_STEP = 0.02
"""Of the sensitivities, as a share of a parameter."""


@dataclass(frozen=True, eq=False)
class Proposal:
    """An experiment that separates hypotheses.

    Attributes
    ----------
    experiment : Experiment
        What `isocenter run` takes.
    separation : float
        Smallest predicted distance d of any pair with the likeliest hypothesis, in standard deviations of one recording's noise.
    seconds : float
        How long the recording is.
    evaluated : int
        Experiments that were simulated.
    """

    experiment: Experiment
    separation: float
    seconds: float
    evaluated: int

    def header(self, names: Sequence[str]) -> str:
        """Comment lines for the experiment's file."""
        return (
            f"# Separates {' from '.join(names)}.\n"
            f"# Predicted separation: {self.separation:.3g} standard deviations of one recording's noise, in {self.seconds:.3g} s.\n"
        )


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


class Separation:
    """Predicted separation of hypotheses by any plan.

    Parameters
    ----------
    machine : Machine
    models : sequence of Model
        The likeliest first; each other one is held against it.
    noise : NoiseModel
    channels : tuple of str
    """

    def __init__(self, machine: Machine, models: Sequence[Model], noise: NoiseModel, channels: tuple[str, ...]) -> None:
        self.machine = machine
        self._models = models
        self._noise = noise
        self._channels = channels
        self._simulator = Simulator(smooth(machine))

    def of_plan(self, plan: Plan) -> float:
        """Smallest d over the pairs; 0 where a model cannot be simulated."""
        try:
            answers = [self._answer(model.values, model.effects, plan) for model in self._models]
            columns = [self._sensitivities(model, answer, plan) for model, answer in zip(self._models[1:], answers[1:], strict=True)]
        except (BenchError, EmulatorError, ControlError):
            return 0.0
        first = answers[0]
        rivals = zip(answers[1:], columns, self._models[1:], strict=True)
        return min(left_over(first - other, jacobian, model) for other, jacobian, model in rivals)

    def of_recording(self, plan: Plan, measured: np.ndarray) -> float:
        """The separation that a recording of a plan shows, where the first model is right: by how much the closest other one, refitted
        locally, is further from it. Negative where another one is nearer.

        Parameters
        ----------
        plan : Plan
        measured : (N, C) array
            The recording's channels.
        """
        recorded = self._noise.whiten(measured[_kept(plan) :])
        squares = []
        for model in self._models:
            answer = self._answer(model.values, model.effects, plan)
            squares.append(left_over(recorded - answer, self._sensitivities(model, answer, plan), model) ** 2)
        excess = min(squares[1:]) - squares[0]
        return float(np.sign(excess) * np.sqrt(abs(excess)))

    def _answer(self, values: np.ndarray, settings: tuple[EffectSetting, ...], plan: Plan) -> np.ndarray:
        still = np.zeros_like(plan.reference)
        inputs = Inputs(plan.reference, plan.excitation, still if plan.feedforward is None else plan.feedforward, None, plan.start_pose)
        outputs = self._simulator.run(inputs, values, (*self.machine.plant.effects, *settings))
        rows = simulated_matrix(self.machine, outputs, self._channels)
        return self._noise.whiten(rows[_kept(plan) :])

    def _sensitivities(self, model: Model, answer: np.ndarray, plan: Plan) -> np.ndarray:
        """(M, P + F): tuned numbers in units of their prior, then effect parameters in units of their own size."""
        columns = []
        for index, scale in zip(model.indices, model.scale, strict=True):
            values = model.values.copy()
            values[index] += TUNED_STEP * scale
            columns.append((self._answer(values, model.effects, plan) - answer) / TUNED_STEP)
        for number, name in model.free:
            moved, step = _moved(model.effects, number, name)
            columns.append((self._answer(model.values, moved, plan) - answer) / step)
        return np.column_stack(columns) if columns else np.zeros((len(answer), 0))


def _kept(plan: Plan) -> int:
    """First row after the settling periods."""
    return int(plan.metadata.get("settle_periods", 0)) * int(plan.metadata.get("period_samples", 0))


def left_over(difference: np.ndarray, jacobian: np.ndarray, model: Model) -> float:
    """Distance that remains after the best local refit."""
    tuned = len(model.indices)
    prior = np.zeros((tuned, jacobian.shape[1]))
    prior[:, :tuned] = np.eye(tuned)
    rows = np.vstack([jacobian, prior])
    target = np.concatenate([difference, np.zeros(tuned)])
    size = np.maximum(np.linalg.norm(rows, axis=0), 1e-300)
    change = np.linalg.lstsq(rows / size, target, rcond=1e-10)[0]
    return float(np.linalg.norm(target - rows / size @ change))


def propose(
    machine: Machine,
    models: Sequence[Model],
    noise: NoiseModel,
    channels: tuple[str, ...],
    *,
    report: Callable[[float], None] = lambda share: None,
) -> Proposal | None:
    """Find the experiment that separates the first model from each of the others best.

    Parameters
    ----------
    machine : Machine
        Its limits bound everything; without controllers there is nothing to run.
    models : sequence of Model
        Two or more, the likeliest first.
    noise : NoiseModel
        From the recordings so far.
    channels : tuple of str
        As recorded so far.
    report : callable
        Told the share that is done.

    Returns
    -------
    Proposal or None
        None where the machine cannot be run, or nothing within its limits separates them.
    """
    if not machine.controllers or len(models) < 2:
        return None
    separation = Separation(machine, models, noise, channels)
    asked = requests(machine)
    total = len(asked) * DRAWS + REFINEMENTS
    done = 0

    def value(family: Family, request: Request, point: np.ndarray) -> float:
        nonlocal done
        done += 1
        report(min(done / total, 1.0))
        plan = _plan(machine, family, request, point)
        return 0.0 if plan is None else separation.of_plan(plan)

    best: tuple[float, Request, np.ndarray] | None = None
    for request in asked:
        family = FAMILIES[request.family]
        for point in qmc.Sobol(family.dimensions(machine), seed=0).random(DRAWS):
            found = value(family, request, point)
            if found > 0.0 and (best is None or found > best[0]):
                best = (found, request, point)
    if best is None:
        return None
    _, request, start = best
    family = FAMILIES[request.family]
    simplex = np.vstack([start, start + np.where(start < 0.5, FIRST_STEP, -FIRST_STEP) * np.eye(len(start))])
    refined = scipy.optimize.minimize(
        lambda point: -value(family, request, np.clip(point, 0.0, 1.0)), start, method="Nelder-Mead",
        options={"maxfev": REFINEMENTS, "initial_simplex": simplex},
    )  # fmt: skip
    point = np.clip(refined.x, 0.0, 1.0)
    experiment = family.experiment(machine, request, point)
    (plan,) = experiment.plans(machine)
    return Proposal(experiment, -float(refined.fun), plan.rows / machine.sample_rate_Hz, done)


def _plan(machine: Machine, family: Family, request: Request, point: np.ndarray) -> Plan | None:
    """None where the machine's limits forbid it."""
    try:
        plans = family.experiment(machine, request, point).plans(machine)
    except ExperimentError:
        return None
    return plans[0]


def _moved(settings: tuple[EffectSetting, ...], number: int, name: str) -> tuple[tuple[EffectSetting, ...], float]:
    """Effects with one parameter moved within its bounds, and by how much in units of its size."""
    setting = settings[number]
    parameter = next(p for p in effects()[setting.name].parameters if p.name == name)
    value = setting.parameters[name]
    size = max(abs(value), 1e-3 * (parameter.high - parameter.low))
    step = EFFECT_STEP if value + EFFECT_STEP * size <= parameter.high else -EFFECT_STEP
    changed = EffectSetting(setting.name, setting.at, {**setting.parameters, name: value + step * size})
    return (*settings[:number], changed, *settings[number + 1 :]), step
