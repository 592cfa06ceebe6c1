"""Settings of the controllers, frozen, in SI units and the drives' units. The bench builds them from a machine file."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class AxisController:
    """Feedback of one axis: u = C_r(z) r - C_y(z) y + w + feedforward, saturated at the limit.

    Sections are rows (b0, b1, b2, 1, a1, a2) as in `scipy.signal.sosfilt`, at the sample rate.
    `reference_sections` None means C_r = C_y, run as one filter on r - y.
    """

    axis: str
    position_sections: np.ndarray  # (n, 6)
    reference_sections: np.ndarray | None  # (m, 6) or None
    limit: float  # |command|, drive's unit
    gravity_feedforward: bool


@dataclass(frozen=True)
class AxisLimits:
    """Limits of an axis, against which every reference and every sample is checked."""

    axis: str
    lower: float  # rad or m
    upper: float
    speed: float  # rad/s or m/s
    acceleration: float
    jerk: float
    tracking_error: float  # |reference - position| at which the loop stops the motors
    unit: str = "rad"  # of position: "rad" or "m"
