"""Columns: what one more unit of an effect or of a number changes, in efforts on the joints and in readings."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hil.diagnosis.residuals.trajectory import Signals
from hil.diagnosis.residuals.whitening import Whitening

ROWS = 256
"""Filtered at once: a block of some hundred columns fits the processor's cache."""


@dataclass(frozen=True, eq=False)
class Column:
    """What a hypothesis changes of one recording, where it changes anything.

    Attributes
    ----------
    efforts : mapping of int to pair of (N,) arrays
        By joint: effort that the nominal machine would lack, at each row and just before the next.
    readings : mapping of int to (N,) array
        By channel.
    """

    efforts: dict[int, tuple[np.ndarray, np.ndarray]]
    readings: dict[int, np.ndarray]

    @property
    def size(self) -> float:
        """Rms over rows of all that it changes, each in its own unit."""
        parts = [at for at, _ in self.efforts.values()] + list(self.readings.values())
        return math.sqrt(sum(float(np.mean(np.square(part, dtype=float))) for part in parts))


def column(without: Signals, with_it: Signals, scale: float = 1.0) -> Column:
    """Return the difference of two machines along the same motion, over `scale`."""
    needed = (with_it.needed - without.needed) / scale
    given = (without.given - with_it.given) / scale
    efforts = {}
    for joint in np.flatnonzero((needed != 0.0).any(axis=0) | (given != 0.0).any(axis=0)):
        ends = np.append(needed[1:, joint], needed[-1, joint])
        start, end = needed[:, joint] + given[:, joint], ends + given[:, joint]
        efforts[int(joint)] = (start.astype(np.float32), end.astype(np.float32))
    both = np.hstack([with_it.readings - without.readings, with_it.currents - without.currents]) / scale
    readings = {int(c): both[:, c].astype(np.float32) for c in np.flatnonzero((both != 0.0).any(axis=0))}
    return Column(efforts, readings)


class Filtered:
    """Columns on their way through a recording's filter, block by block."""

    def __init__(self, filtered: Whitening, columns: Sequence[Column], joints: int, channels: int) -> None:
        self._filtered, self._columns = filtered, columns
        self._joints, self._channels = joints, channels
        self._state = np.zeros((filtered.linearised.transition.shape[1], len(columns)))

    def whole(self, rows: int) -> np.ndarray:
        """Return the whitened rows (N m, C)."""
        count = len(self._columns)
        out = np.zeros((rows * self._channels, count))
        for begin in range(0, rows, ROWS):
            end = min(begin + ROWS, rows)
            efforts, ends = np.zeros((2, end - begin, self._joints, count))
            readings = np.zeros((end - begin, self._channels, count))
            for c, one in enumerate(self._columns):
                for joint, (at, until) in one.efforts.items():
                    efforts[:, joint, c], ends[:, joint, c] = at[begin:end], until[begin:end]
                for channel, values in one.readings.items():
                    readings[:, channel, c] = values[begin:end]
            part = out[begin * self._channels : end * self._channels]
            self._filtered.columns(efforts, ends, readings, begin, self._state, part)
        return self._filtered.coloured(out)
