"""Values between rows, for what acts from one row to the next: an effort is a mean over a period, a position belongs to an instant."""

from __future__ import annotations

import numpy as np


def means_between_rows(values: np.ndarray) -> np.ndarray:
    """Return means (N - 1, ...) from each row to the next of what is linear between rows (N, ...), as accelerations are."""
    means: np.ndarray = 0.5 * (values[1:] + values[:-1])
    return means
