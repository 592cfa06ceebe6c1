"""The file's control laws beside what was recorded: what they give from rest, and from the states that they had at row 0."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy.signal

from controllers.settings import AxisController
from hil.machine import Machine
from hil.machine.load import machine_from_text
from hil.recording import Recording

RELATIVE_ERROR = 1e-4
"""Share of the command's rms that a law may leave and be the law: positions in text files have nine digits, of which a lead takes five."""
STEPS = 3.0
"""Times the rms that rounding to the command's own lattice leaves."""
DIGITS = 1e-9
"""Share of the largest command below which two commands are the same."""
MOST_STEPS = 1e7
"""Steps of a lattice that a command's range may have, so that it is one: finer are the digits of a number."""


def controllers_of(machine: Machine, recording: Recording) -> Machine:
    """Return the machine with the controllers that a recording says it was made with.

    A recording may have been made under a softer controller than the file's; its metadata hold its own machine file.
    """
    text = recording.metadata.get("machine", {}).get("text")
    if not isinstance(text, str) or text == machine.text:
        return machine
    own = machine_from_text(text, label="the recording's own machine file")
    return replace(machine, controllers=own.controllers, commands=own.commands) if own.axes == machine.axes else machine


@dataclass(frozen=True, eq=False)
class Part:
    """One recording of one axis: what the law takes and gives, row by row."""

    reference: np.ndarray
    position: np.ndarray
    added: np.ndarray  # excitation and feedforward, which no law changes
    command: np.ndarray


def part_of(recording: Recording, axis: str, asked: str = "command", rows: int | None = None) -> Part | None:
    """Return what an axis's law takes and gives in the first rows of a recording; None where not all of it was recorded."""
    names = (f"reference_{axis}", f"position_{axis}", f"{asked}_{axis}")
    if any(name not in recording for name in names):
        return None
    reference, position, command = (recording[name][:rows] for name in names)
    further = [name for name in (f"excitation_{axis}", f"feedforward_{axis}", f"damping_{axis}") if name in recording]
    part = Part(reference, position, sum((recording[name][:rows] for name in further), np.zeros(len(command))), command)
    return part if all(np.isfinite(each).all() for each in vars(part).values()) else None


def law_from_rest(controller: AxisController, part: Part) -> np.ndarray:
    """Return what the file's law gives (rows,) with all states zero at row 0."""
    if controller.reference_sections is None:
        law: np.ndarray = scipy.signal.sosfilt(controller.position_sections, part.reference - part.position)
        return law
    asked = scipy.signal.sosfilt(controller.reference_sections, part.reference)
    law = asked - scipy.signal.sosfilt(controller.position_sections, part.position)
    return law


def of_states(controller: AxisController, rows: int) -> np.ndarray:
    """Return what every state at row 0 adds to the command (rows, states): of the position's sections, then of the reference's."""
    found = []
    for sections, sign in ((controller.position_sections, -1.0), (controller.reference_sections, 1.0)):
        if sections is None:
            continue
        for section in range(len(sections)):
            for state in range(2):
                start = np.zeros((len(sections), 2))
                start[section, state] = 1.0 if controller.reference_sections is None else sign
                found.append(scipy.signal.sosfilt(sections, np.zeros(rows), zi=start)[0])
    return np.column_stack(found)


def states_at_start(machine: Machine, recording: Recording, *, with_gain: bool = False) -> dict[str, dict[str, np.ndarray]] | None:
    """Return the states at row 0 with which the file's laws give the recorded commands to the last digit, as `Feedback.states`.

    The command is linear in them (Oppenheim and Schafer 2010, chapter 6).

    Parameters
    ----------
    machine : Machine
    recording : Recording
        Its reference, position and command, in efforts.
    with_gain : bool
        Whether a command may be a share of the law's, as drives with another gain give it; states are then those of the law.

    Returns
    -------
    dict or None
        None where not all of that was recorded, or a law leaves more than rounding.
    """
    found = {}
    for controller, own in zip(machine.controllers, machine.commands, strict=True):
        part = part_of(recording, controller.axis)
        states = None if part is None or own is not None else _states(controller, part, with_gain)
        if states is None:
            return None
        found[controller.axis] = states
    return found


def _states(controller: AxisController, part: Part, with_gain: bool) -> dict[str, np.ndarray] | None:
    resolution = command_resolution(part.command)
    rows, enough = free_rows(part, controller.limit, resolution), rounding(part.command, resolution)
    law, adds = law_from_rest(controller, part), of_states(controller, len(part.command))
    target = part.command - part.added
    states, left = _fitted(adds, target - law, rows)
    if _off(controller, part, law + adds @ states) > enough:
        if not with_gain or left <= enough:
            return None
        weights, _ = _fitted(np.column_stack([law, adds]), target, rows)
        if not weights[0] > 0.0 or _off(controller, part, weights[0] * law + adds @ weights[1:]) > enough:
            return None
        states = weights[1:] / weights[0]
    count = 2 * len(controller.position_sections)
    table = {"position": states[:count].reshape(-1, 2)}
    return table if controller.reference_sections is None else table | {"reference": states[count:].reshape(-1, 2)}


def _fitted(columns: np.ndarray, target: np.ndarray, rows: np.ndarray) -> tuple[np.ndarray, float]:
    """Return the weights of columns that leave least of some rows of a target, and the rms that they leave; inf of too few rows."""
    if rows.sum() < 2 * columns.shape[1]:
        return np.zeros(columns.shape[1]), np.inf
    scale = np.maximum(np.sqrt(np.sum(columns**2, axis=0)), 1e-300)
    weights: np.ndarray = np.linalg.lstsq(columns[rows] / scale, target[rows], rcond=1e-12)[0] / scale
    return weights, float(np.sqrt(np.mean((target - columns @ weights)[rows] ** 2)))


def _off(controller: AxisController, part: Part, law: np.ndarray) -> float:
    """Return the rms of the command less a law's, within the limit, over all rows."""
    given = np.clip(law + part.added, -controller.limit, controller.limit)
    return float(np.sqrt(np.mean((part.command - given) ** 2)))


def rounding(commands: np.ndarray, resolution: float) -> float:
    """Return the rms that a law may leave of commands."""
    return STEPS * resolution / float(np.sqrt(12.0)) + RELATIVE_ERROR * float(np.sqrt(np.mean(commands**2)))


def command_resolution(commands: np.ndarray) -> float:
    """Return the step of the lattice that commands lie on; their last digits where they lie on none."""
    largest = float(np.abs(commands).max(initial=0.0))
    steps = np.diff(np.unique(commands))
    steps = steps[steps > DIGITS * largest]
    if not steps.size:
        return DIGITS * largest
    step = float(steps.min())
    on_lattice = np.abs(commands / step - np.round(commands / step)).max() < 1e-3
    return step if on_lattice and largest / step < MOST_STEPS else DIGITS * largest


def free_rows(part: Part, limit: float, resolution: float) -> np.ndarray:
    """Return the rows whose command is within its limit."""
    free: np.ndarray = np.abs(part.command) < limit - max(resolution, DIGITS * limit)
    return free
