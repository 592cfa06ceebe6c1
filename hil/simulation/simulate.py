"""Simulation of a recording without noise, from its reference and excitation and the machine file alone."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from math import isfinite, isnan

import numpy as np
from numpy.typing import ArrayLike

from hil.errors import RecordingError
from hil.machine import AxisUnits, Machine
from hil.recording import Channel, Recording, recording_metadata
from hil.recording.channels import imu_channels
from hil.recording.ticks import on_every_tick
from hil.simulation.commands import commanded
from hil.simulation.control_laws import states_at_start
from hil.simulation.inputs import Inputs
from hil.simulation.simulator import Outputs, Simulator
from virtual_bus.settings import EffectSetting

RATE_TOLERANCE = 1e-3
"""Largest relative deviation of a recorder's clock from the machine file's rate; more is another rate."""

IMU_UNITS = ("m/s^2",) * 3 + ("rad/s",) * 3
"""Of an IMU's six channels."""


def simulate(machine: Machine, recording: Recording, effects: Sequence[EffectSetting] = ()) -> Recording:
    """Simulate what a machine would have recorded.

    A machine with controllers runs in closed loop from the recording's reference and excitation; one without is driven by its command.
    Row 0 is standstill in elastic equilibrium at the experiment's start pose, else at the first reference, else at each axis' first
    measured position (of its motor, else of its link; 0 where there is none), with the controller states of the recording's metadata,
    else with those that give the recorded command, at the first measured position, else with integrators at the holding effort. Where
    the metadata say how far from the start pose the machine stood (`initial.standing.deviation`), the simulation stands there. Metadata
    `initial.speeds`, where a recording begins in motion, are the axes' speeds at row 0. What an observer's damping added to the command
    (`damping_A`) is part of the excitation: the simulation runs with that loop open.

    Parameters
    ----------
    machine : Machine
    recording : Recording
    effects : sequence of EffectSetting, optional
        Physics added to the machine's own.

    Returns
    -------
    Recording
        The same rows: inputs, command, measured effort, encoders and IMU. Temperatures are left out: how warm the windings were at row 0
        is not in a recording's inputs.

    Raises
    ------
    RecordingError
        The reference (or command) is missing or has a hole, or the sample rate is not the machine's.
    BadAnswerError
        The simulation diverged.
    """
    whole = on_every_tick(recording)
    inputs = inputs_of(machine, whole)
    outputs = Simulator(machine).run(inputs, effects=(*machine.plant.effects, *effects))
    simulated = as_recording(machine.with_effects((*machine.plant.effects, *effects)), whole, inputs, outputs)
    return simulated if whole is recording else simulated.part(recording.ticks)


def inputs_of(machine: Machine, recording: Recording) -> Inputs:
    """Return the inputs of a simulation from a recording of this machine; RecordingError where they are incomplete."""
    rate = recording.sample_rate_Hz
    if abs(rate / machine.sample_rate_Hz - 1.0) > RATE_TOLERANCE:
        raise RecordingError(f"the recording has {rate:g} rows a second; {machine.name} runs at {machine.sample_rate_Hz:g} Hz")
    shape = (recording.rows, len(machine.axes))
    closed = bool(machine.controllers)
    reference = _complete(machine, recording, "reference") if closed else None
    command = None if closed else _complete(machine, recording, "command")
    excitation = _complete(machine, recording, "excitation", np.zeros(shape))
    if closed:  # the command of damping as recorded: the observer is not simulated
        excitation = excitation + _complete(machine, recording, "damping", np.zeros(shape))
    feedforward = _feedforward(machine, recording, shape)
    initial = recording.metadata.get("initial", {})
    states = initial.get("controller_states") if closed else None
    if states is not None:
        _check_states(machine, states)
    elif closed:
        states = states_at_start(machine, recording)
    was_read = closed and states is not None and "controller_states" not in initial
    pose = _start_pose(machine, recording, None if was_read else reference)  # the states belong to what the law read
    speed = _per_axis(machine, initial.get("speeds"), "initial.speeds")
    standing = initial.get("standing", {})
    if not isinstance(standing, dict):
        raise RecordingError(f"metadata initial.standing is {standing!r}; a table with `deviation` would be right")
    deviation = _per_axis(machine, standing.get("deviation"), "initial.standing.deviation", is_a_reading=True)
    if deviation is not None:  # a missing reading counts as no deviation
        deviation = np.nan_to_num(deviation)
    return Inputs(reference, excitation, feedforward, command, pose, states, speed, deviation)


def as_recording(machine: Machine, recording: Recording, inputs: Inputs, outputs: Outputs) -> Recording:
    """Return outputs as channels beside the recording's time and inputs."""
    channels: dict[str, Channel] = {"time": recording.channel("time")}

    def add(group: str, values: np.ndarray, unit_of: Callable[[AxisUnits], str]) -> None:
        for i, units in enumerate(machine.units):
            if not np.isnan(values[:, i]).all():  # no such sensor
                name = "current" if group == "effort" and units.effort == "A" else group
                channels[f"{name}_{units.axis}"] = Channel(unit_of(units), values[:, i])

    if inputs.reference is not None:
        add("reference", inputs.reference, _position_unit)
        add("excitation", inputs.excitation, _effort_unit)
        add("feedforward", inputs.feedforward, _effort_unit)
    for i, units in enumerate(machine.units):
        channels[f"command_{units.axis}"] = Channel(machine.command_unit(i), _command(machine, i, inputs, outputs))
    add("effort", outputs.effort, _effort_unit)
    add("position", outputs.position, _position_unit)
    add("link_position", outputs.link_position, _position_unit)
    add("speed", outputs.speed, _speed_unit)
    for (name, unit), values in zip(imu_units(machine).items(), outputs.imu.T, strict=True):
        channels[name] = Channel(unit, values)
    made = {"noise": False, "effects": _in_words(machine)}
    metadata = recording_metadata(machine, experiment=recording.experiment or None, simulation=made)
    return Recording(channels, metadata)


