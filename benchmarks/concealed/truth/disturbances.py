"""What differs from repeat to repeat: process disturbances of several colours, and the sensors' noise."""

from __future__ import annotations

import numpy as np
import scipy.signal

from concealed.truth.plant import IMU_CHANNELS, Machine

COLOURS = ("white", "slow", "narrow", "reversal")


def disturbance(rng: np.random.Generator, machine: Machine, samples: int, colour: str, level: float) -> tuple[np.ndarray, float]:
    """Efforts on the axes (N, n_axes), rms `level` times a tenth of the drive's effort; the speed under which they act (0: always)."""
    rate = machine.rate_Hz
    efforts = np.zeros((samples, len(machine.axes)))
    calm = 0.0
    for i, axis in enumerate(machine.axes):
        white = rng.normal(size=samples + 4000)
        if colour == "white":
            b, a = scipy.signal.butter(1, 30.0, fs=rate)
        elif colour == "slow":  # first-order about 0.1 Hz over a little white: close to 1/f where the loop works
            b, a = scipy.signal.butter(1, 0.1, fs=rate)
        elif colour == "narrow":
            centre = float(rng.uniform(3.0, 20.0))
            b, a = scipy.signal.butter(1, [0.96 * centre, 1.04 * centre], btype="bandpass", fs=rate)
        else:
            b, a = scipy.signal.butter(1, 10.0, fs=rate)
            calm = 0.05 * machine.reach(axis)
        shaped = scipy.signal.lfilter(b, a, white)[4000:]
        typical = float(np.std(scipy.signal.lfilter(b, a, rng.normal(size=60000))[4000:]))
        signal = shaped / typical + (0.1 * white[4000:] if colour == "slow" else 0.0)
        efforts[:, i] = level * machine.effort_scale(axis) * signal
    return efforts, calm


def with_noise(rng: np.random.Generator, machine: Machine, channels: dict[str, np.ndarray], factor: float) -> dict[str, np.ndarray]:
    """Readings with the sensors' noise (the machine file's times `factor`) on their lattices."""
    noisy = {}
    for name, values in channels.items():
        if name.startswith("position"):
            noisy[name] = values  # on its lattice in the loop already
            continue
        if name.startswith("link_position"):
            rms, lattice = 0.0, float(machine.link_counts[machine.axes.index(name.removeprefix("link_position_"))])
        else:
            rms, lattice = machine.noise(name)
        readings = values + factor * rms * rng.normal(size=len(values))
        if name in IMU_CHANNELS:
            readings = readings + _bias(machine, name)
        noisy[name] = lattice * np.floor(readings / lattice + 0.5) if lattice else readings
    return noisy


def _bias(machine: Machine, name: str) -> float:
    key = "accelerometer_bias_m_s2" if name.startswith("imu") else "gyro_bias_rad_s"
    return float(machine.imu.get(key, [0.0, 0.0, 0.0])["xyz".index(name[-1])])
