"""Lanes: what is computed of LANES numbers at a time is what NumPy computes of each."""

from __future__ import annotations

import math

import numba
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numba.core.errors import NumbaError

from virtual_bus.compilation.jit import FAST_MATH, compiled
from virtual_bus.plant.lanes import LANES, LaneRecord

RECORD = LaneRecord({"angle": (3,), "sine": (3,), "cosine": (3,), "table": (2, 3), "level": (2,)})
view = RECORD.view
fast = numba.njit(fastmath=FAST_MATH, error_model="numpy", _nrt=False)


@fast
def circular(memory: np.ndarray) -> None:
    work = view(memory)
    for i in range(len(work.angle)):
        work.sine[i] = math.sin(work.angle[i])
        work.cosine[i] = math.cos(work.angle[i])


@fast
def arithmetic(memory: np.ndarray, by: float) -> None:
    work = view(memory)
    total = 0.0
    for j in range(3):
        total += work.table[0, j] * by - work.table[1, j] / (2 + work.angle[j])
    work.level[0] = -total
    work.level[0] -= 1
    work.level[1] = min(max(math.floor(total), -3.0), 3.0)


@fast
def one_machine(memory: np.ndarray, lane: int) -> None:
    work = view(memory)
    work.angle[1, lane] = work.table[1, 2, lane] + 1.0


def filled(**fields: np.ndarray) -> np.ndarray:
    memory = RECORD.new()
    for name, values in fields.items():
        RECORD.field(memory, name)[:] = values
    return memory


@settings(deadline=None)  # the first example compiles
@given(st.lists(st.floats(-1e8, 1e8), min_size=3 * LANES, max_size=3 * LANES))
def test_sines_and_cosines_are_those_of_every_lane_to_the_last_digit_but_one(angles: list[float]) -> None:
    memory = filled(angle=np.reshape(angles, (3, LANES)))
    circular(memory)
    angle = RECORD.field(memory, "angle")
    assert np.abs(RECORD.field(memory, "sine") - np.sin(angle)).max() <= 2.3e-16
    assert np.abs(RECORD.field(memory, "cosine") - np.cos(angle)).max() <= 2.3e-16


def test_a_lane_that_is_no_number_has_no_sine_and_leaves_the_others_alone() -> None:
    angle = np.full((3, LANES), 0.5)
    angle[0, 2], angle[1, 5] = np.nan, np.inf
    memory = filled(angle=angle)
    circular(memory)
    for name, expected in (("sine", math.sin(0.5)), ("cosine", math.cos(0.5))):
        found = RECORD.field(memory, name)
        assert np.isnan(found[0, 2])
        assert np.isnan(found[1, 5])
        assert np.sum(np.abs(found - expected) < 1e-15) == 3 * LANES - 2


@settings(deadline=None)  # the first example compiles
@given(st.integers(0, 2**32 - 1), st.floats(-5.0, 5.0))
def test_arithmetic_mixes_lanes_with_numbers(seed: int, by: float) -> None:
    random = np.random.default_rng(seed)
    angle, table = random.uniform(0.0, 1.0, (3, LANES)), random.uniform(-2.0, 2.0, (2, 3, LANES))
    memory = filled(angle=angle, table=table)
    arithmetic(memory, by)
    total = (table[0] * by - table[1] / (2.0 + angle)).sum(axis=0)
    level = RECORD.field(memory, "level")
    np.testing.assert_allclose(level[0], -total - 1.0, rtol=0.0, atol=1e-13)
    near = np.abs(total - np.round(total)) < 1e-12
    np.testing.assert_array_equal(level[1][~near], np.clip(np.floor(total), -3.0, 3.0)[~near])


def test_bounds_keep_what_is_no_number_visible() -> None:
    memory = filled(table=np.full((2, 3, LANES), np.nan))
    arithmetic(memory, 1.0)
    assert np.isnan(RECORD.field(memory, "level")).all()


def test_with_the_lane_as_a_further_index_one_machine_is_read_and_written() -> None:
    table = np.arange(6.0 * LANES).reshape(2, 3, LANES)
    memory = filled(table=table)
    one_machine(memory, 4)
    expected = np.zeros((3, LANES))
    expected[1, 4] = table[1, 2, 4] + 1.0
    np.testing.assert_array_equal(RECORD.field(memory, "angle"), expected)


def test_lanes_are_not_compared() -> None:
    @compiled
    def branches(memory: np.ndarray) -> None:
        work = view(memory)
        if work.angle[0] > 0.0:
            work.angle[0] = 1.0

    with pytest.raises(NumbaError):
        branches(RECORD.new())


def test_memory_begins_where_a_line_of_the_cache_does() -> None:
    assert all(RECORD.new().ctypes.data % 64 == 0 for _ in range(20))


def test_a_field_that_is_not_there_is_an_error() -> None:
    with pytest.raises(KeyError):
        RECORD.field(RECORD.new(), "colour")