def imu_units(machine: Machine) -> dict[str, str]:
    """Return the channels of all IMUs in the order of their readings, with their units."""
    names = [name for imu in machine.plant.imus for name in imu_channels(imu.name)]
    return dict(zip(names, len(machine.plant.imus) * IMU_UNITS, strict=True))


def _command(machine: Machine, axis: int, inputs: Inputs, outputs: Outputs) -> np.ndarray:
    """Return the command of an axis: an effort, or what a drive with loops of its own is asked for."""
    command = machine.commands[axis]
    if command is None or inputs.reference is None:
        return outputs.command[:, axis]
    return commanded(command, inputs.reference[:, axis], outputs.position[:, axis])


def _position_unit(units: AxisUnits) -> str:
    return units.position


def _speed_unit(units: AxisUnits) -> str:
    return f"{units.position}/s"


def _effort_unit(units: AxisUnits) -> str:
    return units.effort


def _in_words(machine: Machine) -> list[str]:
    """Return the physics added to the machine file, a line each, because the file's hash does not include them."""
    return [
        f"{effect.name} at {effect.at}: " + ", ".join(f"{name} = {value!r}" for name, value in effect.parameters.items())
        for effect in machine.added_effects
    ]


def _complete(
    machine: Machine, recording: Recording, group: str, default: np.ndarray | None = None, *, of: Sequence[bool] | None = None
) -> np.ndarray:
    """Return values (N, n_axes) without a hole; the default, if any, for an axis that is not recorded. `of` selects axes."""
    names = [f"{group}_{axis}" for axis in machine.axes]
    columns = []
    for i, (name, units) in enumerate(zip(names, machine.units, strict=True)):
        if of is not None and not of[i]:
            continue
        if default is not None and name not in recording:
            columns.append(default[:, i])
            continue
        channel = recording.channel(name)
        wanted = units.position if group == "reference" else units.effort
        if channel.unit != wanted:
            raise RecordingError(f"{name} is in [{channel.unit}]; {machine.name} takes it in [{wanted}]")
        holes = np.flatnonzero(~np.isfinite(channel.values))
        if holes.size:
            row = int(holes[0])
            raise RecordingError(f"{name} is missing in row {row} ({recording.time[row]:.6g} s); a simulation needs every row of it")
        columns.append(channel.values)
    return np.column_stack(columns)


def _check_states(machine: Machine, states: Mapping[str, Mapping[str, ArrayLike]]) -> None:
    """Raise RecordingError where the metadata's controller states do not fit this machine's axes."""
    for axis in machine.axes:
        try:
            for values in states[axis].values():
                if not np.isfinite(np.asarray(values, dtype=float)).all():
                    raise ValueError
        except (AttributeError, KeyError, TypeError, ValueError):
            right = "a table of numbers for each filter of each axis would be right"
            raise RecordingError(f"metadata initial.controller_states is {states!r} of {axis}; {right}") from None


def _start_pose(machine: Machine, recording: Recording, reference: np.ndarray | None) -> np.ndarray:
    pose = _per_axis(machine, recording.experiment.get("start_pose"), "experiment.start_pose")
    if pose is not None:
        return pose
    if reference is not None:
        first: np.ndarray = reference[0].copy()
        return first
    pose = np.zeros(len(machine.axes))
    for i, axis in enumerate(machine.axes):
        if (name := position_channel(recording, axis)) is not None:
            values = recording[name]
            pose[i] = values[np.isfinite(values)][0]
    return pose


def position_channel(recording: Recording, axis: str) -> str | None:
    """Return the channel of an axis' measured position: motor encoder, else link encoder; None where neither has a reading."""
    names = (f"position_{axis}", f"link_position_{axis}")
    return next((name for name in names if name in recording and np.isfinite(recording[name]).any()), None)


def _per_axis(machine: Machine, values: Sequence[float] | None, key: str, *, is_a_reading: bool = False) -> np.ndarray | None:
    """Return metadata (n_axes,); None where there are none. A reading may be missing."""
    if values is None:
        return None
    numbers = isinstance(values, list | tuple) and all(isinstance(value, int | float) and not isinstance(value, bool) for value in values)
    if not numbers or not all(isfinite(value) or (is_a_reading and isnan(value)) for value in values):
        raise RecordingError(f"metadata {key} is {values!r}; a list of {len(machine.axes)} numbers, one per axis, would be right")
    if len(values) != len(machine.axes):
        raise RecordingError(f"metadata {key} has {len(values)} entries; {machine.name} has {len(machine.axes)} axes")
    return np.array(values, dtype=float)


def axes_with_feedforward(machine: Machine) -> set[str]:
    """Return the axes whose controllers add feedforward by the machine file; their simulation uses the recorded one."""
    return {controller.axis for controller in machine.controllers if controller.gravity_feedforward}


def _feedforward(machine: Machine, recording: Recording, shape: tuple[int, int]) -> np.ndarray:
    """Return the feedforward as recorded: a function of the reference, computed before the run."""
    values = np.zeros(shape)
    adds = [axis in axes_with_feedforward(machine) for axis in machine.axes]
    if any(adds):
        values[:, adds] = _complete(machine, recording, "feedforward", of=adds)
    return values
