"""The arrays in the memory of a sample, as compiled laws take them; the sample's own module is imported where no compiler is."""

from __future__ import annotations

import numpy as np
from numba.extending import register_jitable

from drivers.interface import IMUS_BYTES, VALUES


@register_jitable
def values_in(memory: np.ndarray) -> np.ndarray:
    """Return (axes,) VALUES."""
    return memory[IMUS_BYTES:].view(VALUES)


@register_jitable
def imus_in(memory: np.ndarray) -> np.ndarray:
    """Return (12,) readings: of the IMU on a line of its own, and of the one on the bus [m/s^2, rad/s]."""
    return memory[:IMUS_BYTES].view(np.float64)
