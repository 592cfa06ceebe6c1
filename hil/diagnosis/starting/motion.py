"""How a machine moved in a recording, and the effort it lacks in its simulation: what initial guesses look at."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import scipy.signal

from hil.diagnosis.residuals.repeat_group import RepeatGroup
from hil.machine import Machine
from virtual_bus.effects.places import next_axis, spring_at
from virtual_bus.effects.residual import Residual, joined
from virtual_bus.plant.compiled import CompiledPlant, compile_plant
from virtual_bus.plant.linearise import LinearPlant, linearised

ACCELERATION_WINDOW_s = 0.08
HIGHEST_EFFORT_Hz = 25.0
"""Above it the missing effort is tapered off: the inverse of a plant from force to position grows with the square of frequency."""

LEAST_DAMPING = 0.005
"""Damping ratio of a spring that the machine file gives no damper: no structure has less."""

HIGHEST_SHARE = 0.12
"""Of the sample rate, for machines that are sampled faster than loops of that bandwidth ask for: they were, to see more."""


@dataclass(frozen=True, eq=False)
class Motion:
    """One group's mean motion beside its simulation at the present parameters.

    Parameters
    ----------
    machine : Machine
    values : (parameters,) array
        Plant parameters the group was simulated with.
    group : RepeatGroup
    channels : tuple of str
    others : tuple of Motion
        Of other groups as long as this one, such as the pieces of one long record: a residual is of all of them.
    assumed : mapping of str to float
        Noise rms of every channel in its unit, where no repeats show it and it is bounded from the residual; else nothing.
    visited : mapping of axis to pair of float
        Ends [rad or m] of its travel in all training groups, as far as they are known.
    """

    machine: Machine
    values: np.ndarray
    group: RepeatGroup
    channels: tuple[str, ...]
    others: tuple[Motion, ...] = ()
    assumed: Mapping[str, float] = field(default_factory=dict)
    visited: Mapping[str, tuple[float, float]] = field(default_factory=dict)

    @cached_property
    def plant(self) -> CompiledPlant:
        return compile_plant(self.machine.plant)

    @cached_property
    def acceleration(self) -> np.ndarray:
        """(N, n_axes)"""
        shortest, longest = 5, (len(self.group.position) - 1) // 2 * 2 + 1
        rows = max(shortest, min(2 * round(0.5 * ACCELERATION_WINDOW_s * self.machine.sample_rate_Hz) + 1, longest))
        step_s = 1.0 / self.machine.sample_rate_Hz
        return scipy.signal.savgol_filter(self.group.position, rows, 3, deriv=2, delta=step_s, axis=0)

    @cached_property
    def gains(self) -> np.ndarray:
        """(n_axes,) joint effort per unit of drive effort."""
        model = self.plant.model(self.values)
        joints = np.zeros(self.plant.joints)
        joints[list(self.plant.joint_of_axis().values())] = self.group.position.mean(axis=0)
        return self.plant.drive_gains(model, joints)

    @cached_property
    def inertia(self) -> np.ndarray:
        """(joints,) of every joint by itself, about the mean pose."""
        joints = np.zeros(self.plant.joints)
        joints[list(self.plant.joint_of_axis().values())] = self.group.position.mean(axis=0)
        mass, _ = self.plant.inertia_and_bias(self.plant.model(self.values), joints, np.zeros(self.plant.joints))
        return np.diag(mass).copy()

    @cached_property
    def missing_effort(self) -> np.ndarray:
        """(N, n_axes) effort the simulation lacks at each driven joint [Nm or N].

        With G the linear plant about the mean pose, position = G (drive effort + missing effort): the difference of recording and
        simulation gives G^-1 (difference of positions) less the difference of drive efforts.
        """
        machine, group = self.machine, self.group
        difference = group.mean - group.simulated
        rows, axes = len(difference), len(machine.axes)
        position, drive = np.zeros((rows, axes)), np.zeros((rows, axes))
        outputs = []
        for i, units in enumerate(machine.units):
            sensors = (f"{quantity}_{units.axis}" for quantity in ("position", "link_position", "speed"))
            name = next((n for n in sensors if n in self.channels), None)
            outputs.append(name)
            if name is not None:
                position[:, i] = difference[:, self.channels.index(name)]
            kinds = (f"{'current' if units.effort == 'A' else 'effort'}_{units.axis}", f"command_{units.axis}")
            effort = next((n for n in kinds if n in self.channels), None)
            if effort is not None:
                drive[:, i] = difference[:, self.channels.index(effort)]
        seen = [i for i, name in enumerate(outputs) if name is not None]
        missing = -drive
        if seen:
            system = linearised(self.plant, self.plant.model(self.values), group.position.mean(axis=0))
            labels = list(system.output_labels)
            pick = [labels.index(str(outputs[i])) for i in seen]
            extended = _odd_extension(position[:, seen])
            frequencies = np.fft.rfftfreq(len(extended), 1.0 / machine.sample_rate_Hz)
            response = _response(system, frequencies)[:, pick][:, :, seen]
            lines = np.fft.rfft(extended, axis=0)
            inverse = np.linalg.solve(response, lines[:, :, None])[:, :, 0]
            inverse *= _taper(frequencies, highest_seen_Hz(HIGHEST_EFFORT_Hz, machine.sample_rate_Hz))[:, None]
            missing[:, seen] += np.fft.irfft(inverse, len(extended), axis=0)[:rows]
        return missing * self.gains

    def deflection(self, joint: int) -> np.ndarray:
        """(N,) of a sprung joint without a drive [rad or m]: what gravity and the motion of the driven joints push it by, through its own
        equation of motion.
        """
        plant, model, sprung = self.plant, self.plant.model(self.values), self.machine.plant.tree.joints[joint]
        driven = list(plant.joint_of_axis().values())
        position = np.tile([each.rest_position for each in self.machine.plant.tree.joints], (len(self.group.position), 1))
        speed = np.zeros_like(position)
        position[:, driven], speed[:, driven] = self.group.position, self.group.speed
        inertia, bias = plant.inertia_and_bias(model, position, speed)
        shared, own = inertia[:, joint, driven].mean(axis=0), float(inertia[:, joint, joint].mean())
        moved, pushed = (_odd_extension(each) for each in (self.group.position, bias[:, joint : joint + 1]))
        w = 2.0 * np.pi * np.fft.rfftfreq(len(pushed), 1.0 / self.machine.sample_rate_Hz)
        damping = max(sprung.damping, 2.0 * LEAST_DAMPING * np.sqrt(sprung.stiffness * own))
        lines = (w**2 * (np.fft.rfft(moved, axis=0) @ shared) - np.fft.rfft(pushed[:, 0])) / (
            sprung.stiffness + 1j * w * damping - own * w**2
        )
        return np.fft.irfft(lines, len(pushed))[: len(bias)]

    @cached_property
    def drive_effort(self) -> np.ndarray:
        """(N, n_axes) of the drives on their joints [Nm or N]."""
        return self.group.effort * self.gains

    def axis_of(self, at: str) -> int:
        """The axis a place belongs to: its own, that of its channel or of its joint or spring, or the one whose motion is largest."""
        machine, settings = self.machine, self.machine.plant
        if at in machine.axes:
            return machine.axis_index(at)
        body = next((body for body in settings.tree.bodies if body.name == at), None)
        if body is None and (axis := machine.axis_of_channel(at)) is not None:
            return machine.axis_index(axis)
        if body is not None and body.joint is not None:
            joints = [drive.joint for drive in settings.drives]
            if body.joint.name in joints:
                return joints.index(body.joint.name)
            springs = [spring_at(axis, settings) for axis in machine.axes]
            spring = spring_at(at, settings)
            if spring is not None and spring in springs:
                return springs.index(spring)
        return int(np.argmax(np.abs(self.missing_effort).sum(axis=0)))

    def _springs_of_axis(self, at: str, axis: int) -> bool:
        """Is the spring at a place that of the driven joint itself, as in a mass on a spring that is pushed?"""
        return spring_at(at, self.machine.plant) == self.machine.plant.drives[axis].joint

    def _rest(self, axis: int) -> float:
        """Rest position of the driven joint's spring."""
        tree = self.machine.plant.tree
        return tree.joints[tree.joint_index(self.machine.plant.drives[axis].joint)].rest_position

    def stiffness(self, at: str) -> float:
        """Of the sprung joint at a place; 0 where there is none."""
        settings = self.machine.plant
        is_place = any(d.axis == at for d in settings.drives) or any(b.name == at and b.joint for b in settings.tree.bodies)
        spring = spring_at(at, settings) if is_place else None
        if spring is None:
            return 0.0
        return next(joint.stiffness for joint in settings.tree.joints if joint.name == spring)

    def residual(self, at: str, *, coupled: bool = False) -> Residual:
        """What a guess may look at: of the place's axis, with the channel itself where the place is one.

        `coupled`: the other joint is the next axis; otherwise the spring's deflection under the drive's effort.
        """
        return joined([motion._residual(at, coupled) for motion in (self, *self.others)])

    def _residual(self, at: str, coupled: bool) -> Residual:
        k = self.axis_of(at)
        group, stiffness = self.group, self.stiffness(at)
        other = group.position[:, k], group.speed[:, k], self.acceleration[:, k]
        if coupled:
            n = self.machine.axis_index(next_axis(self.machine.axes[k], self.machine.plant))
            other = group.position[:, n], group.speed[:, n], self.acceleration[:, n]
        elif stiffness > 0.0 and self._springs_of_axis(at, k):
            deflection = group.position[:, k] - self._rest(k)
            other = deflection, group.speed[:, k], self.acceleration[:, k]
        elif stiffness > 0.0:
            deflection = -self.drive_effort[:, k] / stiffness
            other = deflection, np.gradient(deflection, group.time_s), np.zeros_like(deflection)
        measured, simulated = self._channel(at, k)
        return Residual(
            time_s=group.time_s - group.time_s[0] + self.start_s,
            position=group.position[:, k],
            speed=group.speed[:, k],
            acceleration=self.acceleration[:, k],
            effort=self.missing_effort[:, k],
            current=group.effort[:, k],
            measured=measured,
            simulated=simulated,
            drive_effort=self.drive_effort[:, k],
            other_position=other[0],
            other_speed=other[1],
            other_acceleration=other[2],
            ratio=self.machine.plant.drives[k].ratio,
            stiffness=stiffness,
        )

    @property
    def start_s(self) -> float:
        """When the first row of the repeats is, since the machine was placed."""
        return self.group.windows[0].start / self.machine.sample_rate_Hz

    def _channel(self, at: str, axis: int) -> tuple[np.ndarray, np.ndarray]:
        mean, simulated = self.group.mean, self.group.simulated
        imu = [self.channels.index(name) if name in self.channels else -1 for name in _IMU]
        if at in {sensor.name for sensor in self.machine.plant.imus}:
            absent = np.zeros(len(mean))
            return tuple(  # type: ignore[return-value]
                np.column_stack([values[:, c] if c >= 0 else absent for c in imu]) for values in (mean, simulated)
            )
        unit = self.machine.units[axis].effort
        link = f"link_position_{self.machine.axes[axis]}"
        own = f"{'current' if unit == 'A' else 'effort'}_{self.machine.axes[axis]}"
        name = next((n for n in (at, own, link) if n in self.channels), self.channels[0])
        column = self.channels.index(name)
        return mean[:, column], simulated[:, column]


