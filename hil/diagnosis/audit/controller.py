"""The controller's law replayed: whether the recorded command is what the file says of reference and position.

The law is linear in its error and in its states at row 0, so that gain, delay and start are a linear regression, exact to the command's
last digit. Where it is another law of the same order, its difference equation is one, too (Ljung 1999, chapter 4, without noise).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from controllers.cascade import AxisCommand
from controllers.settings import AxisController
from hil.machine import Machine
from hil.recording import Recording
from hil.recording.recording import UNEQUAL_STEP
from hil.simulation.control_laws import DIGITS, Part, command_resolution, free_rows, law_from_rest, of_states, part_of, rounding

LATEST_ROWS = 16
"""Of a command that comes late."""
TOLERANCE = 1e-3
"""Of a gain: a law whose gain is off by less is the file's, whose numbers have four digits."""
FEWEST_ROWS_AT_LIMIT = 3
"""One after the other: a peak has one row."""
BESIDE = 1e-6
"""Share of the largest reference by which a target may be beside it and be it: text files have nine digits, and no bench adds so little."""
Status = Literal["as_filed", "differs", "unknown"]


@dataclass(frozen=True)
class Measured:
    """A number that was measured, beside the machine file's; the interval holds it in 95 of 100 cases."""

    value: float | None
    ci95: tuple[float, float] | None
    file: float | None


@dataclass(frozen=True)
class AxisAudit:
    """What the recordings show of one axis's controller.

    Attributes
    ----------
    axis : str
    status : "as_filed", "differs" or "unknown"
        Unknown where no law of this order gives the recorded command.
    gain : Measured
        Of the recorded command over the file's law; negative for a wrong sign.
    delay_s, saturation, rate_Hz, offset : Measured
        How late the command is, where it ends, how often it changes, and what it has at row 0 beyond what holds the machine.
    replayed_rms : float
        Of what is left beside the best law, in the drive's unit.
    resolution : float
        Of the recorded command.
    said : str
        In one sentence.
    """

    axis: str
    status: Status
    gain: Measured
    delay_s: Measured
    saturation: Measured
    rate_Hz: Measured
    offset: Measured
    replayed_rms: float
    resolution: float
    said: str


def audit_controllers(machine: Machine, recordings: Sequence[Recording]) -> list[AxisAudit]:
    """Audit every axis whose command, reference and position were recorded at the machine's own sample rate.

    Of a drive with loops of its own the bench's law is audited: the velocities, or the corrections of the position, that it asked for.
    """
    found = []
    for number, controller in enumerate(machine.controllers):
        command = machine.commands[number] if machine.commands else None
        parts = [part for recording in recordings if (part := _part(machine, recording, controller.axis, command)) is not None]
        if parts:
            law = controller if command is None else command.controller
            found.append(_audit(machine, law, parts, machine.command_unit(number)))
    return found


def recorded_laws(machine: Machine) -> list[AxisController]:
    """Return the laws in effort whose commands were recorded.

    Those of drives with loops of their own are made from the law (`hil.simulation.in_effort`), and show nothing of it.
    """
    return [law for law, command in zip(machine.controllers, machine.commands, strict=False) if command is None]


def _part(machine: Machine, recording: Recording, axis: str, own: AxisCommand | None) -> Part | None:
    asked = "command" if own is None or f"target_{axis}" not in recording else "target"  # as `hil.simulation.in_effort` names it
    period = 1.0 / machine.sample_rate_Hz
    part = part_of(recording, axis, asked)
    if part is None or np.any(np.abs(np.diff(recording.time) - period) > UNEQUAL_STEP * period):
        return None
    if own is None:
        return part
    if recording.channel(f"{asked}_{axis}").unit != machine.command_unit(machine.axis_index(axis)):
        return None
    command = part.command - part.reference if own.mode == "position" else part.command
    return replace(part, command=command, added=np.zeros(len(command)))  # efforts are added behind the drive's loops


