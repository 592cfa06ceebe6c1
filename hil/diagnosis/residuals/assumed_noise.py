"""Noise where nothing repeats: sensors are as noisy as motions are rough, and what the engineer's first fit leaves is disturbance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import scipy.signal

from hil.diagnosis.residuals.equation_errors import Levels, default_levels
from hil.diagnosis.residuals.trajectory import Motion, Trajectory

CORNER = 0.25
"""Of the disturbances' spectrum, as a share of the sample rate: above all that a machine follows."""
WITHIN_ROW = 0.1
"""Noise of a sensor, at least, in units of what a disturbance that differs from row to row moves its joint by within a row."""
MOST_ROWS = 15_000
"""Of all recordings together, times joints: an answer comes within half a minute."""
MOTION, PER_CYCLE = 0.99, 30.0
"""Share of the speeds' power that is kept, and rows per period of the fastest motion in it: equations are linearised about a thirtieth."""
PER_OCTAVE = 2
"""Bands of the spectrum that are averaged by their logarithms: what differentiated noise adds to the highest ones, and what physics that
is sought leaves in the lowest ones, counts little."""


def assumed_levels(trajectories: Sequence[Trajectory]) -> Levels:
    """Return the noise that is assumed of a machine at first, from what the machine file leaves unexplained."""
    first = trajectories[0]
    corner = CORNER / first.observed.period_s
    left = [efforts_by_encoders(trajectory)[2] for trajectory in trajectories]
    disturbance = np.array(
        [np.sqrt(_density([each[:, j] for each in left], first.observed.period_s) * 0.5 * np.pi * corner) for j in range(len(first.joints))]
    )
    sensors = default_levels(first).sensors
    for c, channel in enumerate(first.observed.channels):
        sensors[c] = max(sensors[c], *(_roughness(trajectory, c, channel) for trajectory in trajectories))
    return with_rows(first, Levels(disturbance, corner, sensors, are_assumed=True))


def with_rows(trajectory: Trajectory, levels: Levels) -> Levels:
    """Return the levels with sensors at least as noisy as disturbances within a row make them.

    A motion that is known exactly at the rows, with an effort between them that is not, has innovations that alternate for ever.
    """
    pose = np.zeros(len(trajectory.joints))
    for joint, motion in trajectory.smooth.items():
        pose[joint] = motion.position[0]
    within = WITHIN_ROW * levels.disturbance / trajectory.plant.inertias(trajectory.model(), pose) * trajectory.observed.period_s
    sensors = levels.sensors.copy()
    speeds = {sensor.channel for sensor in trajectory.settings.speeds}
    for sensor in trajectory.settings.joint_sensors:
        if sensor.channel in trajectory.observed.channels:
            c = trajectory.observed.channels.index(sensor.channel)
            share = 1.0 if sensor.channel in speeds else trajectory.observed.period_s
            sensors[c] = max(sensors[c], *(share * within[trajectory.joints.index(joint)] for joint in sensor.joints))
    return replace(levels, sensors=sensors)


def _roughness(trajectory: Trajectory, number: int, channel: str) -> float:
    """Return how far a sensor's readings lie about the smoothed motion; 0 where no motion was smoothed from what it reads."""
    samples = trajectory.observed.readings[:, number]
    for sensor in trajectory.settings.joint_sensors:
        joints = [trajectory.joints.index(joint) for joint in sensor.joints]
        if sensor.channel == channel and all(joint in trajectory.smooth for joint in joints):
            if sensor in trajectory.settings.encoders:
                return max(trajectory.smooth[joint].noise for joint in joints)
            return float(np.nanstd(samples - sum(trajectory.smooth[joint].speed for joint in joints)))
    return 0.0


def coarsest(trajectories: Sequence[Trajectory]) -> int:
    """Return how many rows may be taken together: motions stay well resolved, and an answer comes within seconds."""
    first = trajectories[0]
    rows = sum(trajectory.observed.rows for trajectory in trajectories) * len(first.joints)
    fastest = 0.0
    for trajectory in trajectories:
        for motion in trajectory.smooth.values():
            frequencies, power = scipy.signal.periodogram(motion.speed, 1.0 / first.observed.period_s, window="hann")
            whole = np.cumsum(power)
            fastest = max(fastest, float(frequencies[np.searchsorted(whole, MOTION * whole[-1])]))
    by = int(min(rows / MOST_ROWS, 1.0 / (first.observed.period_s * PER_CYCLE * max(fastest, 1e-9))))
    return max(1, by)


def efforts_by_encoders(trajectory: Trajectory) -> tuple[Motion, np.ndarray, np.ndarray]:
    """Return the motion by encoders, the efforts (N, n) that drives gave along it, and what of them the motion did not take."""
    motion = _by_encoders(trajectory)
    signals = trajectory.signals(motion, trajectory.model())
    return motion, signals.given, signals.given - signals.needed


def _by_encoders(trajectory: Trajectory) -> Motion:
    """Return the motion by every joint's own encoder; that of the others by the equations."""
    base = trajectory.base(trajectory.model(fine=True))
    motion = base.every((len(base.position) - 1) // (trajectory.observed.rows - 1))
    for joint, one in trajectory.smooth.items():
        for name, values in vars(motion).items():
            values[:, joint] = getattr(one, name)
    return motion


def _density(efforts: Sequence[np.ndarray], period_s: float) -> float:
    """Return the typical one-sided power spectral density [effort^2/Hz]."""
    longest = max(len(each) for each in efforts) * period_s
    edges = np.geomspace(1.0 / longest, 0.5 / period_s, max(2, round(PER_OCTAVE * np.log2(0.5 * longest / period_s))))
    sums, counts = np.zeros(len(edges) - 1), np.zeros(len(edges) - 1)
    for effort in efforts:
        frequencies, power = scipy.signal.periodogram(effort, 1.0 / period_s, window="hann", detrend="linear")
        band = np.digitize(frequencies, edges) - 1
        inside = (band >= 0) & (band < len(sums))
        np.add.at(sums, band[inside], power[inside])
        np.add.at(counts, band[inside], 1.0)
    means = sums[counts > 0] / counts[counts > 0]
    return float(np.exp(np.mean(np.log(np.maximum(means, 1e-30)))))
