"""Small models for the observers' tests, and an independent derivation of what their sensors read."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.linalg import expm

from controllers.models.chain import Chain
from controllers.models.modal import InertialSensor, ModalModel
from controllers.observers.settings import ObserverNoise

CHANNELS = ("imu_x", "imu_y", "imu_z", "gyro_x", "gyro_y", "gyro_z")
CENTER, SENSOR, SOURCE = np.array([0.0, 0.0, 0.35]), np.array([0.15, 0.12, 0.5]), np.array([0.0, 0.0, -0.81])
FREQUENCIES_Hz, DAMPING = np.array([8.0, 14.0, 22.0, 27.0]), 0.012
GRAVITY = np.array([0.0, 0.0, -9.81])


def small_model(revolute: bool = True, gravity: np.ndarray = GRAVITY, lag_s: float = 1.6e-3, modes: int = 4) -> ModalModel:
    """Two axes that meet in the isocentre and some modes with shapes drawn once."""
    generator = np.random.default_rng(3)
    omega = 2.0 * np.pi * FREQUENCIES_Hz[:modes]
    rows = []
    for i in range(modes):
        shapes, given = 0.4 * generator.normal(size=10), 0.5 * generator.normal(size=2)
        rows += [omega[i] ** -2, 2.0 * DAMPING / omega[i], *shapes, *given / omega[i] ** 2]
    rows += [0.30, 0.01, 0.01, 0.25, 0.2, 0.15]  # B_r, C
    pushes = 0.1 * generator.normal(size=2 + modes)
    rows += [*pushes[:2], *pushes[2:] / omega**2] + [0.0] * 6
    sensor = InertialSensor(CENTER, SENSOR, np.eye(3), lag_s, CHANNELS)
    chain = Chain(np.eye(3)[:2], np.zeros((2, 3)), np.array([revolute] * 2), np.asarray(gravity, float))
    return ModalModel(
        axes=("propeller", "roll"),
        chain=chain,
        sensors=(sensor,),
        source_end_m=SOURCE,
        harmonics=(0, 0),
        coefficients=np.array(rows)[:, None],
        sample_rate_Hz=256.0,
        effort_limit=np.array([8.0, 8.0]),
        position_unit=("rad", "rad"),
    )


def with_lower_mode(model: ModalModel, factor: float) -> ModalModel:
    """The model with the first mode's frequency lower by a factor, its damping ratio and all that pushes it as they were."""
    coefficients = model.coefficients.copy()
    coefficients[[0, 12, 13, 4 * 14 + 8]] *= factor**2
    coefficients[1] *= factor
    return replace(model, coefficients=coefficients)


def small_noise(modes: int = 4, **changes: float) -> ObserverNoise:
    """Noise of the C-arm's size."""
    return ObserverNoise(
        command=np.full(2, 0.01),
        disturbance=np.full(2 + modes, 0.5),
        disturbance_time_s=np.full(2 + modes, 0.1),
        bias_walk=np.repeat([1e-4, 1e-5], 3),
        measurement=np.concatenate((np.full(2, 1e-5), np.full(2, 5e-6), np.full(3, 0.005), np.full(3, 0.0005))),
        initial_bias=np.repeat([0.02, 0.002], 3),
        **changes,
    )


