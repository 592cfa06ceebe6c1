"""The recording beside the equations: missing efforts and residual readings along the base motion, and the filter that whitens them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from hil.diagnosis.residuals.discretisation import discretised
from hil.diagnosis.residuals.narrow_band import Tones
from hil.diagnosis.residuals.trajectory import FINE, Motion, Signals, Trajectory
from hil.diagnosis.residuals.whitening import Linearised, Whitening, smooth_states, whitening
from virtual_bus.effects.places import imu_channel_names
from virtual_bus.settings import EffectSetting

POSES_PER_SECOND = 1000
"""Linearisations: what an IMU feels turns with the speed of the fastest mode, which changes within milliseconds."""
SHORTEST_LAG_S = 1e-9
"""Of a low pass: a shorter one is none."""
NEARBY = 1e-3
"""Share of a deviation within which equations are linear."""
UNKNOWN_POSITION = 1e-3
UNKNOWN_SPEED = 1e-2
"""rad or m, and per second: standard deviations of what row 0 does beside the base motion."""


@dataclass(frozen=True, eq=False)
class Levels:
    """Noise of a machine.

    Attributes
    ----------
    disturbance : (n,) array
        Standard deviation of the effort on every joint that no equation knows [Nm or N].
    corner_Hz : float
        Of its spectrum, which is flat below.
    sensors : (m + axes,) array
        Standard deviations of the readings, then of the measured currents.
    are_assumed : bool
        Whether they are what a fit leaves, and not what repeats differ by.
    colour : (m + axes, p + 1) array or None
        Filters that innovations of such noise are white behind.
    loudness : mapping of str to (N, m + axes) array
        By recording: how large innovations are from row to row.
    lattice : (m + axes,) array or None
        Standard deviations of rounding.
    single : Levels or None
        Of one recording, where these are of the mean of several.
    jolts : (n,) array or None
        Standard deviation of a further such effort, which is another one in every row.
    tones : Tones or None
        Further efforts, of a narrow band.
    """

    disturbance: np.ndarray
    corner_Hz: float
    sensors: np.ndarray
    are_assumed: bool = False
    colour: np.ndarray | None = None
    loudness: Mapping[str, np.ndarray] = field(default_factory=dict)
    lattice: np.ndarray | None = None
    single: Levels | None = None
    jolts: np.ndarray | None = None
    tones: Tones | None = None

    def of(self, repeats: int) -> Levels:
        """Return the noise of the mean of some repeats; the same where it is assumed.

        Disturbances and noise fall with the root of their number. What lattices round away is the same in all repeats, as far as it does
        not show in their differences.
        """
        if self.single is None or self.single.lattice is None:
            return self
        one, variance = self.single, self.single.sensors**2
        sensors = np.sqrt(variance / repeats + np.maximum(self.single.lattice**2 - variance, 0.0))
        jolts = None if one.jolts is None else one.jolts / np.sqrt(repeats)
        tones = None if one.tones is None else one.tones.times(np.full(len(one.disturbance), 1.0 / np.sqrt(repeats)))
        return replace(self, disturbance=one.disturbance / np.sqrt(repeats), jolts=jolts, tones=tones, sensors=sensors)

    def accelerating(self, ratio: np.ndarray) -> Levels:
        """Return the disturbances that accelerate joints as much whose inertias are larger by a ratio (n,)."""
        jolts = None if self.jolts is None else self.jolts * ratio
        tones = None if self.tones is None else self.tones.times(ratio)
        return replace(self, disturbance=self.disturbance * ratio, jolts=jolts, tones=tones)

    def with_readings(self, kept: Sequence[int]) -> Levels:
        """Return the noise of some of the readings (m + axes) alone."""
        index = list(kept)
        single = None if self.single is None else self.single.with_readings(index)
        colour = None if self.colour is None else self.colour[index]
        lattice = None if self.lattice is None else self.lattice[index]
        loudness = {name: values[:, index] for name, values in self.loudness.items()}
        return replace(self, sensors=self.sensors[index], colour=colour, loudness=loudness, lattice=lattice, single=single)


@dataclass(frozen=True, eq=False)
class EquationErrors:
    """What is left of one recording beside a machine's equations.

    Attributes
    ----------
    trajectory : Trajectory
    model : record
    base : Motion
    imus : (N, 6 imus) array
        Their readings along it.
    signals : Signals
        Along the base motion.
    missing, missing_ends : (N, n) arrays
        Efforts given less needed, at each row and just before the next.
    left : (N, m + axes) array
        Readings less what the base motion says, then measured currents less nominal; NaN where missing.
    """

    trajectory: Trajectory
    model: np.ndarray
    base: Motion
    imus: np.ndarray
    signals: Signals
    missing: np.ndarray
    missing_ends: np.ndarray
    left: np.ndarray
    filters: dict[float, tuple[Linearised, np.ndarray]] = field(default_factory=dict)

    @property
    def present(self) -> np.ndarray:
        """Which readings (N, m + axes) there are."""
        there: np.ndarray = ~np.isnan(self.left)
        return there

    def with_left(self, left: np.ndarray) -> EquationErrors:
        """Return the same with other residual readings."""
        return replace(self, left=left)

    def less(self, efforts: Mapping[int, tuple[np.ndarray, np.ndarray]], readings: Mapping[int, np.ndarray]) -> EquationErrors:
        """Return the same beside equations that have further efforts on joints, and further readings."""
        missing, ends, left = self.missing.copy(), self.missing_ends.copy(), self.left.copy()
        for joint, (start, end) in efforts.items():
            missing[:, joint] -= start
            ends[:, joint] -= end
        for channel, values in readings.items():
            left[:, channel] -= values
        return replace(self, missing=missing, missing_ends=ends, left=left)

    def about(self, motion: Motion) -> EquationErrors:
        """Return the same less what the equations have along a motion beyond their linear part about the base motion.

        A motion that is faster than the base motion turns an IMU faster, and bodies press outwards by the square of that.
        """
        base = self.base
        near = Motion(
            base.position + NEARBY * (motion.position - base.position),
            base.speed + NEARBY * (motion.speed - base.speed),
            base.acceleration + NEARBY * (motion.acceleration - base.acceleration),
            base.speed_deviation,
        )
        here, there, linear = (self.trajectory.signals(each, self.model) for each in (base, motion, near))
        needed = there.needed - here.needed - (linear.needed - here.needed) / NEARBY
        readings = there.readings - here.readings - (linear.readings - here.readings) / NEARBY
        efforts = {joint: (needed[:, joint], np.append(needed[1:, joint], needed[-1, joint])) for joint in range(needed.shape[1])}
        further = self.less(efforts, {channel: readings[:, channel] for channel in range(readings.shape[1])})
        return further.given_along(there)

    def given_along(self, signals: Signals) -> EquationErrors:
        """Return the same with what drives give, less dry friction, along another motion: friction that is known turns with its speed."""
        change = signals.given - self.signals.given
        own = replace(self.signals, given=signals.given)
        return replace(self, signals=own, missing=self.missing + change, missing_ends=self.missing_ends + change)

    def linearised(self, levels: Levels) -> Linearised:
        """Return the filter's matrices with these levels; those of the machine are computed once."""
        n, decay = len(levels.disturbance), self._decay(levels)
        if levels.corner_Hz not in self.filters:
            plain, felt = next(iter(self.filters.values()), None) or _linearised(self)
            transition, disturbances = plain.transition.copy(), np.arange(2 * n, 3 * n)
            transition[:, disturbances, disturbances] = decay
            self.filters.clear()  # one corner's is as large as the recording
            self.filters[levels.corner_Hz] = replace(plain, transition=transition), felt
        plain, felt = self.filters[levels.corner_Hz]
        process, start = np.zeros(len(plain.process)), np.zeros(len(plain.process))
        process[2 * n : 3 * n] = levels.disturbance**2 * (1.0 - decay**2)
        start[:n], start[n : 2 * n], start[2 * n : 3 * n] = UNKNOWN_POSITION**2, UNKNOWN_SPEED**2, levels.disturbance**2
        start[: 2 * n] += self.trajectory.begins[2:].ravel() ** 2
        for joint, motion in self.trajectory.smooth.items():  # what is faster than the base motion
            start[joint] += np.mean((motion.position - motion.slow[:, 0]) ** 2)
            start[n + joint] += np.mean((motion.speed - motion.slow[:, 1]) ** 2)
        start[self.trajectory.imposed + [n + joint for joint in self.trajectory.imposed]] = 0.0
        start[3 * n :] = felt**2 @ start[: 3 * n]  # what the low passes of an IMU hold
        found = replace(plain, noise=levels.sensors**2, process=process, start=start)
        return found if levels.tones is None else levels.tones.added_to(found, n, self.trajectory.observed.period_s)

    def whitening(self, levels: Levels, unsure: tuple[np.ndarray, np.ndarray] | None = None) -> Whitening:
        """Return the filter with these levels.

        `unsure` are the variances (N, n) of further efforts on each joint [Nm^2 or N^2]: of such as stay, and of others in every row.
        """
        extra = jolts = None
        if unsure is not None and unsure[0].any():
            stays = unsure[0]
            n = stays.shape[1]
            extra = np.zeros((len(stays), self.linearised(levels).transition.shape[1]))
            extra[:, 2 * n : 3 * n] = stays * (1.0 - self._decay(levels) ** 2)
        if levels.jolts is not None:
            jolts = np.tile(levels.jolts**2, (len(self.missing), 1))
        if unsure is not None and unsure[1].any():
            jolts = unsure[1] if jolts is None else jolts + unsure[1]
        plain = whitening(self.linearised(levels), self.present, extra, jolts)
        return replace(plain, colour=levels.colour, loudness=levels.loudness.get(self.trajectory.observed.name))

    def _decay(self, levels: Levels) -> float:
        """Return what is left of a disturbance one row later."""
        return float(np.exp(-2.0 * np.pi * levels.corner_Hz * self.trajectory.observed.period_s))

    def whitened(self, filtered: Whitening) -> np.ndarray:
        """Return the recording's innovations (N, m + axes), zero where nothing was read."""
        rows, channels = self.left.shape
        out = np.zeros((rows * channels, 1))
        state = np.zeros((filtered.linearised.transition.shape[1], 1))
        efforts, ends, readings = (
            np.ascontiguousarray(each[:, :, None]) for each in (self.missing, self.missing_ends, np.nan_to_num(self.left))
        )
        filtered.columns(efforts, ends, readings, 0, state, out)
        return filtered.coloured(out).reshape(rows, channels)

    def motion(self, filtered: Whitening, by_encoders: bool = True) -> Motion:
        """Return what all joints did by all sensors: the base motion and the smoothed deviations from it.

        Speeds of joints that an encoder of their own follows are by it alone where that is asked for: it does not take the equations' word
        near a reversal. What friction makes of a motion depends on how unsure its speeds are; where none is known, and equations are taken
        about the motion, they are taken to be as unsure as by the encoders alone.
        """
        n = self.missing.shape[1]
        speeds = slice(n, 2 * n) if by_encoders or self.trajectory.known else slice(0)
        states, deviations = smooth_states(filtered, self.missing, self.missing_ends, np.nan_to_num(self.left), self.present, speeds)
        position = self.base.position + states[:, :n]
        speed = self.base.speed + states[:, n : 2 * n]
        acceleration = self.base.acceleration + np.gradient(states[:, n : 2 * n], self.trajectory.observed.period_s, axis=0)
        if by_encoders:
            for joint, motion in self.trajectory.smooth.items():
                speed[:, joint] = motion.speed
        unsure = np.maximum(deviations, self.base.speed_deviation) if deviations.size else self.base.speed_deviation
        return Motion(position, speed, acceleration, unsure)


