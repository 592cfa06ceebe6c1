"""Which equation is short: the effort every joint would have to feel, and what is left for the sensors.

Small deviations of the closed loop are linear: residual(f) = T(f) d(f) + sensors(f) + noise(f), with d the missing efforts on the joints
and T the response from them to the channels, controller and one row of delay included. d is the least-squares estimate in units of noise
with a prior that keeps it finite where no channel sees it; what T d does not reproduce is left to the sensor equations.
Kailath, Sayed, Hassibi 2000, ch. 3 (smoothing as linear estimation); it uses the whole record, before and after each row.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.polynomial.polynomial import polyval

from hil.diagnosis.residuals.excess import certain_excess
from hil.diagnosis.residuals.mismatch import Mismatch
from hil.diagnosis.residuals.repeat_group import RepeatGroup
from hil.diagnosis.residuals.whitened import in_noise_units
from hil.diagnosis.result import DisturbanceShares
from hil.machine import Machine
from virtual_bus.plant.compiled import compile_plant
from virtual_bus.plant.linearise import linearised
from virtual_bus.plant.statics import equilibrium

PRIOR_OF_EFFORT = 1.0
"""Rms of a joint's missing effort beforehand, as a share of the drives' largest rms effort on their joints."""

PRIOR_CORNER_Hz = 1.0
"""Above it that effort's spectrum falls with the square of frequency, as that of a friction which reverses does."""

END_s = 0.5
"""Of a record at either end in which the estimate goes to zero: longer than loops remember."""

LOWEST_Hz = 1e-4
"""Stands for zero: a free joint's response to a constant effort is not finite, nor is an integrator's gain."""

LEAST_PRIOR = 1e-9
"""In Nm or N, for recordings in which no drive works."""


@dataclass(frozen=True, eq=False)
class Disturbance:
    """What one group's residual asks of the equations.

    Attributes
    ----------
    joints : tuple of str
    effort : (N, joints) array
        Missing effort on each joint [Nm or N], positive towards positive position; it goes to zero within END_s of either end.
    sensors : (N, C) array
        What no effort explains, in the channels' units.
    power, left : (C,) arrays
        Energies of the residual and of what no effort explains, in units of noise, without what noise has in the mean of the repeats.
    left_by_joint : (joints, C) array
        The same of what an effort on each joint does not explain by itself.
    is_used : (C,) array of bool
        Channels that efforts are estimated from.
    """

    joints: tuple[str, ...]
    effort: np.ndarray
    sensors: np.ndarray
    power: np.ndarray
    left: np.ndarray
    left_by_joint: np.ndarray
    is_used: np.ndarray


def disturbance_shares(found: Mismatch, values: np.ndarray | None = None) -> DisturbanceShares:
    """Of all groups together, in the channels that efforts are estimated from and that stand above noise for certain; nothing where none
    does or the simulation has no finite rows.

    Parameters
    ----------
    found : Mismatch
        Beside the simulation whose equations are short.
    values : (parameters,) array, optional
        Its plant parameters; the machine file's by default.
    """
    if not all(np.isfinite(group.simulated).all() for group in found.groups):
        return DisturbanceShares()
    each = [disturbance(found, group, values) for group in found.groups]
    power, left, left_by_joint = (sum(getattr(one, name) for one in each) for name in ("power", "left", "left_by_joint"))
    noise = sum(len(group.mean) / group.repeats for group in found.groups)
    counts = each[0].is_used & (power > certain_excess(noise))
    if not counts.any():
        return DisturbanceShares()
    joints = np.clip(1.0 - left_by_joint[:, counts].sum(axis=1) / power[counts].sum(), 0.0, 1.0)
    sensors = np.clip(left[counts] / power[counts], 0.0, 1.0)
    channels = [name for name, is_counted in zip(found.channels, counts, strict=True) if is_counted]
    return DisturbanceShares(dict(zip(each[0].joints, joints.tolist(), strict=True)), dict(zip(channels, sensors.tolist(), strict=True)))


def disturbance(found: Mismatch, group: RepeatGroup, values: np.ndarray | None = None) -> Disturbance:
    """Estimate one group's missing efforts about its mean pose.

    Parameters
    ----------
    found : Mismatch
        Gives machine, channels and noise.
    group : RepeatGroup
    values : (parameters,) array, optional
        Plant parameters the group was simulated with; the machine file's by default.
    """
    return Estimator(found, group, values).of(group)


