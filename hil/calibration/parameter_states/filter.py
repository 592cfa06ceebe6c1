"""One filter for the motion and its parameters: encoders and inertial sensor at every sample, images whenever they come.

States: [q, q', q'', η, η', ξ_d, b, ln Ω, ln Z, ln μ, ξ], the axes' motion, the modes, what else pushes them, the sensor's biases, the
dynamic parameters as logarithms of ratios to the start, and the parameters of the chain. Extended Kalman filter (5.11)-(5.13), with
Q for the parameters too. With respect to the chain's parameters all measurements are linearised about one point, `about`: each at the
latest estimate, as (5.12) has it, would make combinations known that no measurement sees. Where an image moves the estimate further than
that linearisation reaches, it says so, and the run begins anew about the new estimate (`run`). A machine is that far from its drawing.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.stats import chi2

from controllers.filtering.late_measurements import LateMeasurements
from controllers.models.swinging_chain import Readings, swing_step
from hil.calibration.parameter_states.filter_model import PoseImage, Randomness, SwingingMachine, pose_gap

USED, REFUSED, FAR = "used", "refused", "far"
"""What became of an image."""

ROUNDS = 5
"""Iterations of an image's update; from the drawing's tolerance the third moves by less than the image's noise."""

REACH = 0.1
"""Share of an image's noise that its linearisation may be wrong by."""

SURPRISE = float(chi2.ppf(1.0 - 1e-6, 9))
"""Limit of an image's normalised innovation: one in a million is beyond it where the image shows what it should."""

NEGLECTED = 0.01
"""Share of the sensor's noise that its linearisation may be wrong by: the mean of ten thousand samples tells no less."""

LOG_STEP = 1e-5
"""Difference step of a logarithm."""

START_SPEED, START_ACCELERATION = 2.0, 10.0
"""Deviations of an axis's speed [rad/s] and acceleration [rad/s^2] before the first sample."""


