"""Arrays that are bound once are those of the caller, in every call."""

from __future__ import annotations

import numpy as np

from controllers.bound import Bound, bound
from controllers.compiled import exactly_compiled


@exactly_compiled
def moved(both: Bound, by: float) -> float:
    """Add to the first array, return the sum of the second."""
    first, second = both.held[0]
    first[:] += by
    return float(second.sum() + both.held[1][0])


def test_compiled_functions_read_and_write_the_callers_arrays() -> None:
    first, second, offset = np.zeros(3), np.ones((2, 2)), np.array([0.5])
    both = bound(((first, second), offset))
    assert moved(both, 2.0) == 4.5
    assert first.tolist() == [2.0, 2.0, 2.0]
    second[:] = 3.0
    offset[0] = 1.0
    assert moved(both, -2.0) == 13.0
    assert first.tolist() == [0.0, 0.0, 0.0]


def test_what_is_bound_lives_as_long_as_the_binding() -> None:
    both = bound(((np.zeros(3), np.full((2, 2), 1.0)), np.array([0.0])))
    spoilt = [np.full(4, 7.0) for _ in range(100)]  # takes freed memory
    assert moved(both, 0.0) == 4.0
    assert len(spoilt) == 100