class Estimator:
    """Estimates missing efforts along one group's motion: of its residual, and of others that the same loop would leave.

    Parameters
    ----------
    found, group, values
        See `disturbance`.
    """

    def __init__(self, found: Mismatch, group: RepeatGroup, values: np.ndarray | None = None) -> None:
        machine, plant = group.machine, compile_plant(group.machine.plant)
        self._found = found
        self._joints = tuple(joint.name for joint in machine.plant.tree.joints)
        self._is_used = _is_linear(found.channels)
        frequencies = np.fft.rfftfreq(2 * len(group.mean), 1.0 / found.noise.rate_Hz)
        response = loop_response(machine, group.position.mean(axis=0), found.channels, frequencies, values)
        self._response = response[:, :, : len(self._joints)]
        self._weight = _noise_weight(found, frequencies, group.repeats) * self._is_used
        gains = plant.drive_gains(plant.model(values), np.zeros(plant.joints))
        prior = max(PRIOR_OF_EFFORT * float((np.sqrt(np.mean(group.effort**2, axis=0)) * gains).max()), LEAST_PRIOR)
        self._density = prior**2 * found.noise.rate_Hz / (np.pi * PRIOR_CORNER_Hz) / (1.0 + (frequencies / PRIOR_CORNER_Hz) ** 2)
        weighted = self._response * self._weight[:, :, None]
        self._normal = weighted.conj().transpose(0, 2, 1)
        self._hessian = self._normal @ weighted + np.eye(weighted.shape[2]) / self._density[:, None, None]

    def effort(self, residual: np.ndarray) -> np.ndarray:
        """(N, joints) missing efforts [Nm or N] of a residual (N, C)."""
        return np.fft.irfft(self._lines_of_effort(residual), 2 * len(residual), axis=0)[: len(residual)]

    def of(self, group: RepeatGroup) -> Disturbance:
        """What the group's residual asks of the equations."""
        residual = group.mean - group.simulated
        rows, d = len(residual), self._lines_of_effort(residual)
        lines = np.fft.rfft(_tapered(residual, self._found.noise.rate_Hz), axis=0) * self._weight
        left = residual - np.fft.irfft((self._response @ d[:, :, None])[:, :, 0], 2 * rows, axis=0)[:rows]
        by_joint = []
        for j in range(d.shape[1]):
            normal = self._normal[:, j]
            alone = (normal * lines).sum(axis=1) / ((np.abs(normal) ** 2).sum(axis=1) + 1.0 / self._density)
            rest = residual - np.fft.irfft(self._response[:, :, j] * alone[:, None], 2 * rows, axis=0)[:rows]
            by_joint.append(self._above_noise(rest, group))
        effort = np.fft.irfft(d, 2 * rows, axis=0)[:rows]
        power, unexplained = (self._above_noise(signal, group) for signal in (residual, left))
        return Disturbance(self._joints, effort, left, power, unexplained, np.array(by_joint), self._is_used > 0.0)

    def _lines_of_effort(self, residual: np.ndarray) -> np.ndarray:
        """(L, joints) of the record and as much silence after it."""
        lines = np.fft.rfft(_tapered(residual, self._found.noise.rate_Hz), axis=0)
        return np.linalg.solve(self._hessian, self._normal @ (lines * self._weight)[:, :, None])[:, :, 0]

    def _above_noise(self, signal: np.ndarray, group: RepeatGroup) -> np.ndarray:
        return np.maximum(_power(self._found, signal) - len(signal) / group.repeats, 0.0)