class DenseModel:
    """The same model written again with matrices: an exponential for the time step, rotation matrices for the sensors."""

    def __init__(self, model: ModalModel, noise: ObserverNoise) -> None:
        self.n, self.modes = 2, model.modes
        n, modes = self.n, self.modes
        values = model.coefficients[:, 0]
        table = values[: modes * 14].reshape(modes, 14)
        rest = values[modes * 14 :]
        self.stiffness = 1.0 / table[:, 0]
        self.damping, self.inputs = table[:, 1] * self.stiffness, table[:, 12:] * self.stiffness[:, None]
        self.motor, self.link, self.twist = table[:, 2:4].T, table[:, 4:6].T, table[:, 6:12].T
        self.B, self.C, self.push = rest[:4].reshape(2, 2), rest[4:6], np.concatenate((rest[6:8], rest[8 : 8 + modes] * self.stiffness))
        self.gravity, self.revolute = model.chain.gravity_m_s2, bool(model.chain.revolute[0])
        self.lag = model.sensors[0].lag_s
        self.period = 1.0 / model.sample_rate_Hz
        size = n + modes
        self.G = np.eye(size) if model.directions is None else model.directions[:, :, 0] * np.append([1.0, 1.0], self.stiffness)[:, None]
        self.colour, self.colour_noise = colour_of(noise, self.period)
        self.pushes, self.after = self.G.shape[1], 2 * size + len(self.colour)
        self.states = self.after + 6
        A = np.zeros((2 * size, 2 * size))
        A[:size, size:] = np.eye(size)
        A[size:, :size] = -np.diag(np.concatenate(([0.0, 0.0], self.stiffness)))
        A[size:, size:] = -np.diag(np.concatenate(([0.0, 0.0], self.damping)))
        self.A = A
        self.order = np.concatenate((np.arange(n), size + np.arange(n), n + np.arange(modes), size + n + np.arange(modes)))
        self.noise = noise
        self._known: dict[float, tuple[np.ndarray, np.ndarray]] = {}

    def forcing(self, u: np.ndarray) -> np.ndarray:
        """Accelerations (axes + modes,) that commands and gravity bring."""
        return np.concatenate((self.B @ u, self.inputs @ u)) + self.push

    def rubbed(self, x: np.ndarray, force: np.ndarray, later: float) -> np.ndarray:
        """Accelerations with the drives' friction, of the motor sides' speeds so much later if nothing rubbed more."""
        n, modes, seen = self.n, self.modes, np.hstack((np.eye(self.n), self.motor))
        drives = np.vstack((self.B, self.inputs))
        rate = np.concatenate((x[n : 2 * n], x[2 * n + modes : 2 * n + 2 * modes]))
        force = force - drives @ (self.C * (seen @ rate))
        bent = np.concatenate((np.zeros(n), self.stiffness * x[2 * n : 2 * n + modes] + self.damping * rate[n:]))
        return force - later * drives @ (self.C * (seen @ (force - bent)))

    def held(self, duration: float) -> tuple[np.ndarray, np.ndarray]:
        """`_held`, once for each duration."""
        if duration not in self._known:
            self._known[duration] = self._held(duration)
        return self._known[duration]

    def _held(self, duration: float) -> tuple[np.ndarray, np.ndarray]:
        """Transition of [q, η, q', η'] and gain of held accelerations over a duration, in the order [q, q', η, η']."""
        size = len(self.A) // 2
        whole = np.zeros((3 * size, 3 * size))
        whole[: 2 * size, : 2 * size] = self.A
        whole[size : 2 * size, 2 * size :] = np.eye(size)
        step = expm(whole * duration)
        return step[np.ix_(self.order, self.order)], step[self.order, 2 * size :]

    def transition(self, x: np.ndarray, u: np.ndarray) -> np.ndarray:
        size = len(self.A) // 2
        step, gain = self.held(self.period)
        coloured = self.colour @ x[2 * size : self.after]
        d = self.G @ coloured[: self.pushes]
        force = self.rubbed(x, self.forcing(u) + d, 0.5 * self.period)
        return np.concatenate((step @ x[: 2 * size] + gain @ force, coloured, x[self.after :]))

    def process_covariance(self) -> np.ndarray:
        size, period, noise = len(self.A) // 2, self.period, self.noise
        _, gain = self.held(period)
        by_command = np.zeros((self.states, 2))
        by_command[: 2 * size] = gain @ np.vstack((self.B, self.inputs))
        by_disturbance = np.zeros((self.states, len(self.colour)))
        by_disturbance[: 2 * size, : self.pushes] = gain @ self.G
        by_disturbance[2 * size : self.after] = np.eye(len(self.colour))
        total = by_command @ np.diag(noise.command**2) @ by_command.T + by_disturbance @ self.colour_noise @ by_disturbance.T
        total[self.after :, self.after :] += np.diag(noise.bias_walk**2 * period)
        return total

    def outputs(self, x: np.ndarray, u: np.ndarray) -> np.ndarray:
        size = len(self.A) // 2
        force = self.rubbed(x, self.forcing(u) + self.G @ x[2 * size : 2 * size + self.pushes], 0.0)
        back, gain = self.held(-self.lag)
        past = back @ x[: 2 * size] + gain @ force
        n, modes = self.n, self.modes
        now_q, now_eta = x[:n], x[2 * n : 2 * n + modes]
        q, v = past[:n], past[n : 2 * n]
        eta, rate = past[2 * n : 2 * n + modes], past[2 * n + modes :]
        a = force[:n]
        # the axes' lag is taken to first order in speed, second in position
        v = x[n : 2 * n] - self.lag * a
        q = x[:n] - self.lag * (x[n : 2 * n] - 0.5 * self.lag * a)
        acceleration = force[n:] - self.stiffness * eta - self.damping * rate
        low_pass = 1.0 / np.sqrt(1.0 + self.stiffness * self.lag**2)
        shift, turn = self.twist[:3], self.twist[3:]
        at_sensor = shift + np.array([np.cross(column, SENSOR - CENTER) for column in turn.T]).T
        if self.revolute:
            R1, R2 = _rotation(0, q[0]), _rotation(1, q[1])
            down = (R1 @ R2).T @ self.gravity
            omega = R2.T @ np.array([v[0], 0.0, 0.0]) + np.array([0.0, v[1], 0.0])
            first = R2.T @ np.array([v[0], 0.0, 0.0])
            alpha = R2.T @ np.array([a[0], 0.0, 0.0]) + np.array([0.0, a[1], 0.0]) - np.cross([0.0, v[1], 0.0], first)
            felt = np.cross(alpha, SENSOR) + np.cross(omega, np.cross(omega, SENSOR)) - down
        else:
            omega = np.zeros(3)
            felt = np.array([a[0], a[1], 0.0]) - self.gravity
        rho = turn @ eta
        velocity = at_sensor @ (low_pass * rate)
        f = felt - np.cross(rho, felt) + at_sensor @ (low_pass * acceleration) + 2.0 * np.cross(omega, velocity)
        w = omega - np.cross(rho, omega) + turn @ (low_pass * rate)
        bias = x[self.after :]
        return np.concatenate((now_q + self.motor @ now_eta, now_q + self.link @ now_eta, f + bias[:3], w + bias[3:]))