class ParameterStatesFilter(LateMeasurements):
    """The filter of one run.

    Parameters
    ----------
    machine : SwingingMachine
        The start: parameters as on the drawing.
    random : Randomness
    encoder : (axes,) array
        First measured positions.
    about : (p,) array, optional
        The chain's parameters that measurements are linearised about; else the start.
    unsure : (p, p) array, optional
        Covariance of `about`.

    Attributes
    ----------
    axis, mode, bias, dynamic, fixed : slices
        Positions, speeds and accelerations of the axes; deflections, speeds and pushes of the modes; biases; dynamic parameters, kind by
        kind; the chain's parameters.
    """

    def __init__(
        self,
        machine: SwingingMachine,
        random: Randomness,
        encoder: np.ndarray,
        about: np.ndarray | None = None,
        unsure: np.ndarray | None = None,
    ) -> None:
        self.machine, self.random = machine, random
        self.about = machine.chain.values if about is None else about
        self.unsure = np.diag(random.parameters**2) if unsure is None else unsure
        n, m, p = machine.axes, machine.modes, len(machine.chain.names)
        ends = np.cumsum([3 * n, 3 * m, 6, 3 * m, p])
        self.axis, self.mode, self.bias, self.dynamic, self.fixed = (
            slice(int(end - size), int(end)) for end, size in zip(ends, [3 * n, 3 * m, 6, 3 * m, p], strict=True)
        )
        x = np.zeros(ends[-1])
        x[:n], x[self.fixed] = encoder, machine.chain.values
        omega = 2.0 * np.pi * machine.frequency_Hz
        deflected = random.push / omega**2 / np.sqrt(2.0 * machine.damping)
        std = np.concatenate(
            [
                3.0 * random.encoder,
                np.full(n, START_SPEED),
                np.full(n, START_ACCELERATION),
                deflected,
                deflected * omega,
                random.push,
                random.bias,
                np.repeat(random.dynamic, m),
                random.parameters,
            ]
        )
        super().__init__(x, np.diag(std**2), np.r_[0:n, 3 * n : 3 * n + m])

    @property
    def ratios(self) -> np.ndarray:
        """Ratios (3, m) of frequency, damping and mass to the start."""
        found: np.ndarray = np.exp(self.x[self.dynamic]).reshape(3, self.machine.modes)
        return found

    def predict(self, seconds: float, effort: np.ndarray) -> None:
        """Let time pass under an effort (axes,): (5.7), (5.9)."""
        if seconds <= 0.0:
            return
        machine, random = self.machine, self.random
        n, m = machine.axes, machine.modes
        F = np.eye(len(self.x))
        after = self.x.copy()
        for i in range(n):
            F[i, n + i] = F[n + i, 2 * n + i] = seconds
            F[i, 2 * n + i] = 0.5 * seconds**2
        after[self.axis] = F[self.axis, self.axis] @ self.x[self.axis]
        kept = np.exp(-seconds / random.push_s)
        eta, speed, push = self.x[self.mode].reshape(3, m)
        log = self.x[self.dynamic].reshape(3, m)
        pushed = (machine.gain @ effort) * np.exp(-log[2])
        force, state = pushed + push, np.stack([eta, speed], -1)
        phi, gamma = self._step(log, seconds)
        after[self.mode] = np.concatenate([*(phi @ state[..., None])[..., 0].T + gamma.T * force, kept * push])
        by_log = []
        for kind in range(2):
            moved = np.zeros_like(log)
            moved[kind] = LOG_STEP
            ahead, behind = self._step(log + moved, seconds), self._step(log - moved, seconds)
            change = ((ahead[0] - behind[0]) @ state[..., None])[..., 0] + (ahead[1] - behind[1]) * force[:, None]
            by_log.append(change / (2.0 * LOG_STEP))
        by_log.append(-gamma * pushed[:, None])
        for k in range(m):
            place = self.mode.start + k + m * np.arange(3)
            F[np.ix_(place[:2], place[:2])] = phi[k]
            F[place[:2], place[2]], F[place[2], place[2]] = gamma[k], kept
            for kind in range(3):
                F[place[:2], self.dynamic.start + kind * m + k] = by_log[kind][k]
        self.x = after
        self.covariance = F @ self.covariance @ F.T
        self._grow(seconds, kept)

    def _step(self, log: np.ndarray, seconds: float) -> tuple[np.ndarray, np.ndarray]:
        omega = 2.0 * np.pi * self.machine.frequency_Hz * np.exp(log[0])
        return swing_step(omega, self.machine.damping * np.exp(log[1]), seconds)

    def _grow(self, seconds: float, kept: float) -> None:
        """Add what the process noise adds, (5.9)."""
        random, n, m, t = self.random, self.machine.axes, self.machine.modes, seconds
        white = np.array(
            [[t**5 / 20.0, t**4 / 8.0, t**3 / 6.0], [t**4 / 8.0, t**3 / 3.0, t**2 / 2.0], [t**3 / 6.0, t**2 / 2.0, t]]
        )  # white jerk, integrated
        for i in range(n):
            self.covariance[np.ix_([i, n + i, 2 * n + i], [i, n + i, 2 * n + i])] += random.jerk[i] ** 2 * white
        spots = np.arange(self.mode.start + 2 * m, self.mode.stop)
        self.covariance[spots, spots] += (1.0 - kept**2) * random.push**2
        for place, walk in (
            (self.bias, random.bias_walk),
            (self.dynamic, np.repeat(random.dynamic_walk, m)),
            (self.fixed, random.parameter_walk),
        ):
            spots = np.arange(place.start, place.stop)
            self.covariance[spots, spots] += seconds * walk**2

    def sense(self, encoder: np.ndarray, imu: np.ndarray, effort: np.ndarray, rows: Readings, k: int, motion: np.ndarray) -> float:
        """Take in the encoders (axes,) and the sensor (6,) at one sample.

        Parameters
        ----------
        encoder, imu : arrays
            NaN where missing.
        effort : (axes,) array
            That acted until this sample.
        rows : Readings
        k : int
            The sample's place in `rows`, which are linearised about `about`.
        motion : (3 axes,) array
            The motion that they are linearised about.

        Returns
        -------
        float
            Normalised innovation squared over its degrees of freedom.
        """
        machine = self.machine
        n, m, modes = machine.axes, machine.modes, [machine.axes + j for j in machine.swinging]
        H = np.zeros((n + 6, len(self.x)))
        H[:n, :n] = np.eye(n)
        expected = np.concatenate([self.x[:n], rows.values[k] + self.x[self.bias]])
        seen = H[n:]
        for j, slope in enumerate((rows.by_position[k], rows.by_speed[k], rows.by_acceleration[k])):
            seen[:, j * n : (j + 1) * n] = slope[:, :n]
        seen[:, self.bias], seen[:, self.fixed] = np.eye(6), rows.by_parameter[k]
        expected[n:] += seen[:, self.axis] @ (self.x[self.axis] - motion)
        expected[n:] += seen[:, self.fixed] @ (self.x[self.fixed] - self.about)
        eta, speed, push = self.x[self.mode].reshape(3, m)
        ratio = self.ratios
        omega, damping = 2.0 * np.pi * machine.frequency_Hz * ratio[0], machine.damping * ratio[1]
        pushed = (machine.gain @ effort) / ratio[2]
        rubbed = 2.0 * damping * omega
        acceleration = -(omega**2) * eta - rubbed * speed + pushed + push
        by = rows.by_position[k][:, modes], rows.by_speed[k][:, modes], rows.by_acceleration[k][:, modes]
        expected[n:] += by[0] @ eta + by[1] @ speed + by[2] @ acceleration
        place, logs = self.mode.start, self.dynamic.start
        seen[:, place : place + m] = by[0] - by[2] * omega**2
        seen[:, place + m : place + 2 * m] = by[1] - by[2] * rubbed
        seen[:, place + 2 * m : place + 3 * m] = by[2]
        seen[:, logs : logs + m] = -by[2] * (2.0 * omega**2 * eta + rubbed * speed)
        seen[:, logs + m : logs + 2 * m] = -by[2] * (rubbed * speed)
        seen[:, logs + 2 * m : logs + 3 * m] = -by[2] * pushed
        measured = np.concatenate([encoder, imu])
        self._leave_to_bias(seen, rows.values[k])
        known = np.isfinite(measured)
        if not known.any():
            return float("nan")
        innovation, H = (measured - expected)[known], H[known]
        noise = np.diag(np.concatenate([self.random.encoder, self.random.imu])[known] ** 2)
        nis = self.surprise(innovation, H, noise) / len(innovation)
        self.update(innovation, H, noise)
        self.covariance = 0.5 * (self.covariance + self.covariance.T)
        return nis

    def _leave_to_bias(self, seen: np.ndarray, values: np.ndarray) -> None:
        """Make the sensor's bias as unsure as its linearisation is wrong while the chain's parameters are hardly known.

        A tilt of standard deviation σ makes a specific force f wrong by f σ²/2 beyond first order, in all samples alike. Without this
        ten thousand samples would tell parameters what none of them knows.
        """
        fixed = seen[:3, self.fixed]
        spread = float(np.trace(fixed @ self.unsure @ fixed.T))
        force, rate = float(np.linalg.norm(values[:3])), float(np.linalg.norm(values[3:]))
        left = 0.5 * spread / force**2
        wrong = np.repeat([left * force, left * rate], 3)
        spots = np.arange(self.bias.start, self.bias.stop)
        self.covariance[spots, spots] += np.where(wrong > NEGLECTED * self.random.imu, wrong**2, 0.0)

    def see(self, number: int, image: PoseImage, is_newest: bool = True) -> str:
        """Take in an image exposed as `number`. `is_newest`: `about` does not know of it yet.

        Returns
        -------
        str
            `USED`; `REFUSED`: it contradicts all else and was left out; `FAR`: what it tells is further from `about` than one
            linearisation reaches, and the estimate is that of iterations about itself.
        """
        prior, now = self.x.copy(), self.x.copy()
        linear, slope = self.gap(number, image, prior, self.about)
        if not is_newest:
            if self.surprise(linear, slope, image.covariance) > SURPRISE:
                return REFUSED
            self.update(linear, slope, image.covariance)
            return USED
        for _ in range(ROUNDS):
            rest, gradient = self.gap(number, image, now, now[self.fixed])
            innovation = rest - gradient @ (prior - now)
            now = prior + self.gain(gradient, image.covariance) @ innovation
        if self.surprise(innovation, gradient, image.covariance) > SURPRISE:
            return REFUSED
        exact, _ = self.gap(number, image, now, now[self.fixed])
        expected, _ = self.gap(number, image, now, self.about)
        wrong = np.abs(exact - expected) / np.sqrt(np.diag(image.covariance))
        tilt = slope[6:, self.fixed] @ (now[self.fixed] - self.about)
        force = float(np.linalg.norm(self.machine.gravity_m_s2))
        if wrong.max() > REACH or 0.5 * float(tilt @ tilt) * force > NEGLECTED * float(self.random.imu[:3].min()):
            self.update(innovation, gradient, image.covariance)
            return FAR
        self.update(linear, slope, image.covariance)
        return USED

    def gap(self, number: int, image: PoseImage, x: np.ndarray, about: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return an image less what states x expect (9,), and the change (9, states) of what is expected.

        Linear in the chain's parameters about `about` (p,).
        """
        machine, n, place = self.machine, self.machine.axes, self.copies(number)
        chain = machine.chain.with_values(about)
        position, deflection = x[place][None, :n], x[place][None, n:]
        rest = pose_gap(image.source[None], image.phantom[None], image.rotation[None], chain.poses(position, machine.swing(deflection)))[0]
        table = chain.jacobian_of_all(position)[0]
        p = len(chain.names)
        gradient = np.zeros((9, len(x)))
        gradient[:, self.fixed] = table[:, :p]
        gradient[:, place] = table[:, [*range(p, p + n), *(p + n + j for j in machine.swinging)]]
        return rest - table[:, :p] @ (x[self.fixed] - about), gradient

    def geometry(self) -> tuple[tuple[np.ndarray, np.ndarray, np.ndarray], np.ndarray]:
        """Return the poses of focal spot and phantom now, as of `FlexibleChain.poses`, and their covariance (9, 9)."""
        machine, n, m = self.machine, self.machine.axes, self.machine.modes
        chain = machine.chain.with_values(self.x[self.fixed])
        position, deflection = self.x[None, :n], self.x[None, self.mode][:, :m]
        table = chain.jacobian_of_all(position)[0]
        p = len(chain.names)
        gradient = np.zeros((9, len(self.x)))
        gradient[:, self.fixed], gradient[:, :n] = table[:, :p], table[:, p : p + n]
        gradient[:, self.mode.start : self.mode.start + m] = table[:, [p + n + j for j in machine.swinging]]
        return chain.poses(position, machine.swing(deflection)), gradient @ self.covariance @ gradient.T

    def found(self) -> SwingingMachine:
        """Return the machine with the parameters of now."""
        ratio = self.ratios
        return replace(
            self.machine,
            chain=self.machine.chain.with_values(self.x[self.fixed]),
            frequency_Hz=self.machine.frequency_Hz * ratio[0],
            damping=self.machine.damping * ratio[1],
            gain=self.machine.gain / ratio[2][:, None],
        )