def loop_response(
    machine: Machine,
    pose: np.ndarray,
    channels: tuple[str, ...],
    frequencies_Hz: np.ndarray,
    values: np.ndarray | None = None,
    growth_per_s: float = 0.0,
) -> np.ndarray:
    """(L, C, joints + axes) response of the channels to an effort on every joint, and to what every axis' own encoder reads too much, the
    controllers closing the loop.

    y = P_d d + P_u H u + e and u = -C_y y with H the hold and the row of delay between command and effort (docs/explanation/notation.md).
    Without controllers u does not answer. An axis without an encoder of its own answers to no error of it. At s = growth_per_s + 2 pi j f:
    of efforts that grow so, a free joint's response is finite at 0 Hz too.
    """
    plant = compile_plant(machine.plant)
    model = plant.model(values)
    system = linearised(plant, model, pose, by_joint=True)
    axes = len(machine.axes)
    a, b, c, d = system.A, system.B, system.C, system.D
    period_s = 1.0 / machine.sample_rate_Hz
    s = growth_per_s + 2j * np.pi * (frequencies_Hz if growth_per_s > 0.0 else np.maximum(frequencies_Hz, LOWEST_Hz))
    later = np.exp(-s * period_s)  # by one row
    s, hold = s[:, None, None], (later * (1.0 - later) / (s * period_s))[:, None, None]
    from_effort = c @ np.linalg.solve(s * np.eye(len(a)) - a, np.broadcast_to(b.astype(complex), (len(s), *b.shape))) + d
    from_drive = from_effort[:, :, list(plant.joint_of_axis().values())] * plant.drive_gains(model, equilibrium(plant, model, pose))
    labels = list(system.output_labels)
    command = np.zeros((len(s), axes, plant.joints + axes), dtype=complex)
    read = np.array([[label == f"position_{axis}" for axis in machine.axes] for label in labels], dtype=complex)
    seen = np.concatenate([from_effort, np.broadcast_to(read, (len(s), *read.shape))], axis=2)
    if machine.controllers:
        rows = [labels.index(f"position_{axis}") for axis in machine.axes]
        feedback = np.zeros((len(s), axes), dtype=complex)
        for k, controller in enumerate(machine.controllers):
            upper, lower = (polyval(later, part.T) for part in np.split(controller.position_sections, 2, axis=1))
            feedback[:, k] = np.prod(upper / lower, axis=0)
        loop = np.eye(axes) + feedback[:, :, None] * from_drive[:, rows] * hold
        command = -np.linalg.solve(loop, feedback[:, :, None] * seen[:, rows])
    outputs = seen + (from_drive * hold) @ command
    measured = command * later[:, None, None]
    columns = []
    for name in channels:
        kind, _, of = name.partition("_")
        axis = machine.axes.index(of) if kind in ("command", "current", "effort") else None
        if axis is None:
            columns.append(outputs[:, labels.index(name)])
        else:
            columns.append((command if name.startswith("command_") else measured)[:, axis])
    return np.stack(columns, axis=1)


def _noise_weight(found: Mismatch, frequencies_Hz: np.ndarray, repeats: int) -> np.ndarray:
    """(L, C) inverse of the noise rms of the repeats' mean per line of unit-scaled values."""
    noise = found.noise
    filtered = np.column_stack([np.interp(frequencies_Hz, noise.grid_Hz, column) for column in noise.own.T])
    z = np.exp(-2j * np.pi * np.outer(frequencies_Hz / noise.rate_Hz, np.arange(noise.filters.shape[1])))
    return np.abs(z @ noise.filters.T) / filtered * np.sqrt(repeats)


def _is_linear(channels: Sequence[str]) -> np.ndarray:
    """(C,) 1 for channels that efforts are estimated from: accelerometers turn in gravity, so away from the mean pose they are left out."""
    encoded = any(name.startswith(("position_", "link_position_")) for name in channels)
    return np.array([0.0 if encoded and name.startswith("imu_") else 1.0 for name in channels])


def _power(found: Mismatch, signal: np.ndarray) -> np.ndarray:
    return np.asarray((in_noise_units(found.noise, signal).rows ** 2).sum(axis=0))


def ends(rows: int, rate_Hz: float) -> int:
    """Rows at either end of a record in which the estimate goes to zero."""
    return min(max(round(END_s * rate_Hz), 1), rows // 4)


def _tapered(values: np.ndarray, rate_Hz: float) -> np.ndarray:
    """(2 N, C) the record brought to zero at both ends and followed by zeros: what was before and after it is not known."""
    rows = len(values)
    ramp = ends(rows, rate_Hz)
    taper = np.ones(rows)
    taper[:ramp] = 0.5 - 0.5 * np.cos(np.pi * (np.arange(ramp) + 0.5) / ramp)
    taper[-ramp:] = taper[:ramp][::-1]
    return np.vstack([values * taper[:, None], np.zeros_like(values)])
