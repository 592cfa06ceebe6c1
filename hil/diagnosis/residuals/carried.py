"""IMU readings less what the encoders say that the body under the IMU did.

What a joint's motion does to an IMU depends on pose and speed: an accelerometer turns in gravity, a moving arm's speed error is felt as
centripetal acceleration, an axis that carries another one is seen along other directions. So the repeats' deviations of the IMU depend on
where the machine is, and no spectrum holds along the record. Their part that the encoders show is linear in the encoders' deviations, with
gradients that the machine file knows; what is left depends on the pose no more than the sensors do. Subtracting one channel's share from
another's takes no information away. Featherstone 2008, ch. 2 (spatial motion of a body).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
import scipy.ndimage
import scipy.signal

from hil.diagnosis.residuals.whitening_kernels import take_carried
from hil.machine import Machine
from virtual_bus.effects.places import imu_channel_names
from virtual_bus.plant.compiled import CompiledPlant, compile_plant
from virtual_bus.plant.statics import equilibrium

WINDOW_s = 0.05
"""Length of the local cubic that speeds and accelerations are taken from: longer than an encoder's steps, shorter than a reversal."""

LEAST_WINDOW = 5  # rows: a cubic's second derivative is determined

POSE_EVERY_s = 0.02
"""Gradients are computed this often and taken linearly between: joints hardly turn meanwhile."""

DIFFERENCE = 1e-6  # rad or m, and per s and s^2 of it

ONLY_VALUES = np.ones((1, 1, 1))  # weights of a record too short for a window: neither speeds nor accelerations


@dataclass(frozen=True, eq=False)
class CarriedImu:
    """What the encoders of one motion say of its IMU.

    Attributes
    ----------
    gradients : (3, N, I, A) array
        Of I IMU channels with the positions, speeds and accelerations of A axes, in every row.
    imu, encoders : (I,), (A,) int arrays
        Columns.
    rate_Hz : float
    """

    gradients: np.ndarray
    imu: np.ndarray
    encoders: np.ndarray
    rate_Hz: float

    def without(self, rows: np.ndarray) -> np.ndarray:
        """Rows (..., N, C) with the IMU channels less what the encoder channels say of them. Linear."""
        left = np.array(rows, dtype=float, order="C")
        for one in left.reshape(-1, *left.shape[-2:]):
            one[:] = self.without_by_channel(one).T
        return left

    def without_by_channel(self, rows: np.ndarray) -> np.ndarray:
        """(C, N) of rows (N, C)."""
        values = np.array(rows.T, dtype=float, order="C")
        window = _window(self.rate_Hz)
        weights = ONLY_VALUES if len(rows) < window else _weights_of_all(window, self.rate_Hz)
        take_carried(self._gradients_by_channel, weights, self.imu, self.encoders, values)
        return values

    @cached_property
    def _gradients_by_channel(self) -> np.ndarray:
        """(3, A, I, N): rows side by side, as the kernel goes through them."""
        return np.ascontiguousarray(self.gradients.transpose(0, 3, 2, 1))

    def without_taken_back(self, rows: np.ndarray) -> np.ndarray:
        """(N, C), the adjoint of `without`."""
        back = np.array(rows, dtype=float)
        for order, gradients in enumerate(self.gradients):
            carried = (gradients * rows[:, self.imu, None]).sum(axis=1)
            back[:, self.encoders] -= _derivatives_back(carried, order, self.rate_Hz)
        return back


