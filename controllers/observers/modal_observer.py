"""The observer of Chapter 5 as the sample loop runs it: one `step` per sample, the estimate in a preallocated array."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np
from scipy.linalg import expm

from controllers.bound import bound
from controllers.errors import DesignError
from controllers.models.modal import ModalModel, basis_at
from controllers.observers.consistency import CorrectionMonitor, InnovationMonitor, WINDOWS_s
from controllers.observers.extended_kalman import linearised
from controllers.observers.filter_step import filter_rows
from controllers.observers.memory import EXTENDED, KALMAN, UNSCENTED, Memory
from controllers.observers.modal_equations import GAINS, MODE_SIGNALS, SENSOR_SIGNALS, Constants, Scheduled
from controllers.observers.publish import GEOMETRY, QUANTITIES, TWIST, estimate_channels, of_quantities, publish
from controllers.observers.settings import ObserverNoise

FilterKind = Literal["kf", "ekf", "ukf"]
GAIN_NAMES = ("turn_x", "turn_y", "turn_z", "scale_x", "scale_y", "scale_z", "scale_gyro")
KINDS: dict[str, int] = {"kf": KALMAN, "ekf": EXTENDED, "ukf": UNSCENTED}

START_SPEED = 1e-3
"""Standard deviation [rad/s or m/s] of an axis's speed at the start, small because a recording starts at standstill."""


