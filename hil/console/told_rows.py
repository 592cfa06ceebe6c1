"""Rows of what a run tells of itself before it records: by them the scope is live while the machine homes and goes to its start."""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping, Sequence
from typing import Any

from hil.bench.told_state import RECORDING
from hil.console.facts import AxisFacts
from hil.console.rows import RowHub

NAME = "before the recording"


class ToldRows:
    """Makes a row of every state that is told.

    Parameters
    ----------
    rows : RowHub
        Takes them.
    axes : sequence of AxisFacts
    """

    def __init__(self, rows: RowHub, axes: Sequence[AxisFacts]) -> None:
        self._rows, self._axes = rows, axes
        self._began_s = self._last_s = math.inf  # by the clock of the session that tells

    def take(self, told: Mapping[str, Any]) -> None:
        """Show a state; one that is older than the one before is of another session."""
        time_s = float(told["time_s"])
        if told["doing"] == RECORDING or time_s < self._last_s:
            self._last_s = math.inf
        if told["doing"] == RECORDING:
            return
        if self._last_s == math.inf or self._rows.awaits:  # its journal was opened meanwhile
            self._began_s = time_s
            self._rows.show(NAME, [("time", "s"), *(channel for axis in self._axes for channel in _channels(axis))])
        self._last_s = time_s
        seen = [told["axes"][axis.name] for axis in self._axes]
        known = [each[what] for each in seen for what in ("position", "speed", "effort")]
        values = [time_s - self._began_s, *(math.nan if value is None else value for value in known)]
        self._rows.take_shown(1, struct.pack(f"<{len(values)}d", *values), are_ticks=False)


def _channels(axis: AxisFacts) -> list[tuple[str, str]]:
    """Return position, speed and effort of an axis, named as in a recording."""
    effort = f"{'current' if axis.effort_unit == 'A' else 'effort'}_{axis.name}"
    return [(f"position_{axis.name}", axis.unit), (f"speed_{axis.name}", f"{axis.unit}/s"), (effort, axis.effort_unit)]
