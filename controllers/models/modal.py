"""The modal state space that varies with pose: Sec. 5.4, on top of the rigid chain of driven axes.

The machine moves as q_r, the axes' rigid coordinates, plus n modes about it:

    q_r'' = B_r(θ) u - D_r(θ) q_r' + d_r                                         rigid part
    η_i'' + 2 ζ_i ω_i η_i' + ω_i² η_i = b_i(θ)ᵀ u + d_i                          (5.30), (5.35), with ω_i(θ), ζ_i(θ)
    motor side  m = q_r + Φ_m η,    link side  l = q_r + Φ_l η
    twist of an observed body about where q_r alone would put it: Ψ η, at the body's centre and in its frame

d_r and d_i are what else pushes: gravity, friction, hands. Centrifugal and Coriolis terms of the axes are in the inertial sensors' rows, those
of the modes are neglected (Sec. 5.4.1). Every parameter is a trigonometric polynomial of the scheduling pose (`harmonics`).
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from controllers.compiled import exactly_compiled
from controllers.errors import DesignError
from controllers.models.chain import Chain, chain_motion


@dataclass(frozen=True)
class InertialSensor:
    """An IMU and the body it sits on, whose twist the modes' shapes give.

    Parameters
    ----------
    body_end_m : (3,) array
        The body's centre in the last frame of the chain, from the last axis's point.
    sensor_end_m : (3,) array
        The sensor, likewise.
    rotation : (3, 3) array
        From the sensor's frame to the chain's last frame.
    lag_s : float
        Time constant of its low pass; 0 for none.
    channels : tuple of str
        Names of its six channels in a recording.
    """

    body_end_m: np.ndarray
    sensor_end_m: np.ndarray
    rotation: np.ndarray
    lag_s: float
    channels: tuple[str, ...]


@dataclass(frozen=True)
class ModalModel:
    """Parameters of the modal model over pose.

    Parameters
    ----------
    axes : tuple of str
    chain : Chain
    sensors : tuple of InertialSensor
        The first is the one on the detector; a second one, at the source, is welcome (Sec. 8.1).
    source_end_m : (3,) array
        Focal spot in the chain's last frame at zero deformation, from the last axis's point; it moves with the link side.
    harmonics : tuple of int
        Order of the trigonometric polynomial in each axis position; 0: no dependence on it.
    coefficients : (rows, basis) array
        Rows as `rows_of_mode` and `rigid_rows` say, columns as `basis_values`.
    sample_rate_Hz : float
    effort_limit : (n_axes,) array
        Largest command [drive's unit].
    position_unit : tuple of str
        "rad" or "m" for each axis.
    """

    axes: tuple[str, ...]
    chain: Chain
    sensors: tuple[InertialSensor, ...]
    source_end_m: np.ndarray
    harmonics: tuple[int, ...]
    coefficients: np.ndarray
    sample_rate_Hz: float
    effort_limit: np.ndarray
    position_unit: tuple[str, ...]
    notes: tuple[str, ...] = field(default=())

    def __post_init__(self) -> None:
        expected = (self.modes * self.mode_stride + len(self.axes) * (len(self.axes) + 1) + 6, basis_size(self.harmonics))
        if self.modes < 0 or self.coefficients.shape != expected:
            raise DesignError(f"modal model: coefficients have shape {self.coefficients.shape}, {expected} fits")
        if not np.isfinite(self.coefficients).all():
            raise DesignError("modal model: a coefficient is not finite")

    @property
    def mode_stride(self) -> int:
        """Rows per mode: ω², 2ζω, motor shape, link shape, six per observed body, input."""
        return 2 + 3 * len(self.axes) + 6 * len(self.sensors)

    @property
    def modes(self) -> int:
        n = len(self.axes)
        return (len(self.coefficients) - n * (n + 1) - 6) // self.mode_stride

    def at(self, pose: np.ndarray) -> np.ndarray:
        """All rows' values (rows,) at a pose (n_axes,)."""
        values = np.zeros(len(self.coefficients))
        schedule(np.array(self.harmonics, dtype=np.int64), self.coefficients, np.asarray(pose, float), values)
        return values

    def frequencies_Hz(self, pose: np.ndarray) -> np.ndarray:
        """Natural frequencies (modes,) at a pose."""
        first = np.arange(self.modes) * self.mode_stride
        return np.sqrt(np.maximum(self.at(pose)[first], 0.0)) / (2.0 * np.pi)

    def damping_ratios(self, pose: np.ndarray) -> np.ndarray:
        """ζ (modes,) at a pose."""
        values, first = self.at(pose), np.arange(self.modes) * self.mode_stride
        return values[first + 1] / (2.0 * np.sqrt(np.maximum(values[first], 1e-12)))

    def channels(self) -> tuple[str, ...]:
        """Measured channels in the order of the output vector: motor sides, link sides, inertial sensors."""
        names = [f"position_{axis}" for axis in self.axes] + [f"link_position_{axis}" for axis in self.axes]
        return (*names, *(channel for sensor in self.sensors for channel in sensor.channels))

    def frozen(self, pose: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Continuous-time A, B, C, D at a pose, at rest: (5.31), (5.35), with the accelerometers' rows of (5.32) and gravity in them.

        States are [q_r, η, q_r', η']; inputs the commands; outputs `channels()`, before the sensors' low passes.
        """
        n, modes, values, stride = len(self.axes), self.modes, self.at(pose), self.mode_stride
        size = n + modes
        table = values[: modes * stride].reshape(modes, stride)
        rigid = values[modes * stride :]
        a, b = np.zeros((2 * size, 2 * size)), np.zeros((2 * size, n))
        a[:size, size:] = np.eye(size)
        a[size:, :size] = -np.diag(np.concatenate((np.zeros(n), table[:, 0])))
        a[size:, size:] = -np.diag(np.concatenate((rigid[n * n : n * n + n], table[:, 1])))
        b[size : size + n] = rigid[: n * n].reshape(n, n)
        b[size + n :] = table[:, stride - n :]
        rows, direct = [], []
        for first in (2, 2 + n):  # motor side, link side
            shape = np.hstack((np.eye(n), table[:, first : first + n].T))
            rows.append(np.hstack((shape, np.zeros((n, size)))))
            direct.append(np.zeros((n, n)))
        for index, sensor in enumerate(self.sensors):
            twist = table[:, 2 + 2 * n + 6 * index : 8 + 2 * n + 6 * index].T
            position, speed, acceleration = _sensor_gradients(self.chain, sensor, twist, np.asarray(pose, float))
            rows.append(np.hstack((position, speed)) + acceleration @ a[size:])
            direct.append(acceleration @ b[size:])
        return a, b, np.vstack(rows), np.vstack(direct)


def _sensor_gradients(chain: Chain, sensor: InertialSensor, twist: np.ndarray, pose: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Gradients (6, n + modes) of one sensor's channels with positions, speeds and accelerations of [q_r, η], at rest."""
    n, arm = len(pose), sensor.sensor_end_m - sensor.body_end_m
    to_sensor = sensor.rotation.T
    zero, end = np.zeros(n), tuple(float(value) for value in sensor.sensor_end_m)
    position, speed, acceleration = (np.zeros((6, n + twist.shape[1])) for _ in range(3))

    def motion(q: np.ndarray, v: np.ndarray, a: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        omega, _, force = _chain_motion(chain, np.concatenate((q, v, a)), end)
        return np.array(force), np.array(omega)

    step = 1e-5
    for i in range(n):
        unit = np.zeros(n)
        unit[i] = 1.0
        position[:3, i] = (motion(pose + step * unit, zero, zero)[0] - motion(pose - step * unit, zero, zero)[0]) / (2.0 * step)
        acceleration[:3, i] = motion(pose, zero, unit)[0] - motion(pose, zero, zero)[0]
        speed[3:, i] = motion(pose, unit, zero)[1]
    down = -motion(pose, zero, zero)[0]
    for i in range(twist.shape[1]):
        shift, turn = twist[:3, i], twist[3:, i]
        acceleration[:3, n + i] = shift + np.cross(turn, arm)
        position[:3, n + i] = np.cross(turn, down)  # f = a - (I - [ρ]x) g
        speed[3:, n + i] = turn
    for gradient in (position, speed, acceleration):
        gradient[:3], gradient[3:] = to_sensor @ gradient[:3], to_sensor @ gradient[3:]
    return position, speed, acceleration


@exactly_compiled
def _compiled_motion(axes, points, revolute, gravity, motion, end):
    return chain_motion(axes, points, revolute, gravity, motion, end)


def _chain_motion(chain: Chain, motion: np.ndarray, end: tuple[float, ...]) -> tuple[tuple[float, ...], ...]:
    return _compiled_motion(chain.axes, chain.points, chain.revolute, chain.gravity_m_s2, motion, end)


def basis_size(harmonics: tuple[int, ...]) -> int:
    """Functions in the tensor product of 1, cos θ, sin θ, cos 2θ, ... over the axes."""
    return int(np.prod([2 * order + 1 for order in harmonics], dtype=int))


@exactly_compiled
def basis_values(harmonics, pose, out):
    """Values (basis,) of the scheduling functions at a pose: the last axis varies fastest."""
    out[0] = 1.0
    size = 1
    for i in range(len(harmonics)):
        functions = 2 * harmonics[i] + 1
        for old in range(size - 1, -1, -1):
            value = out[old]
            out[old * functions] = value
            for k in range(1, harmonics[i] + 1):
                out[old * functions + 2 * k - 1] = value * np.cos(k * pose[i])
                out[old * functions + 2 * k] = value * np.sin(k * pose[i])
        size *= functions


@exactly_compiled
def schedule(harmonics, coefficients, pose, values):
    """All parameters (rows,) at a pose (n_axes,): (5.35) with θ frozen there."""
    basis = np.zeros(coefficients.shape[1])
    basis_values(harmonics, pose, basis)
    for row in range(coefficients.shape[0]):
        total = 0.0
        for k in range(coefficients.shape[1]):
            total += coefficients[row, k] * basis[k]
        values[row] = total
