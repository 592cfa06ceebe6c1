"""The observer's noise covariances: from sensor records, the machine file's quantisation, and the responses' covariances."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from controllers.models.modal import ModalModel
from controllers.observers.settings import ObserverNoise
from hil.identification import FrequencyResponse
from hil.identification.result import CovarianceKind
from hil.machine import Machine
from hil.recording import Recording

LATTICE = 1.0 / np.sqrt(12.0)
"""Standard deviation of rounding, in steps."""

ACCELEROMETER_WALK = 1e-5
"""m/s^2 per sqrt(s): a bias that strays 0.1 mg in ten thousand seconds, as good MEMS sensors do."""

GYRO_WALK = 1e-6
"""rad/s per sqrt(s), likewise."""

ROUNDING_STANDS_s = 1.0
"""At standstill an encoder's rounding is a constant and not noise; after a move it is another. A rest and a move take at least this
long."""

BIAS_STRAY = np.array([5e-4] * 3 + [5e-5] * 3)
"""How far biases stray between the standing records and a run, by temperature above all: 0.05 mg, 10 deg/h (m/s^2, rad/s)."""

UNKNOWN_BIAS = np.array([0.05] * 3 + [0.005] * 3)
"""Deviation of biases that have not been measured."""

START_TIME_s = 0.1
"""Correlation time of disturbances at the start of the tuning."""

SLOWEST_Hz = 1.0
"""Frequency around which disturbances fade that are not the drives' own: below it the responses are not identified either, and the
disturbances are gravity and friction, which have terms of their own. Without this limit, every lasting tilt could be a bias or a push."""

START_SHARE = 0.05
"""Disturbances at the start of the tuning, as a share of what the drives could do."""


def encoder_steps(model: ModalModel, machine: Machine) -> np.ndarray:
    """Return the size of one count of motor sides, then link sides (2 n_axes,); 0 where there is no quantisation."""
    steps = {encoder.channel: encoder.resolution for encoder in machine.plant.encoders}
    return np.array([steps.get(name, 0.0) for name in model.channels()[: 2 * len(model.axes)]])


def measurement_noise(model: ModalModel, machine: Machine, records: Sequence[Recording]) -> np.ndarray:
    """Return standard deviations (measurements,) of white noise from recordings at rest, at least a sensor's quantisation.

    Third differences remove whatever moves slowly against the sample rate; of white noise they have twenty times its variance.
    """
    channels = model.channels()
    steps = encoder_steps(model, machine)
    variances = np.zeros((len(records), len(channels)))
    for row, record in zip(variances, records, strict=True):
        rough = np.diff(record.matrix(channels), n=3, axis=0)
        row[:] = np.nanmean(rough**2, axis=0) / 20.0
    lattice = np.concatenate((steps * LATTICE, np.zeros(len(channels) - len(steps))))
    smallest = np.where(np.arange(len(channels)) < 2 * len(model.axes), 1e-9, 1e-7)
    deviation: np.ndarray = np.maximum(np.sqrt(np.min(variances, axis=0)) if len(records) else 0.0, np.maximum(lattice, smallest))
    return deviation


def command_noise(machine: Machine, responses: Sequence[FrequencyResponse], records: Sequence[Recording]) -> np.ndarray:
    """Return standard deviations (n_axes,) of what acts beside the command.

    These are its rounding, and the responses' uncertainty times what was sent.
    """
    rounding = np.array([drive.resolution * LATTICE for drive in machine.plant.drives])
    if not responses or not records:
        deviation: np.ndarray = np.maximum(rounding, 1e-6)
        return deviation
    sent = np.mean([[np.nanstd(np.diff(record[f"command_{axis}"])) for axis in machine.axes] for record in records], axis=0)
    shares = []
    for response in responses:
        kind: CovarianceKind = "noise" if response.total_covariance is None else "total"
        deviation = response.standard_deviation(kind)
        trusted = np.array([np.argmax(np.abs(response.G[:, :, u]).sum(axis=0)) for u in range(response.G.shape[2])])
        shares.append([np.median(deviation[:, j, u] / np.abs(response.G[:, j, u])) for u, j in enumerate(trusted)])
    combined: np.ndarray = np.sqrt(rounding**2 + (np.median(shares, axis=0) * sent) ** 2)
    return combined


def starting_noise(
    model: ModalModel,
    machine: Machine,
    responses: Sequence[FrequencyResponse],
    records: Sequence[Recording],
    biases: tuple[np.ndarray, np.ndarray] | None,
) -> ObserverNoise:
    """Return the noise before tuning: measured where possible, disturbances as a share of the drives' strength.

    A motor side's counter was set to the link encoder when it was homed, with both at rest: that offset, and its rounding error at rest,
    are states. `biases` are the inertial sensors' and their deviations (6 sensors,), from standing records; None: not known.
    """
    n, sensors = len(model.axes), len(model.sensors)
    strength = np.full(model.disturbances, float(np.max(model.effort_limit * effort_gain(machine))))
    strength[:n] = model.effort_limit
    steps = encoder_steps(model, machine)
    known, deviation = biases if biases else (np.zeros(6 * sensors), np.tile(UNKNOWN_BIAS, sensors))
    return ObserverNoise(
        command=command_noise(machine, responses, records),
        disturbance=START_SHARE * strength,
        disturbance_time_s=np.full(model.disturbances, START_TIME_s),
        disturbance_Hz=np.concatenate((np.zeros(n), np.full(model.disturbances - n, SLOWEST_Hz))),
        bias_walk=np.tile(np.repeat([ACCELEROMETER_WALK, GYRO_WALK], 3), sensors),
        measurement=measurement_noise(model, machine, records),
        initial_bias=np.hypot(deviation, np.tile(BIAS_STRAY, sensors)),
        bias=known,
        offset_walk=LATTICE * steps[:n] / np.sqrt(ROUNDING_STANDS_s),
        initial_offset=LATTICE * np.sqrt(2.0 * steps[:n] ** 2 + steps[n:] ** 2),
    )


def stated_noise(model: ModalModel, machine: Machine) -> ObserverNoise:
    """Return the noise before tuning of the sensors that the file states, their biases known as a standing machine shows them."""
    imus = {f"{imu.name}_x": imu for imu in machine.plant.imus}
    bias, deviation = [], []
    for sensor in model.sensors:
        imu = imus[sensor.channels[0]]
        bias += [imu.accelerometer_bias_m_s2, imu.gyro_bias_rad_s]
        deviation += [np.hypot(imu.accelerometer_noise_rms_m_s2, LATTICE * imu.accelerometer_resolution_m_s2)]
        deviation += [np.hypot(imu.gyro_noise_rms_rad_s, LATTICE * imu.gyro_resolution_rad_s)]
    noise = starting_noise(model, machine, (), (), (np.concatenate(bias), np.zeros(6 * len(model.sensors))))
    n = 2 * len(model.axes)
    return replace(noise, measurement=np.maximum(noise.measurement, np.concatenate((np.zeros(n), *deviation))))


def effort_gain(machine: Machine) -> np.ndarray:
    """Return force or torque on each driven joint per unit of its drive (n_axes,)."""
    return np.array([drive.constant * drive.ratio for drive in machine.plant.drives])
