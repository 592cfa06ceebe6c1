"""How punctual a run is: histograms of SYNC's lateness and of the loop's work in each tick."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

EDGES_us = np.concatenate(([0.0], np.geomspace(1.0, 100_000.0, 51)))
"""Ten bins a decade from a microsecond, below which nothing is told apart, to a tenth of a second."""
MEASURED = {"sync_lateness": "lateness of SYNC", "work_time": "work of a tick"}


class Timeliness:
    """Counts rows by lateness and work.

    Parameters
    ----------
    channels : sequence of str
        Columns of the rows.
    """

    def __init__(self, channels: Sequence[str]) -> None:
        self._columns = {name: channels.index(name) for name in MEASURED if name in channels}
        self._time = channels.index("time") if "time" in channels else None
        self._counts = {name: np.zeros(len(EDGES_us), dtype=np.int64) for name in self._columns}  # the last: beyond the edges
        self._worst = dict.fromkeys(self._columns, 0.0)
        self._width = len(channels)
        self._before_s = np.nan
        self._period_s = np.inf
        self.rows = self.missed = 0

    def take(self, rows: int, values: bytes) -> None:
        """Count a block of rows."""
        table = np.frombuffer(values, dtype="<f8").reshape(rows, self._width)
        self.rows += rows
        for name, column in self._columns.items():
            measured = table[:, column]
            measured = measured[np.isfinite(measured)] * 1e6
            self._counts[name] += np.bincount(np.searchsorted(EDGES_us[1:], measured), minlength=len(EDGES_us))
            self._worst[name] = max(self._worst[name], float(measured.max(initial=0.0)))
        if self._time is not None:
            steps = np.diff(table[:, self._time], prepend=self._before_s)
            steps = steps[steps > 0.0]
            if len(steps):
                self._period_s = min(self._period_s, float(steps.min()))
                self.missed += int(np.rint(steps / self._period_s - 1.0).sum())
            self._before_s = float(table[-1, self._time])

    def summary(self) -> dict[str, Any]:
        """Return counts, edges [us], and the percentiles that the counts tell (the upper edge of their bin)."""
        found: dict[str, Any] = {"rows": self.rows, "missed": self.missed, "edges_us": EDGES_us.tolist(), "measured": {}}
        for name, counts in self._counts.items():
            total = int(counts.sum())
            if not total:
                continue
            below = np.cumsum(counts)
            upper = np.append(EDGES_us[1:], self._worst[name])
            at_most = {f"p{share:g}": float(upper[np.searchsorted(below, share / 100.0 * total)]) for share in (50.0, 99.0, 99.9)}
            found["measured"][name] = {
                "title": MEASURED[name],
                "counts": counts.tolist(),
                "max_us": self._worst[name],
                **{f"{key}_us": min(value, self._worst[name]) for key, value in at_most.items()},
            }
        return found