def equation_errors(trajectory: Trajectory, values: np.ndarray | None = None, changes: Sequence[EffectSetting] = ()) -> EquationErrors:
    """Put a recording beside the equations with these numbers, the machine file's by default, and effects that change its joints'."""
    model, fine_model = trajectory.model(values, changes), trajectory.model(values, changes, fine=True)
    fine = trajectory.base(fine_model)
    start, end, imus = trajectory.along_base(fine, fine_model)
    base = fine.every(FINE)
    signals = trajectory.signals(base, model, (), imus)
    left = np.hstack([trajectory.observed.readings - signals.readings, trajectory.measured_currents - signals.currents])
    return EquationErrors(trajectory, model, base, imus, signals, signals.given - start, signals.given - end, left)


def default_levels(trajectory: Trajectory) -> Levels:
    """Return the levels that the machine file gives: those of its sensors, and no disturbance."""
    settings, observed = trajectory.settings, trajectory.observed
    noise = {}
    for sensor in settings.joint_sensors:
        noise[sensor.channel] = sensor.resolution / np.sqrt(12.0)
    names = iter(imu_channel_names(settings))
    for imu in settings.imus:
        for rms, resolution in (
            (imu.accelerometer_noise_rms_m_s2, imu.accelerometer_resolution_m_s2),
            (imu.gyro_noise_rms_rad_s, imu.gyro_resolution_rad_s),
        ):
            for axis in range(3):
                noise[next(names)] = float(np.hypot(rms[axis], resolution / np.sqrt(12.0)))
    by_axis = {sensor.axis: float(np.hypot(sensor.noise_rms, sensor.resolution / np.sqrt(12.0))) for sensor in settings.currents}
    sensors = [max(noise[channel], 1e-9) for channel in observed.channels]
    sensors += [max(by_axis.get(drive.axis, 0.0), 1e-3 * drive.limit) for drive in settings.drives]
    return Levels(np.zeros(len(trajectory.joints)), 5.0, np.array(sensors))


