"""The data of an initial guess: the mismatch at one place over one recording, and least squares on it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

HIGHEST_ORDER = 200
"""Cycles per turn up to which an order is searched: a motor of 36 slots and 48 poles has 144."""


@dataclass(frozen=True)
class Residual:
    """Mismatch between recording and simulation at one place, N rows.

    `effort` is the effort the simulation lacks at the joint: positive where the machine is pushed towards positive position more than the
    simulation is. `measured` and `simulated` are the channel itself, for effects of drives and sensors; for an IMU (N, 6).
    """

    time_s: np.ndarray
    position: np.ndarray  # [rad or m] at the joint
    speed: np.ndarray
    acceleration: np.ndarray
    effort: np.ndarray  # [Nm or N]
    current: np.ndarray  # commanded, in the drive's unit
    measured: np.ndarray
    simulated: np.ndarray
    drive_effort: np.ndarray  # of the drive on the joint [Nm or N]
    other_position: np.ndarray  # of the joint behind or the next axis
    other_speed: np.ndarray
    other_acceleration: np.ndarray
    ratio: float = 1.0
    stiffness: float = 0.0  # of the sprung joint there

    @property
    def difference(self) -> np.ndarray:
        """Measured less simulated."""
        difference: np.ndarray = self.measured - self.simulated
        return difference

    @property
    def moves(self) -> np.ndarray:
        """Rows in which the joint certainly moves: faster than a twentieth of its top speed."""
        moves: np.ndarray = np.abs(self.speed) > 0.05 * np.abs(self.speed).max(initial=0.0)
        return moves


def joined(parts: Sequence[Residual]) -> Residual:
    """Return several residuals one after the other as one.

    Ratio and stiffness are those of the first.
    """
    if len(parts) == 1:
        return parts[0]
    names = [field.name for field in fields(Residual) if isinstance(getattr(parts[0], field.name), np.ndarray)]
    whole: dict[str, Any] = {name: np.concatenate([getattr(part, name) for part in parts]) for name in names}
    return replace(parts[0], **whole)


def fitted(columns: list[np.ndarray], values: np.ndarray) -> np.ndarray:
    """Return the least-squares weights of the columns; 0 for columns that the data do not excite."""
    weights: np.ndarray = np.linalg.lstsq(np.column_stack(columns), values, rcond=1e-10)[0]
    return weights


def harmonics(phase: np.ndarray, values: np.ndarray, orders: tuple[int, ...] = (1, 2)) -> list[tuple[float, float]]:
    """Return amplitude and phase of A cos(k phase + p) for each order k, fitted beside a constant."""
    columns = [np.ones_like(phase)]
    for order in orders:
        columns += [np.cos(order * phase), np.sin(order * phase)]
    weights = fitted(columns, values)[1:]
    return [(float(np.hypot(c, s)), float(np.arctan2(-s, c))) for c, s in zip(weights[::2], weights[1::2], strict=True)]


def strongest_order(angle: np.ndarray, values: np.ndarray, highest: int = HIGHEST_ORDER) -> int:
    """Return the whole number of cycles per turn that explains most of the values."""
    centred = values - values.mean()
    power = [abs(np.sum(centred * np.exp(-1j * order * angle))) for order in range(1, highest + 1)]
    return 1 + int(np.argmax(power))


def strongest_frequency_Hz(time_s: np.ndarray, values: np.ndarray) -> float:
    """Return the frequency at which the values' spectrum peaks, at least one cycle in the record."""
    spectrum = np.abs(np.fft.rfft((values - values.mean()) * np.hanning(len(values))))
    frequencies = np.fft.rfftfreq(len(values), time_s[1] - time_s[0])
    return float(frequencies[1 + int(np.argmax(spectrum[1:]))])


def lag_of(measured: np.ndarray, simulated: np.ndarray, sample_s: float) -> float:
    """Return the delay [s] of a channel behind its simulation.

    It is the slope of their difference on the simulation's rate of change.
    """
    rate = np.gradient(simulated, sample_s)
    return float(-fitted([rate], measured - simulated)[0])
