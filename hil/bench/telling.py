"""What an attended bench tells, in lines on standard output, from a thread of its own: the loop waits for no reader."""

from __future__ import annotations

import base64
import json
import math
import sys
import threading
from collections import deque
from types import TracebackType
from typing import Any, Self

import numpy as np

from drivers.canopen.axis_rest import POWERED
from drivers.canopen.cia402 import decode_state, describe_statusword
from hil.bench.attended import Shown
from hil.bench.bench import Bench
from hil.bench.told_state import AT_REST, HOMING, ON_THE_WAY, RECORDING, ROWS, SETTLING, STATE, STOPPING, WATCHING

EVERY_S = 0.1
MOST_ROWS = 4096
"""Rows that wait for a reader that hangs; of more the oldest are lost."""


class Teller:
    """Tells the state of a bench ten times a second, and its rows where they are wanted; beside a recording nothing but its beginning.

    Parameters
    ----------
    bench : Bench
    rows : bool
    """

    def __init__(self, bench: Bench, rows: bool) -> None:
        self._bench, self._with_rows = bench, rows
        self._rows: deque[bytes] = deque(maxlen=MOST_ROWS)
        self._put = 0
        self._newest = {name: np.full(len(bench.machine.axes), math.nan) for name in ("position", "effort", "temperature_degC")}
        self._before: tuple[int, np.ndarray] | None = None
        self._latched: tuple[int, np.ndarray] | None = None  # SYNC and positions of one row, which belong together
        self._ends = threading.Event()
        self._thread = threading.Thread(target=self._tell, name="isocenter-teller", daemon=True)
        self.shown = Shown(WATCHING, "", bench.wiring.link.sample, self._take)
        self._begun = (WATCHING, "", 0)  # what the bench does, a part of it, and the SYNC with which it ends at the latest
        bench.tell = self._begin

    def __enter__(self) -> Self:
        """Begin to tell."""
        self._thread.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        """End."""
        self._ends.set()
        self._thread.join(2.0)  # a reader that hangs is not waited for

    def _take(self, row: np.ndarray) -> None:
        link = self._bench.wiring.link
        self._latched = link.syncs, link.sample.position.copy()
        if self._with_rows:
            told = row.copy()
            told[0] = self._put / self._bench.machine.sample_rate_Hz
            self._rows.append(told.tobytes())
        self._put += 1

    def _begin(self, doing: str, part: str, ticks: int) -> None:
        self._begun = doing, part, self._bench.wiring.link.syncs + ticks if ticks else 0
        self.shown.doing = doing

    def _tell(self) -> None:
        if self._with_rows:
            self._print(ROWS, {"channels": self._bench.loop.layout.channels})
        told_last, link = "", self._bench.wiring.link
        while not self._ends.wait(EVERY_S):
            if told_last == self.shown.doing == RECORDING and not link.stopping:
                continue  # the loop has its computer to itself
            told_last = self.shown.doing
            self._print(STATE, self.state())
            if count := len(self._rows):
                block = b"".join(self._rows.popleft() for _ in range(count))
                self._print(ROWS, {"rows": count, "values": base64.b64encode(block).decode()})

    def _print(self, what: str, told: dict[str, Any]) -> None:
        try:
            sys.stdout.write(f"{what}{json.dumps(told)}\n")
            sys.stdout.flush()
        except (OSError, ValueError):  # nobody reads any more: whoever let go of the lead stops the machine
            self._ends.set()

    def state(self) -> dict[str, Any]:
        """Return the state as plain values, in SI; None for what is not known."""
        bench, link, sample = self._bench, self._bench.wiring.link, self.shown.sample
        for name, newest in self._newest.items():
            seen = getattr(sample, name).copy()  # of a tick that is being made, what has not come yet is missing
            newest[np.isfinite(seen)] = seen[np.isfinite(seen)]
        position, speed = self._newest["position"], self._speed()
        begun, part, ends = self._begun
        powered = any(int(each.statusword) >= 0 and decode_state(int(each.statusword)) in POWERED for each in link.inputs)
        doing = STOPPING if link.stopping or (powered and self.shown.doing in AT_REST) else self.shown.doing
        if doing != begun:
            part, ends = "", 0
        axes = {}
        for axis, units in enumerate(bench.machine.units):
            mode, word = link.modes[axis], int(link.inputs[axis].statusword)
            axes[units.axis] = {
                "position": _known(position[axis]),
                "goes_to": _known(bench.way_to[axis]) if doing in (ON_THE_WAY, SETTLING) else None,
                "speed": _known(speed[axis]),
                "effort": _known(self._newest["effort"][axis]),
                "temperature_degC": _known(self._newest["temperature_degC"][axis]),
                "brake": ("open" if sample.brakes_open[axis] else "closed") if link.has_brake(axis) else None,
                "mode": None if mode is None else mode.name.lower().replace("_", " "),
                "drive": None if word < 0 else describe_statusword(word),
            }
        io = None if bench.machine.bus is None or bench.machine.bus.io is None else _permission(sample.hold_to_run, sample.door_closed)
        return {
            "doing": doing,
            "part": part,
            "remains_s": max(0, ends - link.syncs) * link.period_s if ends else None,
            "says": self.shown.says,
            "homed": self.shown.doing not in (WATCHING, HOMING),
            "time_s": link.syncs * link.period_s,
            "axes": axes,
            "io": io,
            "imu": [_known(value) for value in sample.imu],
        }

    def _speed(self) -> np.ndarray:
        """Return the mean speeds (n_axes,) since the state was told last; NaN where the link ticks by itself, and no rows are made."""
        before, self._before = self._before, self._latched
        if before is None or self._latched is None or self._latched[0] <= before[0]:
            return np.full(len(self._bench.machine.axes), math.nan)
        speed: np.ndarray = (self._latched[1] - before[1]) / ((self._latched[0] - before[0]) * self._bench.wiring.link.period_s)
        return speed


def _permission(hold_to_run: bool, door_closed: bool) -> dict[str, bool]:
    return {"hold_to_run": bool(hold_to_run), "door_closed": bool(door_closed)}


def _known(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
