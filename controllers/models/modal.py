"""The pose-dependent modal state space of Sec. 5.4, on top of the rigid chain of driven axes.

The machine moves as q_r, the axes' rigid coordinates, plus n modes about them:

    q_r'' = B_r(θ) w + d_r                                                       rigid part
    η_i'' + 2 ζ_i ω_i η_i' + ω_i² η_i = b_i(θ)ᵀ w + d_i                          (5.30), (5.35), with ω_i(θ), ζ_i(θ)
    w = u - C(θ) m'                                                              what is left of the command after the drives' friction
    motor side  m = q_r + Φ_m η,    link side  l = q_r + Φ_l η
    twist of an observed body relative to its pose under q_r alone: Ψ η, at the body's centre and in its frame

Friction at the drives couples the modes; treated as damping of each mode alone, it would miss what disturbances at the mount bring to a
drive. d_r and d_i are the other forces: gravity as a function of the pose, and disturbances such as friction and hands, each in a
direction of its own, [d_r, d] = G(θ) ξ. Two more parts are optional. `turning` is the force proportional to products of the axes' speeds:
Sec. 5.4.1 neglects it, but it bends a gear as gravity does. `coupling` is the gyroscopic force, proportional to an axis's speed and the
modes' speeds: Σ_a θ_a' Γ_a(θ) η' on the axes, where no other force is unknown. Its effect on the modes is neglected.

Every parameter is a trigonometric polynomial of the scheduling pose (`harmonics`). For a mode the polynomial gives 1/ω² instead of ω², and
for the forces on it the force over ω², which is the static deflection. With constant springs these are an inertia and static
deflections, which are such polynomials; ω² is not.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from controllers.compiled import exactly_compiled
from controllers.errors import DesignError
from controllers.models.chain import Chain, chain_motion, fits
from controllers.models.vectors import Vector

SMALLEST_s2 = 1e-9
"""Smallest 1/ω²: where the polynomial falls to zero between poses, the mode stays at 5 kHz instead of diverging."""

DIFFERENCE = 1e-4
"""Step [rad or m] of the differences over position."""


@dataclass(frozen=True)
class InertialSensor:
    """An IMU and the body it is mounted on, whose twist the mode shapes give.

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

    def __post_init__(self) -> None:
        """Check shapes and finite numbers."""
        for name, shape in (("body_end_m", (3,)), ("sensor_end_m", (3,)), ("rotation", (3, 3)), ("lag_s", ())):
            fits("inertial sensor", name, getattr(self, name), shape)