def _audit(machine: Machine, controller: AxisController, parts: Sequence[Part], unit: str) -> AxisAudit:
    period = 1.0 / machine.sample_rate_Hz
    commands = np.concatenate([part.command for part in parts])
    if not _asks(controller):
        return _audit_of_none(machine, controller, commands, parts, unit)
    resolution = command_resolution(commands)
    limit = _limit(parts, resolution)
    free = [free_rows(part, min(limit or np.inf, controller.limit), resolution) for part in parts]
    held = _rows_held(parts, free, resolution)
    enough = rounding(commands, resolution)
    delays = [_regressed(controller, parts, free, delay) for delay in range(LATEST_ROWS + 1)]
    delay = int(np.argmin([each[2] for each in delays]))
    gain, deviation, rms, offset = delays[delay]
    if limit is not None and _regressed(controller, parts, [np.ones(len(part.command), dtype=bool) for part in parts], delay)[2] <= enough:
        limit = None  # the law itself stays there
    saturates = limit is not None and limit < controller.limit * (1.0 - TOLERANCE)
    if not _is_moved(controller, parts, free, delay):
        gain = deviation = float("nan")
    status: Status = "unknown"
    said = f"{controller.axis}: no law of the file's order gives the recorded command; {rms:.2g} {unit} rms are left of it"
    if not np.isfinite(rms):
        said = f"{controller.axis}: too few rows of the command are within its limit to say which law gives it"
    elif rms <= enough:
        wrong = []
        if abs(gain - 1.0) > max(TOLERANCE, 2.0 * deviation):
            wrong.append(f"{gain:.3f} times what the file's controller computes from the recorded reference and position")
        if delay:
            wrong.append(f"{delay} rows ({1e3 * delay * period:.3g} ms) late")
        if saturates:
            wrong.append(f"limited to {limit:.4g} {unit}; the file says {controller.limit:.4g} {unit}")
        status = "differs" if wrong else "as_filed"
        said = f"{controller.axis}: the recorded command is " + (", ".join(wrong) if wrong else "what the file's controller computes")
        said += f" (residual {rms:.1g} {unit})"
    elif held > 1:
        status = "differs"
        rate = machine.sample_rate_Hz / held
        said = f"{controller.axis}: the recorded command changes every {held} rows: the controller runs at {rate:.4g} Hz, not the file's"
        said += f" {machine.sample_rate_Hz:.4g} Hz"
    elif _another_law(controller, parts, free) <= enough:
        status = "differs"
        said = f"{controller.axis}: the recorded command is that of another law than the file's, of the same order"
    return AxisAudit(
        controller.axis,
        status,
        Measured(gain, (gain - 1.96 * deviation, gain + 1.96 * deviation), 1.0) if np.isfinite(gain) else Measured(None, None, 1.0),
        Measured(delay * period, None, 0.0),
        Measured(limit, None, controller.limit),
        Measured(machine.sample_rate_Hz / held, None, machine.sample_rate_Hz),
        Measured(offset if np.isfinite(rms) else None, None, None),
        rms,
        resolution,
        said,
    )


def _asks(controller: AxisController) -> bool:
    """Return whether a law ever gives anything; in position mode a file may have none beside the reference."""
    sections = (controller.position_sections, controller.reference_sections)
    return any(each is not None and each[:, :3].any(axis=1).all() for each in sections)


def _audit_of_none(machine: Machine, controller: AxisController, commands: np.ndarray, parts: Sequence[Part], unit: str) -> AxisAudit:
    """Audit a command that is to be nothing, beside the rounding of a reference that was subtracted."""
    largest, rms = max(float(np.abs(part.reference).max()) for part in parts), float(np.sqrt(np.mean(commands**2)))
    status: Status = "as_filed" if rms <= BESIDE * largest else "differs"
    said = (
        f"{controller.axis}: the target is {'' if status == 'as_filed' else 'not '}the reference, as the file says ({rms:.1g} {unit} rms)"
    )
    nothing, rate = Measured(None, None, None), machine.sample_rate_Hz
    every = Measured(rate, None, rate)
    return AxisAudit(controller.axis, status, nothing, nothing, Measured(None, None, controller.limit), every, nothing, rms, 0.0, said)


def law_leaves(controller: AxisController, part: Part) -> tuple[float, bool]:
    """Return the gain of a command over the law, and whether the law leaves nothing of it but rounding."""
    resolution = command_resolution(part.command)
    free = [free_rows(part, min(_limit([part], resolution) or np.inf, controller.limit), resolution)]
    gain, _, rms, _ = _regressed(controller, [part], free, 0)
    return gain, bool(rms <= rounding(part.command, resolution))


def _rows_held(parts: Sequence[Part], free: Sequence[np.ndarray], resolution: float) -> int:
    """Return after how many rows the law's part of the command changes, at most."""
    gaps = []
    for part, rows in zip(parts, free, strict=True):
        changes = (np.abs(np.diff(part.command - part.added)) > 0.5 * resolution) & rows[1:] & rows[:-1]
        gaps.append(np.diff(np.flatnonzero(changes)))
    every = np.concatenate(gaps)
    return int(np.gcd.reduce(every)) if every.size > 1 else 1


