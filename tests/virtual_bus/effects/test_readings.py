"""What a sensor's readings show by themselves, on motions and noise drawn by seed."""

from __future__ import annotations

import numpy as np
import pytest
from examples import examples
from hypothesis import given, settings
from hypothesis import strategies as st

from virtual_bus.effects.readings import Readings
from virtual_bus.effects.registry import in_readings

STEP = 1e-5
ROWS = 2000
SEEDS = st.integers(0, 10_000)


def motion(seed: int, reach: float = 0.3) -> np.ndarray:
    """A joint's position (ROWS,): three sines and a slow one, of 300 to 6000 steps a row at most."""
    random = np.random.default_rng(seed)
    time = np.arange(ROWS) / 200.0
    return reach * sum(
        random.uniform(0.3, 1.0) * np.sin(2 * np.pi * random.uniform(0.2, 2.0) * time + random.uniform(0, 6)) for _ in range(3)
    )


def on_lattice(values: np.ndarray, step: float) -> np.ndarray:
    return np.floor(values / step + 0.5) * step


@settings(max_examples=examples(40), deadline=None, derandomize=True)
@given(seed=SEEDS, times=st.floats(3.0, 60.0), offset=st.floats(-1.0, 1.0))
def test_a_coarser_lattice_is_found_with_its_step(seed: int, times: float, offset: float) -> None:
    q = times * STEP
    values = tuple(on_lattice(on_lattice(motion(seed + k), q) + offset, STEP) for k in range(3))
    found = in_readings("encoder_quantization", Readings(values, STEP, is_position=True))
    assert found is not None
    value, low, high = found.values["q"]
    assert low <= q <= high
    assert high - low < 0.1 * STEP
    assert found.step == value


@settings(max_examples=examples(40), deadline=None, derandomize=True)
@given(seed=SEEDS, noise=st.floats(0.0, 30.0))
def test_readings_on_the_files_lattice_show_none(seed: int, noise: float) -> None:
    random = np.random.default_rng(seed)
    values = tuple(on_lattice(motion(seed) + noise * STEP * random.standard_normal(ROWS), STEP) for _ in range(3))
    assert in_readings("encoder_quantization", Readings(values, STEP, is_position=True)) is None
    assert in_readings("sample_dropout", Readings(values, STEP, is_position=True)) is None


def held(values: np.ndarray, share: float, length: int, random: np.random.Generator) -> np.ndarray:
    """Readings of which bursts are lost with a probability, the last one before being held."""
    lost = np.repeat(random.random(ROWS // length + 1) < share, length)[:ROWS]
    lost[0] = False
    return values[np.maximum.accumulate(np.where(lost, 0, np.arange(ROWS)))]


@settings(max_examples=examples(40), deadline=None, derandomize=True)
@given(seed=SEEDS, share=st.floats(0.05, 0.4), length=st.integers(1, 4), is_position=st.booleans())
def test_held_readings_are_found_in_their_share(seed: int, share: float, length: int, is_position: bool) -> None:
    random = np.random.default_rng(seed)
    values = []
    for _ in range(3):
        true = motion(seed) if is_position else 2.0 * motion(seed) + 20 * STEP * random.standard_normal(ROWS)
        values.append(held(on_lattice(true, STEP), share, length, random))
    found = in_readings("sample_dropout", Readings(tuple(values), STEP, is_position=is_position))
    assert found is not None
    value, low, high = found.values["p"]
    assert low < value < high
    spread = 3.0 * np.sqrt(share * length / (3 * ROWS))  # by which drawn bursts differ from their probability
    assert low - spread < share < high + spread
    burst, shortest, longest = found.values["length"]
    assert burst == pytest.approx(length, rel=0.3)
    assert shortest <= length <= longest
    assert value == pytest.approx(share, abs=spread, rel=0.3 if is_position else 0.0)  # of positions in slow motion it hardly shows


@settings(max_examples=examples(30), deadline=None, derandomize=True)
@given(seed=SEEDS)
def test_a_joint_that_friction_stops_holds_no_readings(seed: int) -> None:
    """Stick and slip: it slides with a speed that falls to nothing, and begins again from there."""
    random = np.random.default_rng(seed)
    speed = np.maximum(30.0 * STEP * np.sin(2 * np.pi * np.arange(ROWS) / random.integers(25, 90)), 0.0)
    values = on_lattice(np.cumsum(speed), STEP)
    assert in_readings("sample_dropout", Readings((values,), STEP, is_position=True)) is None


def test_a_lattice_that_is_coarser_in_places_holds_no_readings() -> None:
    """As some encoders' interpolation is: ten of its steps at once."""
    values = on_lattice(motion(3, 0.01), STEP)
    values = np.where(values > 0.0, on_lattice(values, 10.0 * STEP), values)
    assert in_readings("sample_dropout", Readings((values,), STEP, is_position=True)) is None


def test_an_effect_that_readings_do_not_show_is_none() -> None:
    assert in_readings("coulomb_friction", Readings((motion(1),), STEP)) is None
