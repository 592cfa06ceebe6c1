"""The state of the I/O, and its block in shared memory, written by the process that polls it."""

from __future__ import annotations

import math
from multiprocessing.shared_memory import SharedMemory

import numpy as np

from drivers.interface import Sample
from drivers.shared_memory.block import Block

_TIME, _HOLD_TO_RUN, _DOOR, _WORD, _FIRST = range(5)


class IoState:
    """The newest state of the device. Arrays have the length of the axis list."""

    def __init__(self, axes: int) -> None:
        self.temperature_degC = np.full(axes, np.nan)
        self.brakes_open = np.zeros(axes, dtype=bool)
        self.hold_to_run = False  # pressed, by all of its contacts
        self.door_closed = False
        self.time_s = -math.inf  # when it was read
        self.word = 0  # of the output watchdog, as the device showed it last

    def copy_to(self, sample: Sample, now_s: float, stale_after_s: float) -> None:
        """Fill the sample. A state that is too old reads as the safe one: switch released, door open, no brake reported open."""
        age_s = now_s - self.time_s
        sample.io_age_s = age_s
        if age_s > stale_after_s:
            sample.temperature_degC.fill(np.nan)
            sample.brakes_open.fill(False)
            sample.hold_to_run = False
            sample.door_closed = False
            return
        sample.temperature_degC[:] = self.temperature_degC
        sample.brakes_open[:] = self.brakes_open
        sample.hold_to_run = self.hold_to_run
        sample.door_closed = self.door_closed


def state_values(axes: int) -> int:
    """Return the number of values of a state: time, hold-to-run, door, word of the watchdog, temperatures, brakes."""
    return _FIRST + 2 * axes


def published_block(memory: SharedMemory, axes: int) -> Block:
    """Return the block of the state, the first in its memory."""
    buffer = memory.buf
    assert buffer is not None, "shared memory was closed"
    values = state_values(axes)
    return Block(buffer[: Block.bytes(values)], values)


def values_of(state: IoState) -> np.ndarray:
    """Return a state as the values of its block."""
    return np.concatenate(((state.time_s, state.hold_to_run, state.door_closed, state.word), state.temperature_degC, state.brakes_open))


def take_state(block: Block, values: np.ndarray, state: IoState) -> int:
    """Copy the newest state out of its block, by way of `values`.

    Returns
    -------
    int
        Its sequence number; -1 where it was changed at every attempt, and the state is as before.
    """
    sequence = block.read(values)
    if sequence >= 0:
        axes = len(state.brakes_open)
        state.time_s = float(values[_TIME])
        state.hold_to_run, state.door_closed = bool(values[_HOLD_TO_RUN]), bool(values[_DOOR])
        state.word = int(values[_WORD])
        state.temperature_degC[:] = values[_FIRST : _FIRST + axes]
        state.brakes_open[:] = values[_FIRST + axes :]
    return sequence