def _limit(parts: Sequence[Part], resolution: float) -> float | None:
    """Return where the commands end, for some rows on end; None where they end nowhere."""
    largest = max(float(np.abs(part.command).max(initial=0.0)) for part in parts)
    close = max(1e-3 * resolution, DIGITS * largest)
    for part in parts:
        at_limit = np.abs(np.abs(part.command) - largest) <= close
        runs = np.diff(np.flatnonzero(np.diff(np.concatenate([[False], at_limit, [False]]).astype(int))))[::2]
        if largest > 0.0 and runs.size and runs.max() >= FEWEST_ROWS_AT_LIMIT:
            return largest
    return None


def _regressed(
    controller: AxisController, parts: Sequence[Part], free: Sequence[np.ndarray], delay: int
) -> tuple[float, float, float, float]:
    """Return gain, its standard deviation, the rms that is left, and the start's part of the command, for a law so many rows late."""
    states = of_states(controller, max(len(part.command) for part in parts))
    width = states.shape[1]
    matrix, target = _equations(controller, parts, free, delay)
    if len(target) < 2 * matrix.shape[1]:
        return float("nan"), float("nan"), np.inf, float("nan")
    scale = np.sqrt(np.sum(matrix**2, axis=0))
    scale[scale == 0.0] = 1.0
    u, s, vt = np.linalg.svd(matrix / scale, full_matrices=False)
    kept = s > 1e-12 * s[0]
    weights = (vt[kept].T @ ((u[:, kept].T @ target) / s[kept])) / scale
    left = target - matrix @ weights
    rms = float(np.sqrt(np.mean(left**2)))
    variance = float(np.sum((vt[kept][:, 0] / s[kept]) ** 2)) / scale[0] ** 2
    offset = float(states[0] @ weights[1 : 1 + width])
    return float(weights[0]), rms * float(np.sqrt(variance)), rms, offset


def _equations(controller: AxisController, parts: Sequence[Part], free: Sequence[np.ndarray], delay: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the law from rest and every state's part of the command (rows, 1 + states), and the command (rows,) that they are to give."""
    columns, targets = [], []
    states = of_states(controller, max(len(part.command) for part in parts))
    width = states.shape[1]
    for number, (part, rows) in enumerate(zip(parts, free, strict=True)):
        law = _late(law_from_rest(controller, part), delay)
        own = np.zeros((len(law), width * len(parts)))
        own[delay:, width * number : width * (number + 1)] = states[: len(law) - delay]
        used = rows & (np.arange(len(law)) >= delay)
        columns.append(np.column_stack([law, own])[used])
        targets.append((part.command - part.added)[used])
    return np.vstack(columns), np.concatenate(targets)


def _is_moved(controller: AxisController, parts: Sequence[Part], free: Sequence[np.ndarray], delay: int) -> bool:
    """Return whether the law gives more than its states at row 0 do: of a lead on a reference that rests nobody sees the gain."""
    matrix, _ = _equations(controller, parts, free, delay)
    law, states = matrix[:, 0], matrix[:, 1:]
    left = law - states @ np.linalg.lstsq(states, law, rcond=None)[0]
    return bool(np.sqrt(np.sum(left**2)) > DIGITS * np.sqrt(np.sum(law**2)))


def _late(values: np.ndarray, rows: int) -> np.ndarray:
    return np.concatenate([np.zeros(rows), values[: len(values) - rows]])


def _another_law(controller: AxisController, parts: Sequence[Part], free: Sequence[np.ndarray]) -> float:
    """Return the rms that the best difference equation of the file's order leaves of the command's change by it."""
    order = 2 * max(len(controller.position_sections), 0 if controller.reference_sections is None else len(controller.reference_sections))
    columns, targets = [], []
    for part, rows in zip(parts, free, strict=True):
        output = part.command - part.added
        inputs = [part.reference - part.position] if controller.reference_sections is None else [part.reference, part.position]
        lags = [np.roll(output, k) for k in range(1, order + 1)] + [np.roll(each, k) for each in inputs for k in range(order + 1)]
        used = rows & (np.arange(len(output)) >= order)
        for k in range(1, order + 1):
            used &= np.roll(rows, k)
        columns.append(np.column_stack(lags)[used])
        targets.append(output[used])
    matrix, target = np.vstack(columns), np.concatenate(targets)
    if len(target) < 3 * matrix.shape[1]:
        return np.inf
    scale = np.sqrt(np.sum(matrix**2, axis=0)) + 1e-300
    weights = np.linalg.lstsq(matrix / scale, target, rcond=1e-13)[0] / scale
    return float(np.sqrt(np.mean((target - matrix @ weights) ** 2)))
