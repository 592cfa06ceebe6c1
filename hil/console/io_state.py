"""The state of the I/O as its poller publishes it: hold-to-run, door, brakes, temperatures. The poller is not asked, its memory is read."""

from __future__ import annotations

import mmap
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from drivers.shared_memory.block import Block
from drivers.shared_memory.io_state import IoState, state_values, take_state
from hil.bench.notice import io_memory_of

SHARED = Path("/dev/shm")
"""Where Linux keeps named shared memory. Python's own class would remove it at the end of this process, which only reads."""


class IoWatch:
    """Reads the newest state of the I/O of whichever bench runs on a bus.

    Parameters
    ----------
    bus_url : str
    axes : sequence of str
    """

    def __init__(self, bus_url: str, axes: Sequence[str]) -> None:
        self._bus_url, self._axes = bus_url, axes
        self._values = np.zeros(state_values(len(axes)))

    def state(self) -> dict[str, Any] | None:
        """Return the state as plain values; None where no bench polls an I/O."""
        name = io_memory_of(self._bus_url)
        if not name:
            return None
        state = IoState(len(self._axes))
        try:
            with (SHARED / name.lstrip("/")).open("rb") as file:
                memory = mmap.mmap(file.fileno(), Block.bytes(len(self._values)), access=mmap.ACCESS_READ)
        except (OSError, ValueError):
            return None  # it has just ended
        view = memoryview(memory)
        block = Block(view, len(self._values))
        sequence = take_state(block, self._values, state)
        block.release()
        view.release()
        memory.close()
        if sequence <= 0:
            return None
        return {
            "hold_to_run": state.hold_to_run,
            "door_closed": state.door_closed,
            "age_s": max(0.0, time.monotonic() - state.time_s),
            "brakes_open": dict(zip(self._axes, map(bool, state.brakes_open), strict=True)),
            "temperature_degC": {
                axis: float(value) if np.isfinite(value) else None for axis, value in zip(self._axes, state.temperature_degC, strict=True)
            },
        }
