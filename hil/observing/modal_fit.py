"""The modal model of one pose from its frequency responses: Sec. 5.4.3.

Rigid motion is known from the chain except for inertia and damping. Every mode has one frequency, one damping ratio and one shape, which
all channels share: encoders measure its deflection, an accelerometer its acceleration and the tilt in gravity, a gyro its turning rate. So
the shape of the detector, which no sensor measures as a displacement, follows from its IMU.

The modes are driven by the command less the drives' friction, which follows from the motor sides' dynamic stiffness far below the first
mode. If it were modelled as damping of every mode separately, the coupling of the modes by friction would be lost.

Poles are found by least squares with the shapes eliminated (variable projection), weighted by the responses' covariances.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import optimize, signal

from controllers.models.chain import Chain
from controllers.models.modal import InertialSensor, chain_at_rest
from hil.errors import BadAnswerError, UnusableInputError
from hil.identification import FrequencyResponse
from hil.identification.result import CovarianceKind

LOWEST_Hz = 1.0
"""Lines below are left out: there gravity and friction, which are disturbances to the observer, bend the rigid response."""

MOST_LINES = 200
"""More lines are thinned evenly: a fit takes a second and not ten."""

FRICTION_Hz = 2.5
"""Lines up to here give the drives' friction: at 1 Hz it is some per cent of a motor side's dynamic stiffness, and modes are far."""

LEAST_LINES = 4
"""With fewer lines friction is taken as zero."""

START_DAMPING = 0.015
"""ζ to start from: light, as welded structures have."""

MODEL_SHARE = 0.01
"""A response is not trusted to better than this share of itself: the modal model's own error away from resonances, so that a few very
well measured lines do not decide the fit."""

PEAK_PROMINENCE = 0.5
"""Of the logarithm of the largest singular value, for a peak to count as a mode: 60 % above its surroundings."""

SNAP_OCTAVES = 0.4
"""How far a mode may have moved from one pose to the next for a peak to be taken for it: 30 %."""

TURN_LENGTH_m = 0.3
"""Length by which a turn of the detector is compared with a shift when a shape is scaled to 1: half its size."""


@dataclass(frozen=True)
class PoseFit:
    """Modal model at one pose.

    Attributes
    ----------
    pose : (n_axes,)
    stiffness, damping : (modes,) ω², 2ζω.
    shapes : (modes, channels) motor sides, link sides, six per observed body.
    inputs : (modes, n_axes)
    rigid : (n_axes, n_axes) B_r.
    friction : (n_axes,) of the drives per speed of the motor side, in the command's unit.
    misfit : (n_y, n_u) rms of the difference over rms of the response, over the lines used.
    """

    pose: np.ndarray
    stiffness: np.ndarray
    damping: np.ndarray
    shapes: np.ndarray
    inputs: np.ndarray
    rigid: np.ndarray
    friction: np.ndarray
    misfit: np.ndarray


class _Problem:
    """Data and regressors of one pose."""

    def __init__(
        self, response: FrequencyResponse, chain: Chain, sensors: tuple[InertialSensor, ...], friction: np.ndarray | None = None
    ) -> None:
        self.axes = len(response.input_names)
        self.chain, self.sensors = chain, sensors
        keep = np.flatnonzero(response.frequencies_Hz >= LOWEST_Hz)
        keep = keep[:: -(-len(keep) // MOST_LINES)]
        self.f = response.frequencies_Hz[keep]
        if len(self.f) < 20:
            raise UnusableInputError(f"only {len(self.f)} lines at or above {LOWEST_Hz:g} Hz; a modal model needs 20 and better a hundred")
        G = response.G[keep]
        kind: CovarianceKind = "noise" if response.total_covariance is None else "total"
        deviation = response.standard_deviation(kind)[keep]
        self.period = 1.0 / response.sample_rate_Hz
        self.z = np.exp(2j * np.pi * self.f * self.period)
        self.pose = np.array(response.pose)
        self.noise = np.median(deviation, axis=(0, 2))
        self.weight = 1.0 / np.sqrt(deviation**2 + (MODEL_SHARE * np.abs(G)) ** 2 + 1e-300)
        self.channels = G.shape[1]
        if self.channels != 2 * self.axes + 6 * len(sensors):
            raise UnusableInputError(
                f"the response has the outputs {', '.join(response.output_names)}; an observer's model needs both encoders of every axis"
                " and all channels of its inertial sensors: identify with outputs = the model's channels"
            )
        omega = 2.0 * np.pi * self.f
        self.friction = drive_friction(response) if friction is None else friction
        speeds = (1j * omega / _acting(omega, self.period))[:, None, None] * G[:, : self.axes]
        self.G = G @ np.linalg.inv(np.eye(self.axes) - self.friction[:, None] * speeds)  # to what friction leaves of the commands
        rest = chain_at_rest(chain, sensors, self.pose)
        self.rest_gradients, self.down = (rest.position, rest.speed, rest.acceleration), rest.down

    def paths(self, stiffness: complex, damping: float, lag: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Return responses (L,) of deflection, and of deflection, speed and acceleration as a sensor with this lag shows them."""
        p11, p12, p21, p22, g1, g2 = _held_step(stiffness, damping, self.period)
        # x(k+1) = Φ x(k) + Γ c(k-1)
        determinant = (self.z - p11) * (self.z - p22) - p12 * p21
        position = ((self.z - p22) * g1 + p12 * g2) / determinant / self.z
        speed = (p21 * g1 + (self.z - p11) * g2) / determinant / self.z
        b11, b12, b21, b22, h1, h2 = _held_step(stiffness, damping, -lag)
        acting = self.z**-2  # c(k-2) acts until sample k
        past = b11 * position + b12 * speed + h1 * acting
        past_speed = b21 * position + b22 * speed + h2 * acting
        past_acceleration = acting - stiffness * past - damping * past_speed
        low_pass = np.exp(2j * np.pi * self.f * lag) / (1.0 + 2j * np.pi * self.f * lag)  # what the lag alone leaves out
        return position, past * low_pass, past_speed * low_pass, past_acceleration * low_pass

    def regressors(self, poles: np.ndarray) -> np.ndarray:
        """Return regressors (L, channels, unknowns).

        Per mode the columns of the unknown shape (axes + axes + 6 per sensor), then one column per rigid axis.
        """
        n, modes, L = self.axes, (len(poles) - self.axes) // 2, len(self.f)
        width = 2 * n + 6 * len(self.sensors)
        table = np.zeros((L, self.channels, modes * width + n), complex)
        stiffness, damping = poles[: 2 * modes : 2], poles[1 : 2 * modes : 2]
        for i in range(modes):
            first = i * width
            for s, sensor in enumerate(self.sensors):
                now, past, speed, acceleration = self.paths(stiffness[i], damping[i], sensor.lag_s)
                arm = sensor.sensor_end_m - sensor.body_end_m
                to_sensor = sensor.rotation.T
                rows = slice(2 * n + 6 * s, 2 * n + 6 * s + 3)
                turns = slice(2 * n + 6 * s + 3, 2 * n + 6 * s + 6)
                column = first + 2 * n + 6 * s
                table[:, rows, column : column + 3] = acceleration[:, None, None] * to_sensor
                by_turn = -acceleration[:, None, None] * _skew(arm) - past[:, None, None] * _skew(self.down)  # ρ x arm, ρ x g
                table[:, rows, column + 3 : column + 6] = to_sensor @ by_turn
                table[:, turns, column + 3 : column + 6] = speed[:, None, None] * to_sensor
            for k in range(2 * n):
                table[:, k, first + k] = now
        for axis in range(n):
            stiff = poles[2 * modes + axis]
            column = modes * width + axis
            for s, sensor in enumerate(self.sensors):
                now, past, speed, acceleration = self.paths(stiff, 0.0, sensor.lag_s)
                rows = slice(2 * n + 6 * s, 2 * n + 6 * s + 6)
                p, v, a = (gradient[6 * s : 6 * s + 6, axis] for gradient in self.rest_gradients)
                table[:, rows, column] = past[:, None] * p + speed[:, None] * v + acceleration[:, None] * a
            table[:, axis, column] = now
            table[:, n + axis, column] = now
        return table

    def solve(self, poles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the weighted residual, real and imaginary parts apart, and the unknowns (unknowns, n_u).

        Normal equations are gathered group by group: an encoder's rows do not contain the other channels' shapes.
        """
        table = self.regressors(poles)
        count = table.shape[2]
        groups = [(rows, columns, table[:, rows][:, :, columns]) for rows, columns in self._groups(count)]
        residuals, unknowns = [], []
        for u in range(self.G.shape[2]):
            gram, right, parts = 1e-300 * np.eye(count), np.zeros(count), []
            for rows, columns, part in groups:
                weight = self.weight[:, rows, u]
                system = (part * weight[:, :, None]).reshape(-1, len(columns))
                target = (self.G[:, rows, u] * weight).ravel()
                system, target = np.concatenate((system.real, system.imag)), np.concatenate((target.real, target.imag))
                gram[np.ix_(columns, columns)] += system.T @ system
                right[columns] += system.T @ target
                parts.append((columns, system, target))
            size = np.sqrt(np.diag(gram))
            found = np.linalg.solve(gram / np.outer(size, size) + 1e-12 * np.eye(count), right / size) / size
            residuals += [target - system @ found[columns] for columns, system, target in parts]
            unknowns.append(found)
        return np.concatenate(residuals), np.column_stack(unknowns)

    def _groups(self, count: int) -> list[tuple[list[int], list[int]]]:
        """Return channels that share unknowns, and the columns of those."""
        n, width = self.axes, 2 * self.axes + 6 * len(self.sensors)
        firsts = range(0, count - n, width)
        rigid = list(range(count - n, count))
        groups = [([k], [first + k for first in firsts] + [rigid[k % n]]) for k in range(2 * n)]
        for s in range(len(self.sensors)):
            place = range(2 * n + 6 * s, 2 * n + 6 * s + 6)
            groups.append((list(place), [first + j for first in firsts for j in place] + rigid))
        return groups

    def fit(self, frequencies: np.ndarray, damping_ratios: np.ndarray | None = None) -> np.ndarray:
        """Fit poles from starting frequencies [Hz] and damping: ω², 2ζω of every mode, then stiffness of the rigid axes."""
        omega, modes = 2.0 * np.pi * frequencies, len(frequencies)
        scale = np.concatenate((np.column_stack((omega**2, omega)).ravel(), np.ones(self.axes)))
        damping = np.full(modes, START_DAMPING) if damping_ratios is None else np.clip(damping_ratios, 1e-3, 0.15)
        start = np.concatenate((np.column_stack((np.ones(modes), 2.0 * damping)).ravel(), np.full(self.axes, 0.1)))
        low = np.concatenate((np.tile([0.8, 1e-4], modes), np.full(self.axes, -40.0)))
        high = np.concatenate((np.tile([1.25, 0.4], modes), np.full(self.axes, 40.0)))
        solved = optimize.least_squares(
            lambda p: self.solve(p * scale)[0], start, bounds=(low, high), x_scale="jac", ftol=1e-5, max_nfev=20
        )
        found: np.ndarray = solved.x * scale
        return found


def fit_pose(
    response: FrequencyResponse,
    chain: Chain,
    sensors: tuple[InertialSensor, ...],
    modes: int,
    near: PoseFit | None = None,
    friction: np.ndarray | None = None,
) -> PoseFit:
    """Fit one pose.

    Parameters
    ----------
    response : FrequencyResponse
        From the axes' commands to motor sides, link sides and the sensors' channels, in this order.
    modes : int
        How many to look for.
    near : PoseFit, optional
        A pose nearby whose poles to start from; the most prominent peaks unless given.
    friction : (n_axes,) array, optional
        Of the drives, see `drive_friction`; from this response unless given.

    Raises
    ------
    BadAnswerError
        Fewer peaks than modes, or a fit that runs off.
    """
    problem = _Problem(response, chain, sensors, friction)
    if near is None:
        frequencies = peaks_Hz(problem, problem.G, modes)
        poles = problem.fit(frequencies)
    else:
        omega = np.sqrt(near.stiffness)
        frequencies = _snapped(omega / (2.0 * np.pi), peaks_Hz(problem, problem.G, modes))
        poles = problem.fit(frequencies, near.damping / (2.0 * omega))
    while len(frequencies) < modes:  # the next one stands out of the residual of the others
        left = problem.G - problem.regressors(poles) @ problem.solve(poles)[1]
        frequencies = np.append(np.sqrt(poles[: 2 * len(frequencies) : 2]) / (2.0 * np.pi), peaks_Hz(problem, left, 1, poles))
        poles = problem.fit(frequencies)
    _, unknowns = problem.solve(poles)
    if not np.isfinite(unknowns).all():
        raise BadAnswerError(
            f"the modal fit at pose {np.degrees(problem.pose).round(1).tolist()} deg ran off; give frequencies to start from"
        )
    n = problem.axes
    width = 2 * n + 6 * len(sensors)
    order = np.argsort(poles[: 2 * modes : 2])
    shapes, inputs = np.zeros((modes, width)), np.zeros((modes, n))
    for place, i in enumerate(order):
        shapes[place], inputs[place] = _rank_one(unknowns[i * width : (i + 1) * width], sensors)
    table = problem.regressors(poles)
    difference = problem.G - table @ unknowns
    misfit = np.sqrt(np.mean(np.abs(difference) ** 2, axis=0) / np.mean(np.abs(problem.G) ** 2, axis=0))
    return PoseFit(
        pose=problem.pose,
        stiffness=poles[: 2 * modes : 2][order],
        damping=poles[1 : 2 * modes : 2][order],
        shapes=shapes,
        inputs=inputs,
        rigid=unknowns[modes * width :],
        friction=problem.friction,
        misfit=misfit,
    )


def drive_friction(response: FrequencyResponse) -> np.ndarray:
    """Return the drives' friction (n_axes,) per speed of the motor side; zero where no line is low enough.

    It is in the command's unit. Below the first mode the motor sides' dynamic stiffness is -J ω² + i ω C; what modes' damping adds to its
    imaginary part grows as ω³.
    """
    axes = len(response.input_names)
    low = (response.frequencies_Hz >= LOWEST_Hz) & (response.frequencies_Hz <= FRICTION_Hz)
    omega = 2.0 * np.pi * response.frequencies_Hz[low]
    if len(omega) < LEAST_LINES:
        return np.zeros(axes)
    stiffness = _acting(omega, 1.0 / response.sample_rate_Hz)[:, None, None] * np.linalg.inv(response.G[low, :axes])
    system = np.column_stack((1.0 / omega, omega))  # weighted as inertia's part grows
    loss = np.diagonal(stiffness, axis1=1, axis2=2).imag / omega[:, None] ** 2
    coefficients: np.ndarray = np.maximum(np.linalg.lstsq(system, loss, rcond=None)[0][0], 0.0)
    return coefficients


def _acting(omega: np.ndarray, period_s: float) -> np.ndarray:
    """Return the effect of a command at these frequencies: delayed by a sample, and held for one."""
    return np.exp(-1j * omega * period_s) * -np.expm1(-1j * omega * period_s) / (1j * omega * period_s)


def peaks_Hz(problem: _Problem, G: np.ndarray, modes: int, known: np.ndarray | None = None) -> np.ndarray:
    """Return frequencies of the most prominent peaks, at most `modes`, rising.

    They are peaks of the inertial channels' largest singular value over noise. Within the half-power width of `known` poles no peak is
    looked for: what remains there is their own misfit.

    Raises
    ------
    BadAnswerError
        There is none.
    """
    block = G[:, 2 * problem.axes :] / problem.noise[2 * problem.axes :][:, None]  # a channel with only noise must not count
    height = np.log(np.maximum(np.linalg.svd(block, compute_uv=False)[:, 0], 1e-12))
    if known is not None:
        height = np.convolve(np.pad(height, 2, mode="edge"), np.full(5, 0.2), mode="valid")
        for stiffness, damping in zip(known[0::2], known[1::2], strict=True):
            if stiffness > 0.0:
                center = np.sqrt(stiffness) / (2.0 * np.pi)
                height[np.abs(problem.f - center) < max(2.0 * damping / (2.0 * np.pi), 0.15 * center)] = height.min()
    found, details = signal.find_peaks(height, prominence=PEAK_PROMINENCE)
    if not len(found):
        raise BadAnswerError(
            f"no further resonance stands out at {np.degrees(problem.pose).round(1).tolist()} deg: ask for fewer modes or measure longer"
        )
    best = found[np.argsort(details["prominences"])[::-1][:modes]]
    return np.sort(problem.f[best])


def _snapped(frequencies: np.ndarray, peaks: np.ndarray) -> np.ndarray:
    """Replace the frequency nearest to each peak, in octaves, by the peak; frequencies that no peak claims stay."""
    moved = frequencies.copy()
    away = np.full(len(frequencies), SNAP_OCTAVES)
    for peak in peaks:
        octaves = np.abs(np.log2(frequencies / peak))
        nearest = int(np.argmin(octaves))
        if octaves[nearest] < away[nearest]:
            moved[nearest], away[nearest] = peak, octaves[nearest]
    return moved


def _rank_one(residue: np.ndarray, sensors: tuple[InertialSensor, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Return shape (width,) and input (n,) whose product is nearest to a residue (width, n).

    The first body's twist has size 1.
    """
    n = residue.shape[1]
    weight = np.ones(len(residue))
    turns = np.arange(len(residue)) >= 2 * n
    turns[2 * n :] = np.tile([False] * 3 + [True] * 3, len(sensors))
    weight[turns] = TURN_LENGTH_m
    weight[: 2 * n] = TURN_LENGTH_m
    left, size, right = np.linalg.svd(residue * weight[:, None], full_matrices=False)
    shape, given = left[:, 0] / weight, size[0] * right[0]
    twist = shape[2 * n : 2 * n + 6] * weight[2 * n : 2 * n + 6]
    length = np.linalg.norm(twist)
    if twist[np.argmax(np.abs(twist))] < 0.0:
        length = -length
    return shape / length, given * length


def _held_step(stiffness: complex, damping: float, duration: float) -> tuple[float, ...]:
    """Step like `controllers.observers.modal_equations.mode_step`, for any stiffness: also overdamped and unstable pairs."""
    half = 0.5 * damping
    root = np.sqrt(complex(stiffness - half * half))
    if abs(root) < 1e-6:
        root = complex(1e-6)
    e, c, s = np.exp(-half * duration), np.cos(root * duration), np.sin(root * duration) / root
    p11, p12, p22 = (e * (c + half * s)).real, (e * s).real, (e * (c - half * s)).real
    g1 = (1.0 - p11) / stiffness if abs(stiffness) * duration**2 > 1e-6 else 0.5 * duration**2 * (1.0 - half * duration / 1.5)
    return p11, p12, -stiffness * p12, p22, g1, p12


def _skew(v: np.ndarray) -> np.ndarray:
    """Return the matrix of the cross product, v x."""
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])