_IMU = ("imu_x", "imu_y", "imu_z", "gyro_x", "gyro_y", "gyro_z")


def highest_seen_Hz(at_least: float, sample_rate_Hz: float) -> float:
    """Highest frequency that is looked at: this one, more where the sample rate is high, less where it is low."""
    return max(min(at_least, 0.2 * sample_rate_Hz), HIGHEST_SHARE * sample_rate_Hz)


def _odd_extension(values: np.ndarray) -> np.ndarray:
    """(2 N, ...) the record and its point reflection about its end: periodic without a jump but for the trend."""
    trend = np.linspace(0.0, 1.0, len(values))[:, None] * (values[-1] - values[0]) + values[0]
    rest = values - trend
    return np.concatenate([rest, -rest[::-1]]) + np.concatenate([trend, trend[::-1]])


def _response(system: LinearPlant, frequencies_Hz: np.ndarray) -> np.ndarray:
    """(L, outputs, inputs) of a continuous state space."""
    a, b, c, d = system.A, system.B, system.C, system.D
    s = 2j * np.pi * np.maximum(frequencies_Hz, 1e-3)[:, None, None]
    return c @ np.linalg.solve(s * np.eye(len(a)) - a, np.broadcast_to(b.astype(complex), (len(s), *b.shape))) + d


def _taper(frequencies_Hz: np.ndarray, highest_Hz: float) -> np.ndarray:
    """1 up to `highest_Hz`, then down to 0 within half an octave."""
    return 0.5 * (1.0 + np.cos(np.pi * np.clip(2.0 * (frequencies_Hz / highest_Hz - 1.0), 0.0, 1.0)))
