"""Simulator of one machine, compiled once and run over any number of inputs and parameter values."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cache, cached_property, partial
from typing import Any

import numpy as np

from controllers.errors import ControlError, DesignError
from controllers.feedback import Feedback
from hil.errors import BadAnswerError, BenchError, ExperimentError
from hil.machine import Machine
from hil.simulation.inputs import COMPILED_FOR, Inputs
from hil.simulation.kernel import Loop, Rows, closed_loop_kernel, new_scratch
from hil.simulation.several import Own, Prepared, SideBySide, Taken
from virtual_bus.errors import EmulatorError
from virtual_bus.plant.compiled import compile_plant
from virtual_bus.plant.lanes import LANES
from virtual_bus.plant.statics import held_effort, holding_effort, resting_state
from virtual_bus.sensors.effects import new_memory
from virtual_bus.sensors.measure import SensorModel, new_readings, sensor_model, with_effects
from virtual_bus.settings import EffectSetting


@dataclass(frozen=True)
class Outputs:
    """Outputs of a simulation, N rows."""

    command: np.ndarray  # (N, n_axes)
    effort: np.ndarray  # (N, n_axes) as the drives measure it; NaN where they do not
    position: np.ndarray  # (N, n_axes) [rad or m]; NaN without a motor-side encoder
    link_position: np.ndarray  # (N, n_axes); NaN without a link encoder
    speed: np.ndarray  # (N, n_axes) [rad/s or m/s]; NaN without a speed sensor
    imu: np.ndarray  # (N, 6 imus) specific force [m/s^2] and angular rate [rad/s]


class Simulator:
    """Closed loop of one machine without noise.

    Parameters
    ----------
    machine : Machine
        Its plant is compiled, or loaded from an earlier time.
    """

    def __init__(self, machine: Machine) -> None:
        self.machine = machine
        self.plant = compile_plant(machine.plant)
        self._kernel = cache(partial(closed_loop_kernel, self.plant))
        self._work = self.plant.new_work()
        self._scratch = new_scratch(len(machine.axes), len(machine.plant.imus))

    def run(self, inputs: Inputs, values: np.ndarray | None = None, effects: Sequence[EffectSetting] | None = None) -> Outputs:
        """Simulate from standstill, or from the start speed.

        Parameters
        ----------
        inputs : Inputs
        values : (parameters,) array, optional
            Plant parameters in the order of `plant.parameters`; the machine file's by default.
        effects : sequence of EffectSetting, optional
            The machine's own by default.

        Raises
        ------
        ExperimentError
            The machine cannot stand where the run began.
        BadAnswerError
            The simulation diverged; the message names the time.
        """
        prepared = self._prepared(inputs, values, effects)
        rows = self._rows(inputs)
        settings = self.machine.plant
        failed = self._kernel(self.plant.filters_all(prepared.model)).run(
            inputs.command is None,
            prepared.state,
            prepared.target,
            np.array([drive.resolution for drive in settings.drives]),
            prepared.model,
            self._work,
            prepared.sensors,
            new_memory(settings),
            new_readings(settings),
            np.zeros(6 * len(settings.imus)),
            prepared.loop,
            rows,
            self._scratch,
        )
        if failed >= 0 or not np.isfinite(prepared.state).all():
            raise self._diverged(failed)
        return Outputs(rows.command, rows.effort, rows.position, rows.link_position, rows.speed, rows.imu)

    def run_all(
        self,
        inputs: Inputs,
        trials: Sequence[tuple[np.ndarray | None, Sequence[EffectSetting] | None]],
        own: Sequence[Own] | None = None,
    ) -> list[Outputs | BenchError | EmulatorError | ControlError]:
        """Run several machines with their values and effects; return what `run` would return or raise for each.

        Several machines run at a time in the processor's vectors (see virtual_bus/plant/lanes.py). The results of a machine differ by
        rounding from those of `run`, and do not depend on the other machines. `own` is what each has for itself, where one has.
        """
        with ThreadPoolExecutor(1) as threads:
            return self.begin_all(inputs, trials, threads, own)()

    def begin_all(
        self,
        inputs: Inputs,
        trials: Sequence[tuple[np.ndarray | None, Sequence[EffectSetting] | None]],
        threads: ThreadPoolExecutor,
        own: Sequence[Own] | None = None,
        most_steps: int | None = None,
    ) -> Callable[[], list[Outputs | BenchError | EmulatorError | ControlError]]:
        """Begin `run_all` in threads; return what waits for it and returns the same.

        A machine that needs more than `most_steps` within a plant step is not simulated: its answer is a BadAnswerError.
        """
        found: list[Any] = []
        begun: list[tuple[list[int], Future[list[Taken]]]] = []
        waiting: defaultdict[int, list[int]] = defaultdict(list)

        def begin(together: list[int]) -> None:
            begun.append((together, threads.submit(self._side_by_side.run, inputs, [found[k] for k in together])))

        for k, (values, effects) in enumerate(trials):
            try:
                found.append(replace(self._prepared(inputs, values, effects), own=None if own is None else own[k]))
            except (BenchError, EmulatorError, ControlError) as error:
                found.append(error)
                continue
            if most_steps is not None and int(found[k].model["inner_steps"][0]) > most_steps:
                found[k] = BadAnswerError(f"{self.machine.name}: moves too fast to be simulated in {most_steps} steps of a plant step")
                continue
            if self.plant.filters_all(found[k].model):  # as the lane kernel takes them
                alike = int(found[k].model["inner_steps"][0])
                waiting[alike].append(k)
                if len(waiting[alike]) == LANES:
                    begin(waiting.pop(alike))
        for rest in waiting.values():
            begin(rest)

        def ended() -> list[Outputs | BenchError | EmulatorError | ControlError]:
            for together, taken in begun:
                for k, lane in zip(together, taken.result(), strict=True):
                    found[k] = self._of_lane(lane, inputs)
            for k, one in enumerate(found):
                if isinstance(one, Prepared):
                    if own is not None or inputs.restarts is not None:
                        raise ValueError(f"{self.machine.name}: an IMU without a low pass runs alone, and takes no restarts")
                    found[k] = self.run_or_error(inputs, *trials[k])
            return found

        return ended

    def run_or_error(
        self, inputs: Inputs, values: np.ndarray | None, effects: Sequence[EffectSetting] | None
    ) -> Outputs | BenchError | EmulatorError | ControlError:
        """Return what `run` returns or raises."""
        try:
            return self.run(inputs, values, effects)
        except (BenchError, EmulatorError, ControlError) as error:
            return error

    @cached_property
    def _side_by_side(self) -> SideBySide:
        sections = 0 if not self.machine.controllers else len(self._feedback.arrays[0])
        return SideBySide(self.plant, sections)

    def _of_lane(self, taken: Taken, inputs: Inputs) -> Outputs | BadAnswerError:
        if inputs.command is None and not np.isfinite(taken.command).all():
            return self._diverged(int(np.argmin(np.isfinite(taken.command).all(axis=1))))
        if not taken.ends_finite:
            return self._diverged(-1)
        return Outputs(taken.command, taken.effort, taken.position, taken.link_position, taken.speed, taken.imu)

    def _diverged(self, row: int) -> BadAnswerError:
        at = f"at {row / self.machine.sample_rate_Hz:.4g} s" if row >= 0 else "in its last sample"
        return BadAnswerError(f"{self.machine.name}: the simulation diverged {at}; check the controller with `isocenter machine check`")

    def _prepared(self, inputs: Inputs, values: np.ndarray | None, effects: Sequence[EffectSetting] | None) -> Prepared:
        settings = self.machine.plant
        effects = settings.effects if effects is None else effects
        model = self.plant.model(values, effects)
        state = resting_state(self.plant, model, inputs.standing_pose, held_by_brakes=False)
        holding = held_effort(self.plant, state)
        if inputs.start_speed is not None:
            state[[self.plant.joints + joint for joint in self.plant.joint_of_axis().values()]] = inputs.start_speed
        if inputs.command is None:
            loop, holding = self._started(inputs, holding, values, effects)
        else:
            loop = self._open_loop
            holding = holding if inputs.first_effort is None else inputs.first_effort
        sensors = with_effects(self._own_sensors, settings, effects)
        return Prepared(model, state, holding.copy(), loop, sensors)

    @cached_property
    def _own_sensors(self) -> SensorModel:
        return sensor_model(self.machine.plant, ())

    def _rows(self, inputs: Inputs) -> Rows:
        shape = inputs.excitation.shape
        command = np.zeros(shape) if inputs.command is None else np.array(inputs.command, dtype=float, order="C")
        reference = np.zeros(shape) if inputs.reference is None else inputs.reference
        return Rows(
            reference=np.require(reference, float, COMPILED_FOR),
            excitation=np.require(inputs.excitation, float, COMPILED_FOR),
            feedforward=np.require(inputs.feedforward, float, COMPILED_FOR),
            command=command,
            effort=np.zeros(shape),
            position=np.zeros(shape),
            link_position=np.zeros(shape),
            speed=np.zeros(shape),
            imu=np.zeros((shape[0], 6 * len(self.machine.plant.imus))),
        )

    @cached_property
    def _open_loop(self) -> Loop:
        limit = np.array([drive.limit for drive in self.machine.plant.drives])
        axes = len(limit)
        return Loop(np.zeros((0, 6)), np.zeros((0, 2)), np.zeros((axes, 3), dtype=np.int64), limit, np.zeros((axes, 2)))

    def _started(
        self, inputs: Inputs, holding: np.ndarray, values: np.ndarray | None, effects: Sequence[EffectSetting]
    ) -> tuple[Loop, np.ndarray]:
        """Return the loop and the targets that the drives hold at row 0.

        Where the load of the machine file can be held but that of an effect cannot, because the loop has no integrator, row 0 is as without
        the effects and the machine sags from there.
        """
        try:
            return self._closed_loop(inputs, holding), holding
        except ExperimentError:
            limits = [controller.limit for controller in self.machine.controllers]
            if not effects or np.any(np.abs(holding) > limits):
                raise
        own = holding_effort(self.plant, self.plant.model(values, ()), inputs.standing_pose)
        return self._closed_loop(inputs, own), own

    def _closed_loop(self, inputs: Inputs, holding: np.ndarray) -> Loop:
        feedback = self._feedback
        try:
            if inputs.controller_states is None:
                feedback.preload(holding, inputs.standing_pose, inputs.feedforward[0])
            else:
                feedback.load_states(inputs.controller_states)
        except DesignError as error:
            raise ExperimentError(f"{self.machine.name}: {error}") from None
        sections, state, rows, limit, held = feedback.arrays
        return Loop(sections, state.copy(), rows, limit, held.copy())

    @cached_property
    def _feedback(self) -> Feedback:
        """Feedback for all runs, reloaded for each; a run advances copies of its states."""
        return Feedback(self.machine.controllers)
