"""One machine, compiled once, run over as many inputs and parameter values as wanted."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from controllers.errors import DesignError
from controllers.feedback import Feedback
from hil.errors import BadAnswer, ExperimentError
from hil.machine import Machine
from hil.simulation.kernel import Efforts, Encoders, Loop, Rows, closed_loop_kernel
from virtual_bus.plant.compiled import compile_plant
from virtual_bus.plant.statics import holding_effort, resting_state
from virtual_bus.settings import EffectSetting


@dataclass(frozen=True)
class Inputs:
    """What a simulation is driven by; arrays (N, n_axes) in axis order.

    Attributes
    ----------
    reference : array or None
        [rad or m]; None for a machine without controllers.
    excitation : array
        w, in the drives' units.
    feedforward : array
        In the drives' units.
    command : array or None
        Given instead of a reference to a machine without controllers.
    start_pose : (n_axes,) array
        Standstill in elastic equilibrium at row 0.
    controller_states : mapping or None
        As `Feedback.states`; None: integrators at the holding effort.
    """

    reference: np.ndarray | None
    excitation: np.ndarray
    feedforward: np.ndarray
    command: np.ndarray | None
    start_pose: np.ndarray
    controller_states: Mapping[str, Any] | None = None


@dataclass(frozen=True)
class Outputs:
    """What a simulation answers, N rows."""

    command: np.ndarray  # (N, n_axes)
    effort: np.ndarray  # (N, n_axes) as the drives report it
    encoders: np.ndarray  # (N, encoders) in the order of the plant's encoders [rad or m]
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
        self._kernel = closed_loop_kernel(self.plant)
        self._work = self.plant.new_work()

    def run(self, inputs: Inputs, values: np.ndarray | None = None, effects: Sequence[EffectSetting] | None = None) -> Outputs:
        """Simulate from standstill.

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
            The machine cannot stand at the start pose.
        BadAnswer
            The simulation diverged; the message names the time.
        """
        model = self.plant.model(values, effects)
        state = resting_state(self.plant, model, inputs.start_pose, held_by_brakes=False)
        holding = holding_effort(self.plant, model, inputs.start_pose)
        closed = inputs.command is None
        rows = self._rows(inputs)
        encoders = self._encoders(state)
        feedback = self._feedback(inputs, holding, encoders) if closed else None
        loop = self._open_loop if feedback is None else feedback
        brakes = np.zeros(len(holding))
        failed = self._kernel.run(
            closed, state, holding.copy(), brakes, model, self._work, encoders, self._efforts, loop, rows
        )
        if failed >= 0 or not np.isfinite(state).all():
            at = f"at {failed / self.machine.sample_rate_Hz:.4g} s" if failed >= 0 else "in its last sample"
            raise BadAnswer(f"{self.machine.name}: the simulation diverged {at}; check the controller with `isocenter machine check`")
        return Outputs(rows.command, rows.effort, rows.encoders, self._read_imus(rows.imu))

    def _rows(self, inputs: Inputs) -> Rows:
        shape = inputs.excitation.shape
        command = np.zeros(shape) if inputs.command is None else np.array(inputs.command, dtype=float, order="C")
        reference = np.zeros(shape) if inputs.reference is None else inputs.reference
        return Rows(
            reference=np.ascontiguousarray(reference, dtype=float),
            excitation=np.ascontiguousarray(inputs.excitation, dtype=float),
            feedforward=np.ascontiguousarray(inputs.feedforward, dtype=float),
            command=command,
            effort=np.zeros(shape),
            encoders=np.zeros((shape[0], len(self.machine.plant.encoders))),
            imu=np.zeros((shape[0], 6 * len(self.machine.plant.imus))),
        )

    def _encoders(self, state: np.ndarray) -> Encoders:
        settings = self.machine.plant
        joints = [[settings.tree.joint_index(joint) for joint in encoder.joints] for encoder in settings.encoders]
        channels = [encoder.channel for encoder in settings.encoders]
        return Encoders(
            first=np.cumsum([0, *(len(entry) for entry in joints)]).astype(np.int64),
            joints=np.array([joint for entry in joints for joint in entry], dtype=np.int64),
            resolution=np.array([encoder.resolution for encoder in settings.encoders]),
            zero=np.array([0.0 if e.absolute else state[entry].sum() for e, entry in zip(settings.encoders, joints, strict=True)]),
            of_axis=np.array([channels.index(f"position_{axis}") for axis in self.machine.axes], dtype=np.int64),
        )

    def _read_imus(self, motion: np.ndarray) -> np.ndarray:
        """What the IMUs report (N, 6 imus) of their motion: bias and resolution added."""
        imus = self.machine.plant.imus
        if not imus:
            return motion
        bias = np.concatenate([np.concatenate([imu.accelerometer_bias_m_s2, imu.gyro_bias_rad_s]) for imu in imus])
        resolution = np.concatenate([np.repeat([imu.accelerometer_resolution_m_s2, imu.gyro_resolution_rad_s], 3) for imu in imus])
        reading = motion + bias
        rounds = resolution > 0.0
        reading[:, rounds] = np.floor(reading[:, rounds] / resolution[rounds] + 0.5) * resolution[rounds]
        return reading

    @cached_property
    def _efforts(self) -> Efforts:
        sensors = {sensor.axis: sensor.resolution for sensor in self.machine.plant.currents}
        return Efforts(
            target_resolution=np.array([drive.resolution for drive in self.machine.plant.drives]),
            sensor_resolution=np.array([sensors.get(axis, 0.0) for axis in self.machine.axes]),
        )

    @cached_property
    def _open_loop(self) -> Loop:
        limit = np.array([drive.limit for drive in self.machine.plant.drives])
        axes = len(limit)
        return Loop(np.zeros((0, 6)), np.zeros((0, 2)), np.zeros((axes, 3), dtype=np.int64), limit, np.zeros((axes, 2)))

    def _feedback(self, inputs: Inputs, holding: np.ndarray, encoders: Encoders) -> Loop:
        feedback = Feedback(self.machine.controllers)
        try:
            if inputs.controller_states is None:
                feedback.preload(holding, inputs.start_pose, inputs.feedforward[0])
            else:
                feedback.load_states(inputs.controller_states)
        except DesignError as error:
            raise ExperimentError(f"{self.machine.name}: {error}") from None
        return Loop(*feedback.arrays)
