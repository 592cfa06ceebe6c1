"""Runs of a machine whose parameters are known, drawn by chance: what a filter of them is judged on.

Axes move as sums of sines, so their speeds are exact; modes step by the matrix exponential with efforts and pushes held; the sensor's
acceleration is the second difference of its place. Nothing of it uses the filter's derivatives.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from hil.calibration.parameter_states.filter_model import PoseImage, Randomness, Run, SwingingMachine

SWEEP_Hz = (0.08, 0.25)
"""Range of the sines that an axis moves along."""

SHAKEN_Hz = (2.0, 20.0)
"""Range of the sines in the efforts: they excite the modes."""

SINES, EFFORT = 9, 4.0
HALF_s = 1e-3


@dataclass(frozen=True)
class Conditions:
    """How a run is measured.

    Attributes
    ----------
    rate_Hz, seconds : float
    images_Hz, late_s : float
        Exposures a second, and how long after one its image is there.
    reach_rad : (axes,) array
        How far each axis moves to either side.
    effort : float
        Rms of the efforts that shake the modes.
    pose_std : (9,) array
        Of an image: source, phantom [m], rotation [rad].
    wrong_images : float
        Share of the images that show something else, by 20 mm and 50 mrad.
    noise : float
        How much louder everything measured is than the filter believes.
    """

    rate_Hz: float = 128.0
    seconds: float = 20.0
    images_Hz: float = 2.0
    late_s: float = 0.2
    reach_rad: np.ndarray | float = 1.0
    effort: float = EFFORT
    pose_std: np.ndarray | None = None
    wrong_images: float = 0.0
    noise: float = 1.0


POSE_STD = np.repeat([1e-4, 5e-5, 2e-4], 3)
"""Focal spot 0.1 mm, phantom 0.05 mm, rotation 0.2 mrad."""


@dataclass(frozen=True)
class Truth:
    """What happened.

    Attributes
    ----------
    machine : SwingingMachine
    time_s : (N,) array
    reach, sweep : (axes,), (2, axes, sines) arrays
        Sines that the axes move along, see `_sines`.
    state : (N, 3, m) array
        Deflection, speed and acceleration of the modes.
    force : (N, m) array
        Acts on the modes from a sample to the next.
    frequency_ratio : callable
        Time to the modes' frequencies over those at the beginning.
    """

    machine: SwingingMachine
    time_s: np.ndarray
    reach: np.ndarray
    sweep: np.ndarray
    state: np.ndarray
    force: np.ndarray
    frequency_ratio: Callable[[float], float]

    def motion(self, at_s: np.ndarray) -> np.ndarray:
        """Return the axes' positions (K, axes) at times (K,)."""
        moved: np.ndarray = self.reach * _sum(self.sweep, at_s) / np.sqrt(2.0)
        return moved

    def poses(self, at_s: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the poses (source, phantom, rotation) at times (K,)."""
        last = np.clip(np.searchsorted(self.time_s, at_s, side="right") - 1, 0, len(self.time_s) - 1)
        deflection = np.zeros((len(at_s), self.machine.modes))
        for row, (at, i) in enumerate(zip(at_s, last, strict=True)):
            for k in range(self.machine.modes):
                whole = _matrix(self.machine, k, self.frequency_ratio(float(at)))
                deflection[row, k] = (expm(whole * (at - self.time_s[i]))[0]) @ np.array([*self.state[i, :2, k], self.force[i, k]])
        return self.machine.chain.poses(self.motion(at_s), self.machine.swing(deflection))


def steady(at_s: float) -> float:
    """Return the ratio 1: frequencies that do not drift."""
    return 1.0


def drawn_run(
    machine: SwingingMachine,
    random: Randomness,
    conditions: Conditions,
    seed: int,
    ratio: Callable[[float], float] = steady,
) -> tuple[Run, Truth]:
    """Return a run of a machine and what happened in it.

    Parameters
    ----------
    machine : SwingingMachine
        The true one.
    random : Randomness
        Its noises, biases and pushes are drawn from.
    conditions : Conditions
    seed : int
    ratio : callable
        Time to the factor of all modes' frequencies: drift.
    """
    rng = np.random.default_rng(seed)
    n, period = machine.axes, 1.0 / conditions.rate_Hz
    time = np.arange(round(conditions.seconds * conditions.rate_Hz)) * period
    sweep = _sines(rng, n, 2, SWEEP_Hz)
    reach = np.broadcast_to(np.asarray(conditions.reach_rad, float), (n,))
    effort = conditions.effort * _sum(_sines(rng, n, SINES, SHAKEN_Hz), time)
    state, force = _swung(machine, random, effort, time, ratio, rng)
    truth = Truth(machine, time, reach, sweep, state, force, ratio)
    imu = _sensed(truth)
    imu = imu + rng.normal(0.0, random.bias) + np.cumsum(rng.normal(0.0, random.bias_walk * np.sqrt(period), imu.shape), axis=0)
    imu += conditions.noise * rng.normal(0.0, random.imu, imu.shape)
    encoder = truth.motion(time) + conditions.noise * rng.normal(0.0, random.encoder, (len(time), n))
    pose_std = POSE_STD if conditions.pose_std is None else conditions.pose_std
    images = []
    exposed = np.arange(0.5 / conditions.images_Hz + 0.003, time[-1] - conditions.late_s - period, 1.0 / conditions.images_Hz)
    for at, source, phantom, rotation in zip(exposed, *truth.poses(exposed), strict=True):
        off = conditions.noise * rng.normal(0.0, pose_std)
        if rng.random() < conditions.wrong_images:
            off = off + rng.normal(0.0, np.repeat([0.02, 0.02, 0.05], 3))
        turned = Rotation.from_rotvec(off[6:]).as_matrix() @ rotation
        arrives = float(at) + conditions.late_s
        images.append(PoseImage(float(at), arrives, source + off[:3], phantom + off[3:6], turned, np.diag(pose_std**2)))
    return Run(time, encoder, imu, effort, tuple(images)), truth


def _matrix(machine: SwingingMachine, k: int, ratio: float) -> np.ndarray:
    """Return the matrix (3, 3) of mode k's deflection, speed and what pushes it, which is held."""
    omega = 2.0 * np.pi * machine.frequency_Hz[k] * ratio
    return np.array([[0.0, 1.0, 0.0], [-(omega**2), -2.0 * machine.damping[k] * omega, 1.0], [0.0, 0.0, 0.0]])


def _sines(rng: np.random.Generator, signals: int, count: int, within_Hz: tuple[float, float]) -> np.ndarray:
    """Return frequencies [rad/s] and phases (2, signals, count)."""
    return np.stack([2.0 * np.pi * rng.uniform(*within_Hz, (signals, count)), rng.uniform(0.0, 2.0 * np.pi, (signals, count))])


def _sum(sines: np.ndarray, time: np.ndarray) -> np.ndarray:
    """Return signals (N, signals) of rms 1."""
    summed: np.ndarray = np.sin(time[:, None, None] * sines[0] + sines[1]).sum(axis=2) * np.sqrt(2.0 / sines.shape[2])
    return summed


def _swung(
    machine: SwingingMachine,
    random: Randomness,
    effort: np.ndarray,
    time: np.ndarray,
    ratio: Callable[[float], float],
    rng: np.random.Generator,
) -> tuple[np.ndarray, np.ndarray]:
    """Return deflection, speed and acceleration (N, 3, m) of the modes, and what pushes them (N, m)."""
    period, m = float(time[1] - time[0]), machine.modes
    kept = np.exp(-period / random.push_s)
    push = rng.normal(0.0, random.push)
    state = np.zeros((len(time), 3, m))
    forces = np.zeros((len(time), m))

    @lru_cache(maxsize=m)  # a ratio that stays asks for one exponential per mode
    def stepping(k: int, ratio: float) -> tuple[np.ndarray, np.ndarray]:
        whole = _matrix(machine, k, ratio)
        return whole, expm(whole * period)

    for i, at in enumerate(time):
        if i:
            for k in range(m):
                whole, step = stepping(k, ratio(at))
                now = step @ np.array([*state[i - 1, :2, k], forces[i - 1, k]])
                state[i, :2, k], state[i, 2, k] = now[:2], (whole @ now)[1]
        forces[i] = machine.gain @ effort[i] + push
        push = kept * push + np.sqrt(1.0 - kept**2) * rng.normal(0.0, random.push)
    return state, forces


def _sensed(truth: Truth) -> np.ndarray:
    """Return what the sensor reads (N, 6) without noise."""
    machine, state = truth.machine, truth.state
    places, turns = [], []
    for step in (-HALF_s, 0.0, HALF_s):
        swing = machine.swing(state[:, 0] + step * state[:, 1] + 0.5 * step * step * state[:, 2])
        _, phantom, rotation = machine.chain.poses(truth.motion(truth.time_s + step), swing)
        back = np.swapaxes(rotation, 1, 2)
        places.append((back @ (machine.imu.position_m - phantom)[..., None])[..., 0])
        turns.append(rotation)
    acceleration = (places[2] - 2.0 * places[1] + places[0]) / HALF_s**2 - machine.gravity_m_s2
    force = (turns[1] @ acceleration[..., None])[..., 0]
    rate = -Rotation.from_matrix(turns[2] @ np.swapaxes(turns[0], 1, 2)).as_rotvec() / (2.0 * HALF_s)
    return np.concatenate([force @ machine.imu.orientation, rate @ machine.imu.orientation], axis=1)
