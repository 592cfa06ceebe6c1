"""Low passes of an IMU's channels over one plant step, exact for an input that is linear in time."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import scipy.linalg

LEAST_SHAPE = 1e-6
"""Below it the second order has no visible effect: its pole lies at a million times the corner."""


def fill_low_pass(record: np.record, channels: slice, corner_Hz: float, shape: float) -> None:
    """Put the low pass D y'' + T y' + y = u of some channels into a plant's record.

    T = 1 / (2 pi corner) and D = shape T^2. A corner of 0 is no low pass.
    """
    step_s = float(record["step_s"])
    record["filter_weights"][channels] = first_order(corner_Hz, step_s)
    record["is_filtered"][channels] = corner_Hz > 0.0
    if corner_Hz <= 0.0:
        return
    lag_s = 1.0 / (2.0 * np.pi * corner_Hz)
    record["filter_lag"][channels] = lag_s, 0.0
    if shape > LEAST_SHAPE:
        record["is_filtered"][channels] = 2
        record["filter_lag"][channels] = lag_s, shape * lag_s**2
        record["second_weights"][channels] = second_order(corner_Hz, shape, step_s)


def first_order(corner_Hz: float, step_s: float) -> tuple[float, float, float]:
    """Return the weights of the old output, of the input at the step's start, and of the input at its end."""
    if corner_Hz <= 0.0:
        return 0.0, 0.0, 1.0
    phase = 2.0 * np.pi * corner_Hz * step_s
    decay = float(np.exp(-phase))
    mean = (1.0 - decay) / phase
    return decay, mean - decay, 1.0 - mean


@lru_cache(maxsize=256)
def second_order(corner_Hz: float, shape: float, step_s: float) -> np.ndarray:
    """Return the weights (2, 4) of y and of y' / (2 pi corner) after a step.

    The columns weigh both of them before the step, the input at its start and the input at its end. They come from the matrix exponential
    of the low pass, extended by its input and the input's slope (Van Loan 1978).
    """
    phase = 2.0 * np.pi * corner_Hz * step_s
    system = np.zeros((4, 4))
    system[0, 1] = phase
    system[1, :3] = -phase / shape, -phase / shape, phase / shape
    system[2, 3] = 1.0
    after = scipy.linalg.expm(system)
    return np.column_stack([after[:2, 0], after[:2, 1], after[:2, 2] - after[:2, 3], after[:2, 3]])
