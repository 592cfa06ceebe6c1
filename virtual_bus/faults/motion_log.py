"""The truth of a run with faults: what moved and what held it, sample by sample, with SYNCs or without."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from virtual_bus.canopen.power_state import PowerState

HOLDING = (PowerState.OPERATION_ENABLED, PowerState.QUICK_STOP_ACTIVE, PowerState.FAULT_REACTION_ACTIVE)
"""States of a drive in which its power stage may hold an axis."""


@dataclass
class MotionLog:
    """Rows of the emulated machine's true motion, one per sample of its time.

    Parameters
    ----------
    axes : tuple of str
        Order of the columns.
    """

    axes: tuple[str, ...]
    _time: list[float] = field(default_factory=list)
    _position: list[list[float]] = field(default_factory=list)
    _speed: list[list[float]] = field(default_factory=list)
    _effort: list[list[float]] = field(default_factory=list)
    _brake: list[list[float]] = field(default_factory=list)
    _drive: list[list[int]] = field(default_factory=list)

    def add(
        self, time_s: float, position: list[float], speed: list[float], effort: list[float], brake: list[float], drive: list[int]
    ) -> None:
        """Add the row of one instant, each value a list in axis order."""
        self._time.append(time_s)
        self._position.append(position)
        self._speed.append(speed)
        self._effort.append(effort)
        self._brake.append(brake)
        self._drive.append(drive)

    def __len__(self) -> int:
        """Return the number of rows."""
        return len(self._time)

    @property
    def time_s(self) -> np.ndarray:
        """Machine time (N,) [s]."""
        return np.array(self._time)

    @property
    def position(self) -> np.ndarray:
        """True positions of the axes' joints (N, axes) [rad or m]."""
        return np.array(self._position).reshape(-1, len(self.axes))

    @property
    def speed(self) -> np.ndarray:
        """True speeds of the axes' joints (N, axes) [rad/s or m/s]."""
        return np.array(self._speed).reshape(-1, len(self.axes))

    @property
    def effort(self) -> np.ndarray:
        """Effort that the power stages apply (N, axes) [drive's unit]."""
        return np.array(self._effort).reshape(-1, len(self.axes))

    @property
    def brake(self) -> np.ndarray:
        """Share of its effort that each brake applies (N, axes): 1 closed, 0 open or none."""
        return np.array(self._brake).reshape(-1, len(self.axes))

    @property
    def drive(self) -> np.ndarray:
        """State of each axis's drive (N, axes), as `PowerState`."""
        return np.array(self._drive, dtype=np.int64).reshape(-1, len(self.axes))
