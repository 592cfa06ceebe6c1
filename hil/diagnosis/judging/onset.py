"""What noise does to a machine that rested until the record began.

Repeats differ by disturbances that are there throughout. A run begins from rest: the speed and the deviation that they would have left the
machine with by then are missing, and go through the loop from the first row on. That is noise of a record's begin alone, which spectra of
the whole record hardly show, and of three or four repeats all may begin to the same side.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from hil.diagnosis.judging.form_error import NO_ERROR, FormError
from hil.diagnosis.residuals.noise import NoiseModel, sensor_floor
from hil.diagnosis.residuals.spectra import gains_of
from hil.diagnosis.starting.motion import HIGHEST_EFFORT_Hz, highest_seen_Hz
from hil.diagnosis.tuning.free_run import FreeRuns
from hil.diagnosis.tuning.retune import Tuning
from hil.machine import Machine
from hil.simulation import Inputs, Simulator
from hil.simulation.smooth import simulated_matrix, smooth


def onset(runs: FreeRuns, name: str, tuning: Tuning) -> FormError:
    """What noise gives every axis of a set's groups at the first row, a speed and a deviation, with standard deviation one each.

    Nothing is known of noise that no repeats show, of what a group that begins within a record begins with, of joints that nothing holds,
    nor of a machine that cannot be simulated.

    Parameters
    ----------
    runs : FreeRuns
    name : str
        Of the set.
    tuning : Tuning
        Of the machine's numbers.
    """
    found, machine = runs.sets[name], runs.machine
    begin = [k for k, group in enumerate(found.groups) if len(group.windows) == 1 and not group.windows[0].start]
    if found.noise.kind != "repeats":
        return NO_ERROR
    rows = []
    for k in begin:
        own = found.groups[k]
        simulator = Simulator(smooth(own.machine))
        run = partial(_rows, simulator, tuning.values, found.channels)
        speed, deviation = (
            np.zeros(len(machine.axes)) if given is None else given for given in (own.inputs.start_speed, own.inputs.deviation)
        )
        base = run(own.inputs)
        if base is None:
            continue
        for i, axis in enumerate(machine.axes):
            if f"position_{axis}" not in found.channels or not _is_held(machine, i):
                continue
            apart, fast = _deviation_and_speed(found.noise, found.channels, axis, machine)
            one = np.eye(len(machine.axes))[i] / np.sqrt(own.repeats)  # of their mean
            for begun in (
                replace(own.inputs, start_speed=speed + fast * one),
                replace(own.inputs, deviation=deviation + apart * one),
            ):
                changed = run(begun)
                if changed is None:
                    continue
                answer = [np.zeros((len(group.time_s), len(found.channels))) for group in found.groups]
                answer[k] = changed - base
                rows.append(runs.joined(answer, name))
    return FormError(np.stack(rows)) if rows else NO_ERROR


def _is_held(machine: Machine, axis: int) -> bool:
    """Whether a loop or a spring takes an axis back to where it was."""
    tree = machine.plant.tree
    return bool(machine.controllers) or tree.joints[tree.joint_index(machine.plant.drives[axis].joint)].stiffness > 0.0


def _rows(simulator: Simulator, values: np.ndarray, channels: tuple[str, ...], inputs: Inputs) -> np.ndarray | None:
    """(N, C); None where the machine cannot stand or the simulation diverges."""
    outputs = simulator.run_or_error(inputs, values, None)
    return None if isinstance(outputs, Exception) else simulated_matrix(simulator.machine, outputs, channels)


def _deviation_and_speed(noise: NoiseModel, channels: tuple[str, ...], axis: str, machine: Machine) -> tuple[float, float]:
    """Rms of an axis' deviation and of its speed in one repeat, without what its encoder adds: its rounding, and noise as there is where
    nothing moves.
    """
    c = channels.index(f"position_{axis}")
    power = noise.own[:, c] ** 2 / gains_of(noise.filters, noise.grid_Hz, noise.rate_Hz)[:, c]
    too_fast = noise.grid_Hz > highest_seen_Hz(HIGHEST_EFFORT_Hz, noise.rate_Hz)
    of_encoder = max(sensor_floor(channels, machine)[c] ** 2, float(np.median(power[too_fast])) if np.any(too_fast) else 0.0)
    power = np.where(too_fast, 0.0, np.maximum(power - of_encoder, 0.0))
    squares = [np.trapezoid(power * weight, noise.grid_Hz) / (0.5 * noise.rate_Hz) for weight in (1.0, (2.0 * np.pi * noise.grid_Hz) ** 2)]
    return float(np.sqrt(squares[0])), float(np.sqrt(squares[1]))
