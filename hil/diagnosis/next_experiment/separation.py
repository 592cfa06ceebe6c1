"""How far apart an experiment puts sets of effects.

One set's machine runs the experiment in closed loop, without noise. Beside that recording the other set is fitted as it would be beside a
real one, numbers and form errors included: what it leaves more than the first set is d^2, in units of one recording's noise. Each of two
sets may be the right one: a law that has another one as its special case follows it wherever it goes, and is told from it only in the other
direction. Without a fit, how differently two free runs are driven says about the same.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hil.diagnosis.model_choice.fitting import fit
from hil.diagnosis.observed.rows import Observed
from hil.diagnosis.residuals.equation_errors import Levels
from hil.diagnosis.residuals.trajectory import Trajectory
from hil.diagnosis.retuning.linear_model import linear_at, nominal_offset
from hil.errors import BadAnswerError
from hil.experiments import Plan
from hil.machine import Machine
from hil.recording import Channel, Recording, recording_metadata
from hil.simulation import Inputs, Outputs, Simulator
from hil.simulation.smooth import simulated_matrix, smooth
from virtual_bus.plant.lanes import LANES
from virtual_bus.settings import EffectSetting


@dataclass(frozen=True, eq=False)
class Model:
    """A set of effects as a machine.

    Attributes
    ----------
    values : (parameters,) array
        Of the plant.
    offset : (P,) array
        The same as nuisances: numbers alone, in standard deviations of their prior.
    effects : tuple of EffectSetting
    share : float
        How likely it is so far.
    """

    values: np.ndarray
    offset: np.ndarray
    effects: tuple[EffectSetting, ...]
    share: float

    @property
    def name(self) -> str:
        """What it is called in an experiment's file."""
        return " and ".join(f"{one.name} at {one.at}" for one in self.effects) or "no effect"


class Separation:
    """Predicted separation of sets of effects by any plan.

    Parameters
    ----------
    machine : Machine
    models : sequence of Model
        The likeliest first; each other one is held against it.
    levels : Levels
        Noise of one recording.
    channels : tuple of str
        Of sensors, as recorded so far.
    by : int
        Rows of the machine that are one row of what the levels are of.
    """

    def __init__(self, machine: Machine, models: Sequence[Model], levels: Levels, channels: tuple[str, ...], by: int = 1) -> None:
        self.machine = machine
        self._by = by
        self._models = models
        self._levels = levels
        self._channels = channels
        self._simulator = Simulator(smooth(machine))

    def about(self, plans: Sequence[Plan]) -> list[np.ndarray]:
        """Return for every plan about how far (rivals,) free runs are apart: by what drives give, in units of disturbances.

        A loop that follows its reference gives what the physics take.
        """
        drives = self.machine.plant.drives
        joints = [joint.name for joint in self.machine.plant.tree.joints]
        units = np.array([max(self._levels.disturbance[joints.index(d.joint)] / (d.ratio * d.constant), 1e-12) for d in drives])
        found = []
        for plan in plans:
            first, *others = self._run(plan)
            far = np.zeros(len(others))
            for k, other in enumerate(others):
                if first is not None and other is not None:
                    far[k] = np.linalg.norm((other.command - first.command) / units)
            found.append(far)
        return found

    def of_plan(self, plan: Plan) -> np.ndarray:
        """Return d after fits (rivals, 2): where the first set is right, and where the rival is; 0 where one cannot be simulated."""
        runs = self._run(plan)
        separations = np.zeros((len(runs) - 1, 2))
        if runs[0] is None:
            return separations
        first = self._observed(plan, runs[0])
        for k, (rival, run) in enumerate(zip(self._models[1:], runs[1:], strict=True)):
            if run is not None:
                separations[k] = self._left(first, self._models[0], rival), self._left(self._observed(plan, run), rival, self._models[0])
        return separations

    def _run(self, plan: Plan) -> list[Outputs | None]:
        still = np.zeros_like(plan.reference)
        inputs = Inputs(plan.reference, plan.excitation, still if plan.feedforward is None else plan.feedforward, None, plan.start_pose)
        machines = [(model.values, (*self.machine.plant.effects, *model.effects)) for model in self._models]
        outputs: list[Outputs | None] = []
        for begin in range(0, len(machines), LANES):
            answers = self._simulator.run_all(inputs, machines[begin : begin + LANES])
            outputs += [None if isinstance(one, Exception) else one for one in answers]
        return outputs

    def _observed(self, plan: Plan, run: Outputs) -> Observed:
        period = 1.0 / self.machine.sample_rate_Hz
        kept = int(plan.metadata.get("settle_periods", 0)) * int(plan.metadata.get("period_samples", 0))
        targets = np.vstack([run.command[:1], run.command[:-1]])[kept:]
        readings = simulated_matrix(self.machine, run, self._channels)[kept:]
        time = np.arange(len(readings)) * period
        bare = Recording({"time": Channel("s", time)}, recording_metadata(self.machine))
        return Observed("predicted", self.machine, bare, time, period, targets, run.effort[kept:], self._channels, readings).coarser(
            self._by
        )

    def _left(self, observed: Observed, right: Model, other: Model) -> float:
        """Return by how much farther than the right set another one stays from its recording, after fits of both."""
        trajectory = Trajectory(observed)
        offset = nominal_offset([trajectory])
        offset[: len(right.offset)] = right.offset
        try:
            linear = linear_at([trajectory], self._levels, offset, right.effects)
        except BadAnswerError:
            return 0.0
        own, its = (fit(linear, one.effects, offset) for one in (right, other))
        return 0.0 if own is None or its is None else float(np.sqrt(max(its.cost() - own.cost(), 0.0)))
