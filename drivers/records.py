"""Memory of what runs in every tick as records: the same laws, in Python and compiled, read and advance their fields."""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np

Record: TypeAlias = Any
"""An entry of an array of records with its fields as attributes: `numpy.record`, or what numba makes of it. No checker knows the fields."""


def record_type(*fields: tuple[Any, ...]) -> np.dtype[np.void]:
    """Return the type of a record of these fields, aligned as compiled code wants them; what is set in an entry is set in its array."""
    return np.dtype((np.record, np.dtype(list(fields), align=True)))
