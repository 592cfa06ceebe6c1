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

LOG_STEPS = LOG_STEP * np.array([[0.0, 0.0], [1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])[:, :, None]
"""Of frequency and damping: none, then a step to either side of each."""

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
        self._walk = np.zeros(ends[-1])  # variance that a second adds
        self._walk[self.bias], self._walk[self.dynamic] = random.bias_walk**2, np.repeat(random.dynamic_walk, m) ** 2
        self._walk[self.fixed] = random.parameter_walk**2

    @property
    def ratios(self) -> np.ndarray:
        """Ratios (3, m) of frequency, damping and mass to the start."""
        found: np.ndarray = np.exp(self.x[self.dynamic]).reshape(3, self.machine.modes)
        return found

    def predict(self, seconds: float, effort: np.ndarray) -> None:
        """Let time pass under an effort (axes,): (5.7), (5.9)."""
        if seconds <= 0.0:
            return
        F, moved, kept = self._moves(seconds, effort)
        moving, known = F.shape
        # The other states stay: F P Fᵀ is P but for the rows and columns of what moves
        ahead = F @ self.covariance[:known]
        among = ahead[:, :known] @ F.T
        self.x = np.concatenate([moved, self.x[moving:]])
        self.covariance[:moving], self.covariance[:, :moving] = ahead, ahead.T
        self.covariance[:moving, :moving] = 0.5 * (among + among.T)
        self._grow(seconds, kept)

    def _moves(self, seconds: float, effort: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
        """Return the rows F of what moves (axes, modes) per what moves it, its states after that time, and the share left of a push."""
        machine = self.machine
        n, m = machine.axes, machine.modes
        F = np.eye(self.mode.stop, self.dynamic.stop)
        axis = np.arange(n)
        F[axis, n + axis] = F[n + axis, 2 * n + axis] = seconds
        F[axis, 2 * n + axis] = 0.5 * seconds**2
        kept = float(np.exp(-seconds / self.random.push_s))
        states, log = self.x[self.mode].reshape(3, m), self.x[self.dynamic].reshape(3, m)
        pushed = (machine.gain @ effort) * np.exp(-log[2])
        force = pushed + states[2]
        logs = log[:2] + LOG_STEPS
        phi, gamma = swing_step(2.0 * np.pi * machine.frequency_Hz * np.exp(logs[:, 0]), machine.damping * np.exp(logs[:, 1]), seconds)
        ends = (phi @ states[:2].T[:, :, None])[..., 0] + gamma * force[:, None]  # (5, m, 2): at the logarithms, and a step to either side
        phi, gamma = phi[0], gamma[0]
        mode = self.mode.start + np.arange(3 * m).reshape(3, m)
        swings, parameters = mode[:2, None], self.dynamic.start + np.arange(3 * m).reshape(3, m)
        F[swings, mode[:2]] = phi.transpose(1, 2, 0)
        F[mode[:2], mode[2]], F[mode[2], mode[2]] = gamma.T, kept
        F[swings, parameters[:2]] = (ends[1::2] - ends[2::2]).transpose(2, 0, 1) / (2.0 * LOG_STEP)
        F[mode[:2], parameters[2]] = -(gamma * pushed[:, None]).T
        moved = np.concatenate([F[self.axis, self.axis] @ self.x[self.axis], *ends[0].T, kept * states[2]])
        return F, moved, kept

    def _grow(self, seconds: float, kept: float) -> None:
        """Add what the process noise adds, (5.9)."""
        random, n, m, t = self.random, self.machine.axes, self.machine.modes, seconds
        white = np.array(
            [[t**5 / 20.0, t**4 / 8.0, t**3 / 6.0], [t**4 / 8.0, t**3 / 3.0, t**2 / 2.0], [t**3 / 6.0, t**2 / 2.0, t]]
        )  # white jerk, integrated
        axis = np.arange(3 * n).reshape(3, n)
        self.covariance[axis[:, None], axis] += white[:, :, None] * random.jerk**2
        grown = seconds * self._walk
        grown[self.mode.stop - m : self.mode.stop] = (1.0 - kept**2) * random.push**2
        spots = np.arange(len(grown))
        self.covariance[spots, spots] += grown

    def sense(
        self,
        encoder: np.ndarray,
        imu: np.ndarray,
        effort: np.ndarray,
        rows: Readings,
        k: int,
        motion: np.ndarray,
        wrong: np.ndarray,
    ) -> float:
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
        wrong : (6,) array
            What they are wrong by, see `beyond_first_order`.

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
        spots = np.arange(self.bias.start, self.bias.stop)
        self.covariance[spots, spots] += wrong**2
        known = np.isfinite(measured)
        if not known.any():
            return float("nan")
        innovation, H = (measured - expected)[known], H[known]
        noise = np.diag(np.concatenate([self.random.encoder, self.random.imu])[known] ** 2)
        return self.update_whitened(innovation, H, noise) / len(innovation)

    def beyond_first_order(self, rows: Readings) -> np.ndarray:
        """Return by how much (N, 6) readings are wrong beyond first order while the chain's parameters are hardly known; 0: negligible.

        A tilt of standard deviation σ makes a specific force f wrong by f σ²/2, in all samples alike. Unless the sensor's bias is made as
        unsure, ten thousand samples would tell parameters what none of them knows.
        """
        fixed = rows.by_parameter[:, :3]
        spread = np.sum((fixed @ self.unsure) * fixed, axis=(1, 2))
        force, rate = np.linalg.norm(rows.values[:, :3], axis=1), np.linalg.norm(rows.values[:, 3:], axis=1)
        wrong = np.repeat((0.5 * spread / force**2)[:, None] * np.stack([force, rate], axis=1), 3, axis=1)
        return np.where(wrong > NEGLECTED * self.random.imu, wrong, 0.0)

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
        poses, jacobian = chain.poses_and_jacobian(x[place][None, :n], machine.swing(x[place][None, n:]))
        rest, table = pose_gap(image.source[None], image.phantom[None], image.rotation[None], poses)[0], jacobian[0]
        p = len(chain.names)
        gradient = np.zeros((9, len(x)))
        gradient[:, self.fixed] = table[:, :p]
        gradient[:, place] = table[:, [*range(p, p + n), *(p + n + j for j in machine.swinging)]]
        return rest - table[:, :p] @ (x[self.fixed] - about), gradient

    def geometry(self) -> tuple[tuple[np.ndarray, np.ndarray, np.ndarray], np.ndarray]:
        """Return the poses of focal spot and phantom now, as of `FlexibleChain.poses`, and their covariance (9, 9)."""
        machine, n, m = self.machine, self.machine.axes, self.machine.modes
        chain = machine.chain.with_values(self.x[self.fixed])
        poses, jacobian = chain.poses_and_jacobian(self.x[None, :n], machine.swing(self.x[None, self.mode][:, :m]))
        p, table = len(chain.names), jacobian[0]
        gradient = np.zeros((9, len(self.x)))
        gradient[:, self.fixed], gradient[:, :n] = table[:, :p], table[:, p : p + n]
        gradient[:, self.mode.start : self.mode.start + m] = table[:, [p + n + j for j in machine.swinging]]
        return poses, gradient @ self.covariance @ gradient.T

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
