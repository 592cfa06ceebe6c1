"""An axis at steps of 20 µs, written from the physics alone: what a drive, an encoder and an IMU on it show at every SYNC.

Nothing of the packages is in it. J v' = G i - D v, with the current i behind the drive's delay and current loop; the torque is constant
over a step, so that the recursion from step to step is exact.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import scipy.signal

STEP_s = 20e-6


@dataclass(frozen=True)
class Axis:
    """An axis about the vertical, as its data sheet has it.

    Attributes
    ----------
    inertia_kg_m2, damping_Nm_s : float
        Of all that turns.
    Nm_A : float
        Torque on it per ampere.
    delay_s : float
        From the SYNC at which the drive takes a target to when it acts on it.
    natural_Hz, damping_ratio : float
        Of the current loop; 0: the current follows at once.
    """

    inertia_kg_m2: float
    damping_Nm_s: float
    Nm_A: float
    delay_s: float = 0.0
    natural_Hz: float = 0.0
    damping_ratio: float = 1.0


@dataclass(frozen=True, eq=False)
class Motion:
    """What it does, each (rows, steps of a row): values at the beginning of a step, and means over it."""

    current: np.ndarray
    position: np.ndarray
    speed: np.ndarray
    mean_acceleration: np.ndarray
    mean_speed: np.ndarray


def moved(axis: Axis, targets: np.ndarray, before: np.ndarray, period_s: float, position: float, speed: float) -> Motion:
    """Move from a position [rad] and speed [rad/s].

    Target k (N,) is handed over at SYNC k and held until the next one; those `before` (M,) were earlier.
    """
    steps = round(period_s / STEP_s)
    late = round(axis.delay_s / STEP_s)
    assert math.isclose(steps * STEP_s, period_s)
    assert math.isclose(late * STEP_s, axis.delay_s, abs_tol=1e-12)
    begin = steps * len(before) - late
    acting = np.repeat(np.append(before, targets), steps)[begin : begin + steps * len(targets)]
    current, mean = acting, acting
    if axis.natural_Hz > 0.0:
        current, mean = followed(acting, axis.natural_Hz, axis.damping_ratio)
    left = math.exp(-axis.damping_Nm_s / axis.inertia_kg_m2 * STEP_s)
    gain = (1.0 - left) / axis.damping_Nm_s
    torque = axis.Nm_A * mean
    after = scipy.signal.lfilter([gain], [1.0, -left], torque, zi=[left * speed])[0]
    speeds = np.append(speed, after[:-1])
    ways = (torque * STEP_s - axis.inertia_kg_m2 * (after - speeds)) / axis.damping_Nm_s
    positions = position + np.append(0.0, np.cumsum(ways)[:-1])
    accelerations = (after - speeds) / STEP_s
    return Motion(*(each.reshape(len(targets), steps) for each in (current, positions, speeds, accelerations, ways / STEP_s)))


def followed(target: np.ndarray, natural_Hz: float, damping_ratio: float) -> tuple[np.ndarray, np.ndarray]:
    """Return what follows by i'' + 2 zeta w i' + w^2 i = w^2 target at the beginning of each step, and over it: ten Euler steps in each.

    It begins settled.
    """
    w, inner = 2.0 * math.pi * natural_Hz, 10
    h = STEP_s / inner
    value, rate = float(target[0]), 0.0
    begins, means = np.empty(len(target)), np.empty(len(target))
    for k, wanted in enumerate(target.tolist()):
        begins[k] = value
        total = 0.0
        for _ in range(inner):
            rate += h * w * (w * (wanted - value) - 2.0 * damping_ratio * rate)
            total += value + 0.5 * h * rate
            value += h * rate
        means[k] = total / inner
    return begins, means


def smoothed(means: np.ndarray, corner_Hz: float) -> np.ndarray:
    """Return what a low pass of first order, at nothing before, shows at the beginning of each step (rows, steps) of these means."""
    left = math.exp(-2.0 * math.pi * corner_Hz * STEP_s)
    found: np.ndarray = scipy.signal.lfilter([0.0, 1.0 - left], [1.0, -left], means.reshape(-1)).reshape(means.shape)
    return found
