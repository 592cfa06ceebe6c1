"""Frames of a C-arm's bus, packed by hand, for tests of logs in many formats."""

from __future__ import annotations

import struct

import numpy as np

PERIOD_S = 1.0 / 256.0
START_S = 1.7e9  # a Unix time: what logs of real buses begin with

Frame = tuple[float, int, bytes]
"""Time since the first [s], identifier, data."""


def tick_frames(ticks: int) -> list[Frame]:
    """Each tick: a SYNC, what roll's drive answers (counts 100 k, current k per mille), and its target 10 k per mille."""
    return [
        (round(k * PERIOD_S + 1e-4 * place, 6), can_id, data)
        for k in range(ticks)
        for place, (can_id, data) in enumerate(
            [
                (0x080, b""),
                (0x182, struct.pack("<Hih", 0x1237, 100 * k, k)),
                (0x202, struct.pack("<Hh", 0x0F, 10 * k)),
            ]
        )
    ]


def roll_current(ticks: int, rated: float, sign: float) -> np.ndarray:
    """What `current_roll` [A] of `tick_frames` is."""
    return sign * rated * np.arange(ticks) / 1000.0