class ModalObserver:
    """A Kalman filter on a modal model.

    Parameters
    ----------
    model : ModalModel
    noise : ObserverNoise
    kind : "kf", "ekf" or "ukf"
    adapted : sequence of int
        Modes whose frequency is a state.
    isocenter_m : (3,) array

    Attributes
    ----------
    channels : list of (name, unit)
        Channels of `estimate`, in order.
    estimate : (channels,) array
        Result of the last `step`; NaN before the first one.
    innovation : (measurements,) array
        z - ẑ of the last step; NaN where nothing was measured.
    constants, memory
        Data of the compiled functions, for the modules of this package.

    Raises
    ------
    DesignError
        The noise does not fit the model, or an adapted mode does not exist.
    """

    def __init__(
        self,
        model: ModalModel,
        noise: ObserverNoise,
        kind: FilterKind = "ukf",
        adapted: Sequence[int] = (),
        isocenter_m: np.ndarray | None = None,
    ) -> None:
        if kind not in KINDS:
            raise DesignError(f"observer {kind!r}: must be one of {', '.join(KINDS)}")
        self.model, self.noise, self.kind, self.adapted = model, noise, kind, tuple(adapted)
        self._kind = KINDS[kind]
        self._isocenter = np.zeros(3) if isocenter_m is None else np.asarray(isocenter_m, float)
        self.constants = _constants(model, noise, self.adapted)
        self._scheduled, self.memory = _memory(self.constants)
        usual = None if self.adapted else noise.usual
        self._innovations, self._corrections = InnovationMonitor(), CorrectionMonitor(usual=usual, rate_Hz=model.sample_rate_Hz)
        self._bound = bound((self.constants, self._scheduled, self.memory, self._innovations.recent, self._corrections.recent))
        n = len(model.axes)
        self.channels = estimate_channels(model.axes, model.position_unit)
        self.estimate = np.full(len(self.channels), np.nan)
        self._measured = np.full(self.constants.sizes[5], np.nan)
        self._summary = np.zeros((1, 3))
        self._held = np.zeros(n)  # the command that acts until the next sample
        self._acting, self._row = self._held[None], self._measured[None]  # the same as recordings of one row
        self._start = self._initial_factor()
        self.restart()

    @property
    def innovation(self) -> np.ndarray:
        """Innovation z - ẑ (measurements,) of the last step; NaN where nothing was measured."""
        return self.memory.innovation

    @property
    def has_lasting_alarm(self) -> bool:
        """Whether the alarm of the last step has been raised for longer than a passing push raises it."""
        return self._corrections.is_lasting

    @property
    def state(self) -> np.ndarray:
        """Estimate (states,) of the state, see `state_names`."""
        return self.memory.x

    @property
    def scheduled(self) -> Scheduled:
        """Model at the pose estimated in the row before the last; on the first row at the pose of that row."""
        return self._scheduled

    @property
    def covariance(self) -> np.ndarray:
        """Covariance (states, states) of the state's error."""
        covariance: np.ndarray = self.memory.factor.T @ self.memory.factor
        return covariance

    @property
    def state_names(self) -> list[str]:
        """Name of each state."""
        model = self.model
        modes = [f"mode_{i + 1}" for i in range(model.modes)]
        names = [f"position_{axis}" for axis in model.axes] + [f"speed_{axis}" for axis in model.axes]
        names += modes + [f"{mode}_speed" for mode in modes]
        if model.directions is None:
            names += [f"disturbance_{axis}" for axis in model.axes] + [f"disturbance_{mode}" for mode in modes]
        else:
            names += [f"disturbance_{i + 1}" for i in range(model.disturbances)]
        names += [f"{names[2 * (len(model.axes) + model.modes) + j]}_quadrature" for j in in_band(self.noise)]
        names += [f"log_frequency_ratio_{modes[i]}" for i in self.adapted]
        if len(self.noise.offset_walk):
            names += [f"offset_motor_{axis}" for axis in model.axes]
        if len(self.noise.offset_walk) > len(model.axes):
            names += [f"offset_detector_{name}" for name in TWIST]
        if len(self.noise.offset_walk) > len(model.axes) + 6:
            names += [f"offset_link_{axis}" for axis in model.axes]
        if len(self.noise.initial_gain):
            names += [f"{gain}_{sensor.channels[0]}" for sensor in model.sensors for gain in GAIN_NAMES]
        return names + [f"bias_{channel}" for sensor in model.sensors for channel in sensor.channels]

    def restart(self) -> None:
        """Forget everything, so that the next step is a first one."""
        self.memory.x[:] = 0.0
        self.memory.x[len(self.memory.x) - len(self.noise.bias) :] = self.noise.bias
        self.memory.factor[:] = self._start
        self.memory.innovation[:] = self.memory.whitened[:] = np.nan
        self._is_first = True
        self._has_command = False
        self._innovations.reset()
        self._corrections.reset()
        self.estimate[:] = np.nan

    def step(self, position: np.ndarray, link_position: np.ndarray, imu: np.ndarray, command: np.ndarray) -> None:
        """Take one sample, before the feedback makes its command of this row.

        Parameters
        ----------
        position, link_position : (n_axes,) arrays
            As measured; NaN for what is missing.
        imu : (6 sensors or fewer,) array
            As measured; NaN for what is missing.
        command : (n_axes,) array
            The previous row's command, which is on the wire and acts from this sample to the next. It is ignored on the first row.
        """
        n, z = len(self.model.axes), self._measured
        z[:n] = position
        z[n : 2 * n] = link_position
        z[2 * n :] = np.nan
        z[2 * n : 2 * n + len(imu)] = imu
        self.step_measured(z, command)

    def step_measured(self, z: np.ndarray, command: np.ndarray) -> None:
        """Take one sample like `step`, with all measurements in one array (measurements,) in the order of `model.channels()`."""
        self._measured[:] = z
        if self._is_first:
            self._stand_at(z)
            self._held[:] = 0.0
        elif not self._has_command:  # the command before row 0 is not recorded; at standstill it equals that of row 0
            self._held[:] = command
            self._has_command = True
        filter_rows(self._bound, self._kind, self._is_first, self._acting, self._row, self._summary)
        publish(self._bound, self._summary, self._isocenter, self.estimate)
        if not self._is_first:
            self._held[:] = command
        self._is_first = False

    def skip(self, samples: int, command: np.ndarray) -> None:
        """Pass over samples without a SYNC: nothing was measured, and the command of the last sample went on acting.

        Call it before the next step, which will be given `command` (n_axes,).
        """
        if not self._has_command:
            self._held[:] = command
            self._has_command = True
        nothing, held = np.full(len(self._measured), np.nan), self._held.copy()
        for _ in range(samples):
            self.step_measured(nothing, held)

    def likelihood(self, measured: np.ndarray, commands: np.ndarray) -> tuple[float, np.ndarray]:
        """Return minus the log likelihood of N rows (N, measurements), (N, n_axes) from a restart, and NIS with degrees of freedom (N, 2).

        Leaves the observer restarted.
        """
        self.restart()
        self._stand_at(measured[0])
        summaries = np.zeros((len(measured), 3))
        acted = np.zeros(commands.shape)  # unknown until row 0
        acted[1:] = commands[np.maximum(np.arange(1, len(commands)) - 2, 0)]  # command k-2 from row k-1 to k; before row 0 that of row 0
        filter_rows(self._bound, self._kind, True, acted, measured, summaries)
        self.restart()
        return 0.5 * float(summaries[:, 0].sum() + summaries[:, 2].sum()), summaries[:, :2]

    def linearised(self, pose: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return transition matrix (states, states) and output rows (measurements, states) at rest in a pose (n_axes,)."""
        states, measurements = len(self.state), len(self._measured)
        x, F, H = np.zeros(states), np.zeros((states, states)), np.zeros((measurements, states))
        x[: len(pose)] = pose
        linearised(self.constants, self._scheduled, x, F, H)
        return F, H

    @property
    def initial_std(self) -> np.ndarray:
        """Standard deviation (states,) of the state before the first measurement."""
        std: np.ndarray = np.sqrt(np.sum(self._start**2, axis=0))
        return std

    def _stand_at(self, z: np.ndarray) -> None:
        n = len(self.model.axes)
        for i in range(n):
            for known in (z[n + i], z[i]):
                if known == known:
                    self.memory.x[i] = known

    def _initial_factor(self) -> np.ndarray:
        """Return the factor at standstill: near the encoders, deflected by forces no greater than those of the drives."""
        model, noise, n = self.model, self.noise, len(self.model.axes)
        values = model.at(np.zeros(n))
        table = values[: model.modes * model.mode_stride].reshape(model.modes, model.mode_stride)
        rigid = values[model.modes * model.mode_stride :][: n * n].reshape(n, n)
        modal = np.abs(table[:, -n:]) @ model.effort_limit
        if model.directions is not None:  # a mode that no drive moves is deflected by the disturbances
            pushed = model.directions[n:] @ basis_at(model.harmonics, np.zeros((1, n)))[0]
            modal = np.maximum(modal, table[:, 0] * (np.abs(pushed[:, n:]) @ noise.disturbance[n:]))
        deflection = modal / table[:, 0]
        push = np.concatenate((np.abs(rigid) @ model.effort_limit, modal)) if model.directions is None else noise.disturbance
        bend = np.abs(table[:, 2 : 2 + 2 * n]).reshape(model.modes, 2, n).max(axis=1).T @ deflection
        std = np.concatenate((
            np.maximum(bend, 1e-9), np.full(n, START_SPEED), deflection, deflection * np.sqrt(table[:, 0]) * 0.1, push,
            noise.disturbance[in_band(noise)], np.full(len(self.adapted), noise.initial_adapted), noise.initial_offset, noise.initial_gain,
            noise.initial_bias,
        ))  # fmt: skip
        factor, constants = np.diag(std), self.constants
        for j in in_band(noise):  # as in steady state: P = UᵀU with P₁₁ = σ², P₁₂, P₂₂ of `_steady`
            disturbance, quadrature = 2 * (n + model.modes) + j, int(constants.quadrature[j])
            factor[disturbance, disturbance] = noise.disturbance[j]
            factor[disturbance, quadrature] = noise.disturbance[j] * _steady(noise, j)[0, 1]
        return factor


def _constants(model: ModalModel, noise: ObserverNoise, adapted: tuple[int, ...]) -> Constants:
    n, modes, sensors = len(model.axes), model.modes, len(model.sensors)
    if not sensors:
        raise DesignError("observer: the model has no inertial sensor, and nothing else sees the detector")
    if any(not 0 <= mode < modes for mode in adapted):
        raise DesignError(f"observer: adapted modes {adapted}: the model has modes 0 to {modes - 1}")
    measurements = 2 * n + 6 * sensors
    period = 1.0 / model.sample_rate_Hz
    lengths = {
        "command": n, "disturbance": model.disturbances, "disturbance_time_s": model.disturbances, "bias_walk": 6 * sensors,
        "measurement": measurements, "initial_bias": 6 * sensors,
    }  # fmt: skip
    for name, length in lengths.items():
        values = np.asarray(getattr(noise, name), float)
        if values.shape != (length,) or np.isnan(values).any() or (values < 0.0).any():
            raise DesignError(f"observer noise: {name} must be {length} numbers, none negative, not {values}")
    if len(noise.offset_walk) not in (0, n, n + 6, 2 * n + 6) or len(noise.initial_offset) != len(noise.offset_walk):
        raise DesignError(f"observer noise: offset_walk and initial_offset must both be {n} numbers, {n + 6}, {2 * n + 6} or none")
    if len(noise.initial_gain) not in (0, GAINS * sensors) or not (np.asarray(noise.initial_gain) >= 0.0).all():
        raise DesignError(
            f"observer noise: initial_gain must be {GAINS * sensors} numbers or none, none negative, not {noise.initial_gain}"
        )
    if not (np.concatenate((noise.offset_walk, noise.initial_offset)) >= 0.0).all():
        raise DesignError("observer noise: offset_walk and initial_offset must not be negative")
    if len(noise.published) not in (0, len(QUANTITIES)) or not (np.asarray(noise.published) > 0.0).all():
        raise DesignError(f"observer noise: published must be {len(QUANTITIES)} numbers above zero or none, not {noise.published}")
    if np.size(noise.usual) and (np.shape(noise.usual) != (len(WINDOWS_s), measurements) or not (np.asarray(noise.usual) > 0.0).all()):
        raise DesignError(f"observer noise: usual must be {len(WINDOWS_s)} times {measurements} numbers above zero, or none")
    if len(noise.bias) not in (0, 6 * sensors) or not np.isfinite(noise.bias).all():
        raise DesignError(f"observer noise: bias must be {6 * sensors} numbers or none, not {noise.bias}")
    if not (np.asarray(noise.measurement) > 0.0).all():
        raise DesignError("observer noise: measurement must be above zero for every channel; an encoder has its step / sqrt(12)")
    band = in_band(noise)
    if (
        len(noise.disturbance_Hz) not in (0, model.disturbances)
        or not np.isfinite(noise.disturbance_Hz).all()
        or (noise.disturbance_Hz < 0.0).any()
    ):
        raise DesignError(f"observer noise: disturbance_Hz must be {model.disturbances} numbers or none, not {noise.disturbance_Hz}")
    if np.isinf(noise.disturbance_time_s[band]).any():
        raise DesignError("observer noise: disturbance_time_s must be finite where disturbance_Hz is above zero: a random walk has no band")
    if len(noise.low_pass) not in (0, model.disturbances) or not np.isin(np.flatnonzero(noise.low_pass), band).all():
        raise DesignError(
            f"observer noise: low_pass must be {model.disturbances} times yes or no, yes only where disturbance_Hz is above zero, or none"
        )
    colour, drive, beside = _colour(noise, period)
    root = np.sqrt(period)
    kept, offset_std = _bounded(noise, period)
    std = np.concatenate((
        noise.command, drive, beside[band], np.full(len(adapted), root * noise.adapted_walk), offset_std,
        np.zeros(len(noise.initial_gain)), root * noise.bias_walk,
    ))  # fmt: skip
    first_quadrature = 2 * (n + modes) + model.disturbances
    first_adapted = first_quadrature + len(band)
    quadrature = np.full(model.disturbances, -1, dtype=np.int64)
    quadrature[band] = first_quadrature + np.arange(len(band))
    states = first_adapted + len(adapted) + len(noise.offset_walk) + len(noise.initial_gain) + 6 * sensors
    chain = model.chain
    return Constants(
        sizes=np.array(
            [
                n,
                modes,
                sensors,
                len(adapted),
                states,
                measurements,
                len(std),
                model.disturbances,
                len(band),
                len(noise.offset_walk),
                _on_the_source(model),
                len(noise.initial_gain),
            ],
            dtype=np.int64,
        ),
        harmonics=np.array(model.harmonics, dtype=np.int64),
        coefficients=np.ascontiguousarray(model.all_rows().T, dtype=float),
        adapted=np.array(adapted, dtype=np.int64),
        axes=np.ascontiguousarray(chain.axes, dtype=float),
        points=np.ascontiguousarray(chain.points, dtype=float),
        revolute=np.ascontiguousarray(chain.revolute, dtype=bool),
        sensors=np.array([np.concatenate((s.body_end_m, s.sensor_end_m, np.ravel(s.rotation), [s.lag_s])) for s in model.sensors]),
        source_and_gravity=np.array([model.source_end_m, chain.gravity_m_s2], dtype=float),
        period_s=period,
        effort_step=np.array(model.effort_step, dtype=float) if len(model.effort_step) else np.zeros(n),
        colour=colour,
        quadrature=quadrature,
        kept=np.concatenate((np.ones(len(adapted)), kept, np.ones(len(noise.initial_gain) + 6 * sensors))),
        noise_std=std,
        measurement_std=np.array(noise.measurement, dtype=float),
        published=(np.array(noise.published, dtype=float)[of_quantities(n)] if len(noise.published) else np.ones(2 * n + 21)) ** 2,
    )


def _on_the_source(model: ModalModel) -> int:
    """Return the number of the sensor whose body carries the focal spot; -1 without one. The first is the detector's."""
    return next((s for s, sensor in enumerate(model.sensors) if s and np.allclose(sensor.body_end_m, model.source_end_m)), -1)


def in_band(noise: ObserverNoise) -> np.ndarray:
    """Return which disturbances have two states: those in a band and the low passes of second order."""
    return np.flatnonzero(noise.disturbance_Hz)


def _is_low_pass(noise: ObserverNoise, j: int) -> bool:
    return bool(len(noise.low_pass) and noise.low_pass[j])


def _steady(noise: ObserverNoise, j: int) -> np.ndarray:
    """Return the steady-state covariance (2, 2) of a disturbance and its quadrature over the disturbance's variance; its determinant is 1.

    A low pass is driven at its quadrature: P₁₂ = -2/(ωτ), P₂₂ = 1 + P₁₂².
    """
    if not _is_low_pass(noise, j):
        return np.eye(2)
    slope = -2.0 / (2.0 * np.pi * noise.disturbance_Hz[j] * max(noise.disturbance_time_s[j], 1e-9))
    return np.array([[1.0, slope], [slope, 1.0 + slope**2]])


def _colour(noise: ObserverNoise, period: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return of every disturbance `Constants.colour` (5,), the noise that drives it, and the further noise of its quadrature.

    First order: ξ' = -ξ/τ. With a frequency: ξ' = -2ξ/τ - ωκ, κ' = ωξ, and Q = P - ΦPΦᵀ with P of the steady state. In a band white noise
    drives ξ; a low pass is driven at κ.
    """
    count = len(noise.disturbance)
    colour, drive, beside = np.zeros((count, 5)), np.zeros(count), np.zeros(count)
    for j, (size, time) in enumerate(zip(noise.disturbance, np.maximum(noise.disturbance_time_s, 1e-9), strict=True)):
        if j not in in_band(noise):
            colour[j, 0] = np.exp(-period / time)
            drive[j] = size * (np.sqrt(period) if np.isinf(time) else np.sqrt(1.0 - colour[j, 0] ** 2))
            continue
        omega = 2.0 * np.pi * noise.disturbance_Hz[j]
        step = expm(period * np.array([[-2.0 / time, -omega], [omega, 0.0]]))
        steady = _steady(noise, j)
        spread = steady - step @ steady @ step.T
        if not spread[0, 0] > 0.0:
            raise DesignError(
                f"observer noise: disturbance {j + 1}, disturbance_Hz = {noise.disturbance_Hz[j]:g}, disturbance_time_s = {time:g}:"
                f" does not change within a sample of {period:g} s; 0 Hz makes it one of first order"
            )
        drive[j] = size * np.sqrt(spread[0, 0])
        colour[j, :4], colour[j, 4] = step.ravel(), size * spread[0, 1] / np.sqrt(spread[0, 0])
        beside[j] = size * np.sqrt(max(spread[1, 1] - spread[0, 1] ** 2 / spread[0, 0], 0.0))
    return colour, drive, beside


def _bounded(noise: ObserverNoise, period: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the share (offsets,) that a sample leaves of the offsets, processes of first order, and the deviation (offsets,) it adds."""
    walk, deviation = np.asarray(noise.offset_walk, float), np.asarray(noise.initial_offset, float)
    rate = np.divide(walk**2, 2.0 * deviation**2, out=np.zeros_like(walk), where=deviation > 0.0)
    return np.exp(-rate * period), deviation * np.sqrt(-np.expm1(-2.0 * rate * period))


def _memory(constants: Constants) -> tuple[Scheduled, Memory]:
    n, modes, sensors, adapted, states, measurements, sources, disturbances, bands, *_ = (int(size) for size in constants.sizes)
    moving = 2 * (n + modes) + disturbances + bands
    rows, signals = moving + n + 1, 2 * n + sensors * (3 * n + SENSOR_SIGNALS) + MODE_SIGNALS * adapted
    scheduled = Scheduled(
        values=np.zeros(constants.coefficients.shape[1]),
        modes=np.zeros((modes, 8)),
        encoders=np.zeros((modes, 3 * n)),
        rigid=np.zeros((n, n + 1)),
        directions=np.zeros((n + modes, disturbances)),
        pushes=np.zeros(n + modes),
        speeds=np.zeros(n),
        command=np.zeros(n),
        rubbing=np.zeros((n + modes, n + modes)),
        forces=np.zeros((rows, n + modes)),
        shapes=np.zeros((sensors, modes, 6)),
        rates=np.zeros(modes * (2 + 3 * n + 6 * sensors)),
        looks=np.zeros((sensors, 3 * modes, SENSOR_SIGNALS)),
        steps=np.zeros((rows, moving + MODE_SIGNALS * adapted)),
        sees=np.zeros((rows, signals)),
    )
    memory = Memory(
        x=np.zeros(states),
        factor=np.zeros((states, states)),
        innovation=np.full(measurements, np.nan),
        whitened=np.full(measurements, np.nan),
        correction=np.zeros((1 + measurements, states)),
        corrected=np.zeros((2, GEOMETRY)),
        bends=np.zeros((states, 2 * adapted)),
        seen=np.zeros((2 * states, measurements)),
        array=np.zeros((2 * states + measurements + sources, measurements + states)),
        lines=np.zeros((6, max(states, measurements, signals, moving + MODE_SIGNALS * adapted))),
    )
    return scheduled, memory
