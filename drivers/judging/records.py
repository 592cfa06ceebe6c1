"""Memory of the judges as records: what compiled code advances, and Python reads."""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np

Record: TypeAlias = Any
"""An entry of a structured array with its fields as attributes: `numpy.record`, or what numba makes of it. No checker knows the fields."""


def record_of(array: np.ndarray) -> Record:
    """Return the first entry of a structured array as a record; what is set in it is set in the array."""
    return array.view(np.recarray)[0]