def carried_imu(machine: Machine, channels: Sequence[str], positions: np.ndarray) -> CarriedImu | None:
    """None where no IMU channel or no encoder is among the channels.

    Parameters
    ----------
    machine : Machine
    channels : sequence of str
    positions : (N, n_axes) array
        The mean motion.
    """
    channels = list(channels)
    plant = compile_plant(machine.plant)
    joints = plant.joint_of_axis()
    read = {axis: next((n for n in (f"link_position_{axis}", f"position_{axis}") if n in channels), None) for axis in joints}
    axes = [axis for axis, name in read.items() if name is not None]
    names = imu_channel_names(machine.plant)
    imu = [k for k, name in enumerate(names) if name in channels]
    if not imu or not axes:
        return None
    every = max(1, round(POSE_EVERY_s * machine.sample_rate_Hz))
    rows = np.unique(np.append(np.arange(0, len(positions), every), len(positions) - 1))
    motion = np.stack([part[rows] for part in _derivatives(positions, machine.sample_rate_Hz)], axis=1)
    coarse = _gradients(plant, [joints[axis] for axis in axes], [joints[axis] for axis in machine.axes], motion)[:, :, imu]
    place = np.interp(np.arange(len(positions)), rows, np.arange(len(rows)))
    low = np.minimum(place.astype(int), max(len(rows) - 2, 0))
    share = (place - low)[:, None, None]
    gradients = (1.0 - share) * coarse[:, low] + share * coarse[:, np.minimum(low + 1, len(rows) - 1)]
    columns = np.array([channels.index(str(read[axis])) for axis in axes])
    return CarriedImu(np.ascontiguousarray(gradients), np.array([channels.index(names[k]) for k in imu]), columns, machine.sample_rate_Hz)


def _gradients(plant: CompiledPlant, moved: Sequence[int], actuated: Sequence[int], motion: np.ndarray) -> np.ndarray:
    """(3, rows, 6 imus, moved) gradients of the IMUs' unfiltered channels along a motion (rows, 3, axes) of the actuated joints."""
    model = plant.model()
    gradients = np.zeros((3, len(motion), 6 * len(plant.settings.imus), len(moved)))
    states = np.zeros((3, len(motion), plant.joints))
    states[0] = equilibrium(plant, model, motion[:, 0].mean(axis=0))
    states[:, :, actuated] = motion.swapaxes(0, 1)
    for order in range(3):
        for column, joint in enumerate(moved):
            shift = np.zeros((3, 1, plant.joints))
            shift[order, 0, joint] = DIFFERENCE
            change = plant.imu_motions(model, *(states + shift)) - plant.imu_motions(model, *(states - shift))
            gradients[order, :, :, column] = change / (2.0 * DIFFERENCE)
    return gradients


def _derivatives(values: np.ndarray, rate_Hz: float) -> list[np.ndarray]:
    """Values (N, k), their speeds and their accelerations; zeros in a record too short for them.

    A polynomial of third degree through the window around every row (Savitzky and Golay 1964), and through the first or last window near
    the ends.
    """
    window = _window(rate_Hz)
    if len(values) < window:
        return [values, np.zeros_like(values), np.zeros_like(values)]
    half = window // 2
    found = []
    for order in range(3):
        weights = _weights(window, order, rate_Hz)
        slopes = scipy.ndimage.correlate1d(values, weights[half], axis=0, mode="constant")
        slopes[:half] = weights[:half] @ values[:window]
        slopes[-half:] = weights[half + 1 :] @ values[-window:]
        found.append(slopes)
    return found


def _derivatives_back(slopes: np.ndarray, order: int, rate_Hz: float) -> np.ndarray:
    """(N, k), the adjoint of this one of `_derivatives`."""
    window = _window(rate_Hz)
    if len(slopes) < window:
        return slopes if order == 0 else np.zeros_like(slopes)
    half, weights = window // 2, _weights(window, order, rate_Hz)
    inner = slopes.copy()
    inner[:half], inner[-half:] = 0.0, 0.0
    back = scipy.ndimage.correlate1d(inner, weights[half][::-1], axis=0, mode="constant")
    back[:window] += weights[:half].T @ slopes[:half]
    back[-window:] += weights[half + 1 :].T @ slopes[-half:]
    return back


def _window(rate_Hz: float) -> int:
    """Rows of the local polynomial."""
    return max(2 * int(0.5 * WINDOW_s * rate_Hz) + 1, LEAST_WINDOW)


@lru_cache(maxsize=16)
def _weights_of_all(window: int, rate_Hz: float) -> np.ndarray:
    """(3, window, window): of values, speeds and accelerations."""
    return np.stack([_weights(window, order, rate_Hz) for order in range(3)])


@lru_cache(maxsize=16)
def _weights(window: int, order: int, rate_Hz: float) -> np.ndarray:
    """(window, window) of the values in a window, for this derivative of their polynomial at each of its rows."""
    return np.stack([scipy.signal.savgol_coeffs(window, 3, order, 1.0 / rate_Hz, row, "dot") for row in range(window)])