@dataclass(frozen=True)
class ModalModel:
    """The modal model: its parameters as functions of the pose.

    Parameters
    ----------
    axes : tuple of str
    chain : Chain
    sensors : tuple of InertialSensor
        The first is the one on the detector; a second one, at the source, is optional (Sec. 8.1).
    source_end_m : (3,) array
        Focal spot in the chain's last frame at zero deformation, from the last axis's point; it moves with the link side.
    harmonics : tuple of int
        Order of the trigonometric polynomial in each axis position; 0: no dependence on it.
    coefficients : (rows, basis) array
        Rows: per mode 1/ω², 2ζ/ω, its shape on the motor sides, the link sides and the observed bodies' twists, its input over ω²; then B_r
        by rows, C, gravity's force on the axes and on the modes over ω², and the quasi-static offset of the detector's twist that no mode
        contains (5.37). Columns as in `basis_values`.
    sample_rate_Hz : float
    effort_limit : (n_axes,) array
        Largest command [drive's unit].
    position_unit : tuple of str
        "rad" or "m" for each axis.
    directions : (n_axes + modes, disturbances, basis) array, optional
        G(θ): accelerations that a unit of each disturbance gives axes, and modes over ω². Without it every axis and every mode has its own
        disturbance.
    places : tuple of str, optional
        Where each disturbance acts: "drive", "gear", "mount", or between link side and detector "turn" or "shift".
    turning : (n_axes + modes, n_axes (n_axes + 1) / 2, basis) array, optional
        Accelerations of the axes, and of the modes over ω², per product of the axes' speeds. Products in the order 11, 12, ..., 22, ...
    coupling : (n_axes, n_axes, modes, basis) array, optional
        Γ(θ): accelerations of the axes (second index) per product of an axis's speed (first index) and a mode's speed.
    effort_step : (n_axes,) array
        Step to which drives round their commands, half to even; 0 or empty: no rounding.
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
    directions: np.ndarray | None = None
    turning: np.ndarray | None = None
    coupling: np.ndarray | None = None
    places: tuple[str, ...] = field(default=())
    effort_step: np.ndarray = field(default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        """Check that all shapes fit each other and all numbers are finite."""
        axes = (len(self.axes),)
        fits("modal model", "source_end_m", self.source_end_m, (3,))
        fits("modal model", "effort_limit", self.effort_limit, axes)
        for name, count in (
            ("chain's axes", len(self.chain.axes)),
            ("position_unit", len(self.position_unit)),
            ("harmonics", len(self.harmonics)),
        ):
            if count != axes[0]:
                raise DesignError(f"modal model: {count} {name}, {axes[0]} fit")
        expected = (self.modes * self.mode_stride + self._rest_rows + self.modes, basis_size(self.harmonics))
        if self.modes < 0 or self.coefficients.shape != expected:
            raise DesignError(f"modal model: coefficients have shape {self.coefficients.shape}, {expected} fits")
        if not np.isfinite(self.coefficients).all():
            raise DesignError("modal model: a coefficient is not finite")
        if self.directions is not None:
            coordinates, _, basis = self.directions.shape
            if (coordinates, basis) != (len(self.axes) + self.modes, expected[1]) or not np.isfinite(self.directions).all():
                raise DesignError(f"modal model: directions have shape {self.directions.shape}, or one of them is not finite")
        if self.places and len(self.places) != self.disturbances:
            raise DesignError(f"modal model: {len(self.places)} places, {self.disturbances} disturbances")
        if self.turning is not None:
            wanted = (len(self.axes) + self.modes, self.products, expected[1])
            if self.turning.shape != wanted or not np.isfinite(self.turning).all():
                raise DesignError(f"modal model: turning has shape {self.turning.shape}, {wanted} fits; or one of it is not finite")
        if self.coupling is not None:
            fitting = (len(self.axes), len(self.axes), self.modes, expected[1])
            if self.coupling.shape != fitting or not np.isfinite(self.coupling).all():
                raise DesignError(f"modal model: coupling has shape {self.coupling.shape}, {fitting} fits; or one of it is not finite")
        is_step = np.isfinite(self.effort_step) & (self.effort_step >= 0.0)
        if self.effort_step.shape not in ((0,), axes) or not is_step.all():
            raise DesignError(f"modal model: effort_step must be {axes[0]} finite numbers, none negative, or none, not {self.effort_step}")

    @property
    def mode_stride(self) -> int:
        """Rows per mode: ω², 2ζω, motor shape, link shape, six per observed body, input."""
        return 2 + 3 * len(self.axes) + 6 * len(self.sensors)

    @property
    def modes(self) -> int:
        """Number of modes."""
        return (len(self.coefficients) - self._rest_rows) // (self.mode_stride + 1)

    @property
    def disturbances(self) -> int:
        """Number of disturbances."""
        return len(self.axes) + self.modes if self.directions is None else self.directions.shape[1]

    @property
    def products(self) -> int:
        """Number of products of two axes' speeds."""
        return len(self.axes) * (len(self.axes) + 1) // 2

    def all_rows(self) -> np.ndarray:
        """Stack everything that varies with pose by rows: `coefficients`, then directions, `turning` and Γ."""
        size = len(self.axes) + self.modes
        if self.directions is None:
            directions = np.zeros((size, size, self.coefficients.shape[1]))
            directions[: len(self.axes), : len(self.axes), 0] = np.eye(len(self.axes))
            for i in range(self.modes):
                directions[len(self.axes) + i, len(self.axes) + i] = self.coefficients[i * self.mode_stride]
        else:
            directions = self.directions
        basis = self.coefficients.shape[1]
        nothing = np.zeros((0, basis))
        turning = np.zeros((size, self.products, basis)) if self.turning is None else self.turning
        coupling = nothing if self.coupling is None else self.coupling.reshape(-1, basis)
        pushed = nothing if self.turning is None and self.coupling is None else turning.reshape(-1, basis)
        return np.vstack((self.coefficients, directions.reshape(-1, basis), pushed, coupling))

    @property
    def _rest_rows(self) -> int:
        """Rows that belong to no mode: B_r, D_r, gravity's force on the axes, six quasi-static offsets."""
        n = len(self.axes)
        return n * (n + 1) + n + 6

    def at(self, pose: np.ndarray) -> np.ndarray:
        """Return the parameters (rows,) at a pose (n_axes,), in the order of `coefficients`: ω², 2ζω, inputs and forces as in (5.30)."""
        values, by_function = np.zeros(len(self.coefficients)), np.ascontiguousarray(self.coefficients.T)
        sizes = np.array([len(self.axes), self.modes, len(self.sensors)], dtype=np.int64)
        schedule(sizes, np.array(self.harmonics, dtype=np.int64), by_function, np.asarray(pose, float), values)
        return values

    def frequencies_Hz(self, pose: np.ndarray) -> np.ndarray:
        """Return the natural frequencies (modes,) at a pose."""
        first = np.arange(self.modes) * self.mode_stride
        frequencies: np.ndarray = np.sqrt(np.maximum(self.at(pose)[first], 0.0)) / (2.0 * np.pi)
        return frequencies

    def damping_ratios(self, pose: np.ndarray) -> np.ndarray:
        """Return ζ (modes,) at a pose."""
        values, first = self.at(pose), np.arange(self.modes) * self.mode_stride
        ratios: np.ndarray = values[first + 1] / (2.0 * np.sqrt(np.maximum(values[first], 1e-12)))
        return ratios

    def channels(self) -> tuple[str, ...]:
        """Return the measured channels in the order of the output vector: motor sides, link sides, inertial sensors."""
        names = [f"position_{axis}" for axis in self.axes] + [f"link_position_{axis}" for axis in self.axes]
        return (*names, *(channel for sensor in self.sensors for channel in sensor.channels))

    def frozen(self, pose: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Return the continuous-time A, B, C, D at rest in a pose: (5.31), (5.35), and the accelerometers' rows of (5.32) with gravity.

        States are [q_r, η, q_r', η']; inputs the commands; outputs `channels()`, before the sensors' low passes.
        """
        n, modes, values, stride = len(self.axes), self.modes, self.at(pose), self.mode_stride
        size = n + modes
        table = values[: modes * stride].reshape(modes, stride)
        rigid = values[modes * stride :]
        a, b = np.zeros((2 * size, 2 * size)), np.zeros((2 * size, n))
        a[:size, size:] = np.eye(size)
        a[size:, :size] = -np.diag(np.concatenate((np.zeros(n), table[:, 0])))
        b[size : size + n] = rigid[: n * n].reshape(n, n)
        b[size + n :] = table[:, stride - n :]
        friction = rigid[n * n : n * n + n, None] * np.hstack((np.eye(n), table[:, 2 : 2 + n].T))  # per speed
        a[size:, size:] = -np.diag(np.concatenate((np.zeros(n), table[:, 1]))) - b[size:] @ friction
        rest = chain_at_rest(self.chain, self.sensors, np.asarray(pose, float))
        rows, direct = [], []
        for first in (2, 2 + n):  # motor side, link side
            rows.append(np.hstack((np.eye(n), table[:, first : first + n].T, np.zeros((n, size)))))
            direct.append(np.zeros((n, n)))
        for index, sensor in enumerate(self.sensors):
            place = slice(6 * index, 6 * index + 6)
            twist = table[:, 2 + 2 * n + 6 * index : 8 + 2 * n + 6 * index]
            shift = (twist[:, :3] + np.cross(twist[:, 3:], sensor.sensor_end_m - sensor.body_end_m)) @ sensor.rotation
            turn, tilt = twist[:, 3:] @ sensor.rotation, np.cross(twist[:, 3:], rest.down) @ sensor.rotation  # f = a - (I - [ρ]x) g
            nothing = np.zeros_like(shift)
            position = np.hstack((rest.position[place], np.hstack((tilt, nothing)).T))
            speed = np.hstack((rest.speed[place], np.hstack((nothing, turn)).T))
            acceleration = np.hstack((rest.acceleration[place], np.hstack((shift, nothing)).T))
            rows.append(np.hstack((position, speed)) + acceleration @ a[size:])
            direct.append(acceleration @ b[size:])
        return a, b, np.vstack(rows), np.vstack(direct)


@dataclass(frozen=True)
class RestGradients:
    """Gradients at rest of the inertial sensors' readings over the axes' positions, speeds and accelerations: (6 sensors, n_axes) each.

    `down` (3,) is gravity in the chain's last frame.
    """

    position: np.ndarray
    speed: np.ndarray
    acceleration: np.ndarray
    down: np.ndarray


def chain_at_rest(chain: Chain, sensors: tuple[InertialSensor, ...], pose: np.ndarray) -> RestGradients:
    """Return the gradients at a pose (n_axes,), by differences: exact for speeds and accelerations, to 1e-9 for positions."""
    n = len(pose)
    gradients = [np.zeros((6 * len(sensors), n)) for _ in range(3)]
    zero = np.zeros(n)

    def read(sensor: InertialSensor, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
        return chain_reading(chain, sensor, np.concatenate((q, v, a)))

    for index, sensor in enumerate(sensors):
        place = slice(6 * index, 6 * index + 6)
        still = read(sensor, pose, zero, zero)
        for i, unit in enumerate(np.eye(n)):
            step = DIFFERENCE * unit
            gradients[0][place, i] = (read(sensor, pose + step, zero, zero) - read(sensor, pose - step, zero, zero)) / (2.0 * DIFFERENCE)
            gradients[1][place, i] = (read(sensor, pose, unit, zero) - read(sensor, pose, -unit, zero)) / 2.0
            gradients[2][place, i] = read(sensor, pose, zero, unit) - still
    down = -sensors[0].rotation @ read(sensors[0], pose, zero, zero)[:3] if sensors else np.zeros(3)
    return RestGradients(gradients[0], gradients[1], gradients[2], down)


def chain_reading(chain: Chain, sensor: InertialSensor, motion: np.ndarray) -> np.ndarray:
    """Return the specific force and rate (6,) that a sensor on the rigid chain reads.

    `motion` (3 n_axes,) holds the axes' positions, speeds and accelerations.
    """
    x, y, z = (float(value) for value in sensor.sensor_end_m)
    omega, force = _motion(chain.axes, chain.points, chain.revolute, chain.gravity_m_s2, motion, (x, y, z))
    return np.concatenate((np.array(force) @ sensor.rotation, np.array(omega) @ sensor.rotation))


@exactly_compiled
def _motion(
    axes: np.ndarray, points: np.ndarray, revolute: np.ndarray, gravity: np.ndarray, motion: np.ndarray, end: Vector
) -> tuple[Vector, Vector]:
    omega, _, force = chain_motion(axes, points, revolute, gravity, motion, end)
    return omega, force


def basis_at(harmonics: Sequence[int], poses: Sequence[np.ndarray] | np.ndarray) -> np.ndarray:
    """Return the values (poses, basis) of the scheduling functions at poses (n_axes,)."""
    basis = np.zeros((len(poses), basis_size(tuple(harmonics))))
    for row, pose in zip(basis, poses, strict=True):
        basis_values(np.array(harmonics, dtype=np.int64), pose, row)
    return basis


def basis_size(harmonics: tuple[int, ...]) -> int:
    """Return the number of functions in the tensor product of 1, cos θ, sin θ, cos 2θ, ... over the axes."""
    return int(np.prod([2 * order + 1 for order in harmonics], dtype=int))


@exactly_compiled
def basis_values(harmonics: np.ndarray, pose: np.ndarray, out: np.ndarray) -> None:
    """Write the values (basis,) of the scheduling functions at a pose; the last axis varies fastest."""
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
def schedule(sizes: np.ndarray, harmonics: np.ndarray, coefficients: np.ndarray, pose: np.ndarray, values: np.ndarray) -> None:
    """Write all parameters (rows,) at a pose (n_axes or more,): (5.35) with θ frozen there, those of the modes as in (5.30).

    `sizes` are axes, modes, sensors; `coefficients` (basis, rows) are the model's, transposed so that sums run along memory. Rows beyond
    those of `ModalModel.coefficients` keep the values of their polynomials.
    """
    basis = np.zeros(coefficients.shape[0])
    basis_values(harmonics, pose, basis)
    values[:] = 0.0
    for k in range(coefficients.shape[0]):
        value = basis[k]
        for row in range(coefficients.shape[1]):
            values[row] += coefficients[k, row] * value
    n, modes = sizes[0], sizes[1]
    stride = 2 + 3 * n + 6 * sizes[2]
    for i in range(modes):
        first = i * stride
        stiffness = 1.0 / max(values[first], SMALLEST_s2)
        values[first] = stiffness
        values[first + 1] *= stiffness
        for k in range(first + stride - n, first + stride):
            values[k] *= stiffness
        values[modes * stride + n * (n + 1) + n + i] *= stiffness
