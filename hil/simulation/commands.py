"""Commands of drives that close loops of their own: from positions to what the bench asks for, and to the effort that follows."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from controllers.cascade import AxisCommand
from controllers.errors import DesignError
from controllers.feedback import Feedback
from hil.errors import RecordingError
from hil.machine import Machine, machine_from_text
from hil.recording import Channel, Recording


def commanded(command: AxisCommand, reference: np.ndarray, position: np.ndarray) -> np.ndarray:
    """Return what a bench commands of one axis that begins at standstill.

    Parameters
    ----------
    command : AxisCommand
    reference, position : (N,) arrays
        [rad or m]; a missing position repeats the last command.

    Returns
    -------
    (N,) array
        Velocities [rad/s or m/s] or positions [rad or m].
    """
    feedback, nothing = Feedback([command.controller]), np.zeros((len(reference), 1))
    feedback.preload(nothing[0], reference[:1])
    own = _stepped(feedback, reference[:, None], position[:, None], nothing, nothing)[:, 0]
    return reference + own if command.mode == "position" else own


def in_effort(recording: Recording, machine: Machine | None = None) -> Recording:
    """Return a recording whose `command_A` are efforts, for axes whose drives close loops of their own: what these loops asked for.

    The efforts follow from the recorded positions by the law of bench and drive together; what the bench commanded becomes `target_A`. A
    recording of efforts is returned as it is, one without references, as of a foreign master's bus, without the efforts.

    Parameters
    ----------
    recording : Recording
    machine : Machine, optional
        For a recording that carries no machine file of its own.

    Raises
    ------
    RecordingError
        A channel or state is missing from which the efforts follow.
    """
    text = recording.metadata.get("machine", {}).get("text")
    if isinstance(text, str):
        machine = machine_from_text(text, label="the recording's own machine file")
    if machine is None or not any(machine.commands):
        return recording
    led = [axis for axis, command in zip(machine.axes, machine.commands, strict=True) if command is not None]
    if not any(f"command_{axis}" in recording for axis in led):
        return recording
    targets = {f"command_{axis}": f"target_{axis}" for axis in led}
    channels = {targets.get(name, name): channel for name, channel in recording.channels.items()}
    if not any(f"reference_{axis}" in recording for axis in machine.axes):
        return replace(recording, channels=channels)
    efforts = _efforts(machine, recording)
    for axis in led:
        column = machine.axis_index(axis)
        channels[f"command_{axis}"] = Channel(machine.units[column].effort, efforts[:, column])
    return replace(recording, channels=channels)


def _efforts(machine: Machine, recording: Recording) -> np.ndarray:
    names = machine.axes
    reference, position = (recording.matrix([f"{group}_{axis}" for axis in names]) for group in ("reference", "position"))
    for column, command in enumerate(machine.commands):
        missing = np.isnan(position[:, column])
        if command is not None and missing.any() and not missing.all():  # its drive closed its loops all the same: `Control.catch_up`
            rows = np.arange(len(missing))
            position[missing, column] = np.interp(rows[missing], rows[~missing], position[~missing, column])
    excitation, damping, feedforward = (
        np.column_stack([_or_zero(recording, f"{group}_{axis}") for axis in names]) for group in ("excitation", "damping", "feedforward")
    )
    feedback = Feedback(machine.controllers)
    states = recording.metadata.get("initial", {}).get("controller_states")
    if not isinstance(states, Mapping):
        raise RecordingError(
            "the metadata have no initial.controller_states, from which the efforts of drives in velocity or position mode follow; "
            "recordings of `isocenter run` have them"
        )
    try:
        feedback.load_states(states)
    except DesignError as error:
        raise RecordingError(f"metadata initial.{error}") from None
    return _stepped(feedback, reference, position, excitation + damping, feedforward)


def _or_zero(recording: Recording, name: str) -> np.ndarray:
    return recording[name] if name in recording else np.zeros(recording.rows)


def _stepped(
    feedback: Feedback, reference: np.ndarray, position: np.ndarray, excitation: np.ndarray, feedforward: np.ndarray
) -> np.ndarray:
    """Return the commands (N, n_axes) of a feedback, row by row."""
    r, y, w, ahead = (np.ascontiguousarray(each, dtype=float) for each in (reference, position, excitation, feedforward))
    out = np.zeros(reference.shape)
    for k in range(len(out)):
        feedback.step(r[k], y[k], w[k], ahead[k], out[k])
    return out
