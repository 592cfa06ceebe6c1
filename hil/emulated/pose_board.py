"""Poses of tube and panel at every SYNC in shared memory, from the emulated machine to its panel, which is another process.

The machine writes and never waits; an entry is complete before it is counted, and reused only thousands of SYNCs later.
"""

from __future__ import annotations

from dataclasses import dataclass
from multiprocessing.context import BaseContext

import numpy as np

KEPT = 8192
"""SYNCs kept: 32 s at 256 Hz, for a panel whose images take longer to make than its exposures are apart."""

SPARE = 64
"""Number of oldest entries that are not read, because they may be overwritten meanwhile."""

_WIDTH = 26
_SYNC, _TIME, _TUBE, _PANEL = 0, 1, slice(2, 14), slice(14, 26)


@dataclass(frozen=True)
class PoseSpan:
    """Poses at consecutive SYNCs.

    Attributes
    ----------
    sync : (N,) array of int
        Counts since the last NMT start.
    time_s : (N,) array
        Times of the machine.
    tube, panel : (N, 12) arrays
        Poses in the world: position, then rotation by rows.
    """

    sync: np.ndarray
    time_s: np.ndarray
    tube: np.ndarray
    panel: np.ndarray


class PoseBoard:
    """The shared memory of the poses.

    Parameters
    ----------
    context : BaseContext
        Context of `multiprocessing` whose processes receive the board as an argument.
    """

    def __init__(self, context: BaseContext) -> None:
        self._written = context.RawArray("q", 1)
        self._rows = context.RawArray("d", KEPT * _WIDTH)

    @property
    def _count(self) -> np.ndarray:
        return np.frombuffer(self._written, dtype=np.int64)

    @property
    def _table(self) -> np.ndarray:
        return np.frombuffer(self._rows, dtype=float).reshape(KEPT, _WIDTH)

    def put(self, sync: int, time_s: float, tube: np.ndarray, panel: np.ndarray) -> None:
        """Write the poses at the SYNC that has just been answered; for the machine's end."""
        count = self._count
        row = self._table[count[0] % KEPT]
        row[_SYNC], row[_TIME], row[_TUBE], row[_PANEL] = sync, time_s, tube, panel
        count[0] += 1

    @property
    def now_s(self) -> float:
        """Machine's time at the newest SYNC; -inf before the first."""
        written = int(self._count[0])
        return float(self._table[(written - 1) % KEPT, _TIME]) if written else -np.inf

    def around(self, start_s: float, end_s: float, more: int) -> PoseSpan | None:
        """Return the SYNCs from `start_s` to `end_s` and `more` on either side; None where some of them are not available."""
        written = int(self._count[0])
        rows = np.arange(max(0, written - KEPT + SPARE), written)
        times = self._table[rows % KEPT, _TIME]
        first, last = int(np.searchsorted(times, start_s)) - more, int(np.searchsorted(times, end_s)) + more
        if first < 0 or last > len(rows):
            return None
        found = self._table[rows[first:last] % KEPT]
        return PoseSpan(found[:, _SYNC].astype(int), found[:, _TIME], found[:, _TUBE], found[:, _PANEL])