def _linearised(self: EquationErrors) -> tuple[Linearised, np.ndarray]:
    """Return the filter's matrices, with disturbances that stay, and what IMUs feel (channels, 3 n) of the state at row 0.

    Of it are positions, speeds and disturbances.
    """
    trajectory = self.trajectory
    observed, settings = trajectory.observed, trajectory.settings
    n, period = len(trajectory.joints), observed.period_s
    stride = max(1, int(1.0 / (POSES_PER_SECOND * period)))
    inverses, stiffnesses, dampings, of_position, of_speed, of_acceleration = trajectory.linearised(self.base, self.model, stride)
    if trajectory.imposed:  # no effort moves them, and the others turn beside them
        free = np.setdiff1d(np.arange(n), trajectory.imposed)
        inertias = np.linalg.inv(inverses)[:, free[:, None], free]
        inverses = np.zeros_like(inverses)
        inverses[:, free[:, None], free] = np.linalg.inv(inertias)
    count, imus = len(inverses), of_position.shape[1]
    size, channels = 3 * n + imus, len(observed.channels) + len(settings.drives)
    at_once = of_acceleration @ inverses
    felt = np.concatenate([of_position - at_once @ stiffnesses, of_speed - at_once @ dampings], axis=2)
    is_filtered = self.model[0]["is_filtered"][:imus] != 0
    corners = np.where(is_filtered, 1.0 / np.maximum(self.model[0]["filter_lag"][:imus, 0], SHORTEST_LAG_S), 0.0)
    transition, of_effort, of_rise = np.zeros((count, size, size)), np.zeros((count, size, n)), np.zeros((count, size, n))
    discretised(period, inverses, stiffnesses, dampings, felt, at_once, corners, transition, of_effort, of_rise)
    observation, through = np.zeros((count, channels, size)), np.zeros((count, channels, n))
    sensors = {sensor.channel: sensor for sensor in settings.joint_sensors}
    speeds = {sensor.channel for sensor in settings.speeds}
    names = imu_channel_names(settings)
    for c, channel in enumerate(observed.channels):
        if channel in sensors:
            for joint in sensors[channel].joints:
                observation[:, c, trajectory.joints.index(joint) + (n if channel in speeds else 0)] = 1.0
        elif is_filtered[names.index(channel)]:
            observation[:, c, 3 * n + names.index(channel)] = 1.0
        else:
            k = names.index(channel)
            observation[:, c, : 2 * n], observation[:, c, 2 * n : 3 * n], through[:, c] = felt[:, k], at_once[:, k], at_once[:, k]
    nothing = np.zeros(size)
    first = np.hstack([felt[0], at_once[0]])
    return Linearised(stride, transition, of_effort, of_rise, observation, through, np.zeros(channels), nothing, nothing), first