def colour_of(noise: ObserverNoise, period: float) -> tuple[np.ndarray, np.ndarray]:
    """Transition and covariance over a sample of disturbances and then quadratures, from their equations in continuous time (Van Loan)."""
    count = len(noise.disturbance)
    band = list(np.flatnonzero(noise.disturbance_Hz))
    rates, density = np.zeros((count + len(band),) * 2), np.zeros((count + len(band),) * 2)
    for j in range(count):
        in_band = j in band
        rates[j, j] = -(2.0 if in_band else 1.0) / noise.disturbance_time_s[j]
        driven = -2.0 * rates[j, j] * noise.disturbance[j] ** 2
        is_low_pass = len(noise.low_pass) > 0 and noise.low_pass[j]
        density[j, j] = 0.0 if is_low_pass else driven
        if in_band:
            k = count + band.index(j)
            rates[k, j] = 2.0 * np.pi * noise.disturbance_Hz[j]
            rates[j, k] = -rates[k, j]
            density[k, k] = driven if is_low_pass else 0.0
    size = len(rates)
    whole = expm(period * np.block([[-rates, density], [np.zeros((size, size)), rates.T]]))
    step = whole[size:, size:].T
    return step, step @ whole[:size, size:]


def _rotation(axis: int, angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    if axis == 0:
        return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])
    return np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])


def drawn_rows(dense: DenseModel, noise: ObserverNoise, rows: int, seed: int, commands: np.ndarray | None = None) -> tuple:
    """Rows (N, 10) and commands (N, 2) drawn from the model itself, and its states (N, states): what a filter is consistent with."""
    generator = np.random.default_rng(seed)
    values, vectors = np.linalg.eigh(dense.process_covariance())
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    x = np.zeros(dense.states)
    commands = 0.5 * np.sin(np.arange(rows)[:, None] / np.array([17.0, 29.0])) if commands is None else commands
    measured, states = np.zeros((rows, 10)), np.zeros((rows, dense.states))
    for k in range(rows):
        u = commands[max(k - 2, 0)] if k else np.zeros(2)
        if k:
            x = dense.transition(x, u) + root @ generator.standard_normal(dense.states)
        states[k] = x
        measured[k] = dense.outputs(x, u) + noise.measurement * generator.standard_normal(10)
    return measured, commands, states
