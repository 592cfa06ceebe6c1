"""Second-order sections step as SciPy filters, and their designs are what they say in continuous time."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import control
import numpy as np
import pytest
import scipy.signal
from control import TransferFunction
from examples import examples
from hypothesis import given, settings
from hypothesis import strategies as st

from controllers import loop_shaping
from controllers.errors import DesignError
from controllers.sections import preload_state, response, sections_step, standstill_states

RATE_HZ = 256.0
CONTROLLER = loop_shaping.cascade(
    loop_shaping.gain(300.0),
    loop_shaping.lead(4.0, 55.0, RATE_HZ),
    loop_shaping.lag(0.0, 0.5, RATE_HZ),
    loop_shaping.notch(14.0, 0.2, 0.5, RATE_HZ),
    loop_shaping.lowpass(60.0, 0.7, RATE_HZ),
)


def run(sections: np.ndarray, state: np.ndarray, inputs: np.ndarray) -> np.ndarray:
    return np.array([sections_step(sections, state, x) for x in inputs])


@pytest.mark.parametrize("order", [1, 2, 5, 8])
def test_a_step_is_bit_for_bit_sosfilt(order: int) -> None:
    sections = scipy.signal.butter(order, 20.0, fs=RATE_HZ, output="sos")
    inputs = np.random.default_rng(order).normal(size=400)
    zi = np.random.default_rng(1).normal(size=(len(sections), 2))
    expected, expected_state = scipy.signal.sosfilt(sections, inputs, zi=zi.copy())
    state = zi.copy()
    assert np.array_equal(run(sections, state, inputs), expected)
    assert np.array_equal(state, expected_state)


FAST_CALLER = """
import numba, numpy as np, scipy.signal
from controllers.sections import sections_step
fast = numba.njit(fastmath=True)(lambda sections, state, x: sections_step(sections, state, x))
sections = scipy.signal.butter(5, 20.0, fs=256.0, output="sos")
inputs = np.random.default_rng(5).normal(size=400)
for step in (fast, sections_step):
    state = np.zeros((len(sections), 2))
    outputs = [step(sections, state, x) for x in inputs]
assert np.array_equal(outputs, scipy.signal.sosfilt(sections, inputs))
"""


@pytest.mark.slow
def test_a_fast_math_caller_leaves_the_step_exact(tmp_path: Path) -> None:
    # numba would hand the caller's fast math down and keep it in the cache for everybody
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    done = subprocess.run([sys.executable, "-c", FAST_CALLER], env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_the_response_is_scipys() -> None:
    frequencies = np.geomspace(0.05, 120.0, 50)
    expected = scipy.signal.sosfreqz(CONTROLLER, frequencies, fs=RATE_HZ)[1]
    np.testing.assert_allclose(response(CONTROLLER, frequencies, RATE_HZ), expected, rtol=1e-10)


@pytest.mark.parametrize(
    ("term", "continuous", "match_Hz"),
    [
        (loop_shaping.lead(5.0, 50.0, RATE_HZ), None, 5.0),
        (loop_shaping.lag(0.1, 1.0, RATE_HZ), control.tf([1, 2 * np.pi], [1, 0.2 * np.pi]), 1.0),
        (
            loop_shaping.notch(14.0, 0.1, 0.4, RATE_HZ),
            control.tf([1, 2 * 0.04 * 28 * np.pi, (28 * np.pi) ** 2], [1, 0.8 * 28 * np.pi, (28 * np.pi) ** 2]),
            14.0,
        ),
        (loop_shaping.lowpass(60.0, 0.7, RATE_HZ), control.tf([(120 * np.pi) ** 2], [1, 1.4 * 120 * np.pi, (120 * np.pi) ** 2]), 60.0),
        (loop_shaping.pid(3.0, 2.0, 0.5, 40.0, RATE_HZ), 3 + control.tf([2], [1, 0]) + control.tf([0.5, 0], [1 / (80 * np.pi), 1]), 40.0),
    ],
    ids=["lead", "lag", "notch", "lowpass", "pid"],
)
def test_a_term_is_tustin_with_prewarping_as_in_python_control(
    term: np.ndarray, continuous: TransferFunction | None, match_Hz: float
) -> None:
    if continuous is None:
        spread = np.tan(np.radians(45.0 + 25.0))
        continuous = control.tf([spread / (10 * np.pi), 1], [1 / (10 * np.pi), spread])
    sampled = control.sample_system(continuous, 1.0 / RATE_HZ, method="bilinear", prewarp_frequency=2 * np.pi * match_Hz)
    frequencies = np.array([0.3, match_Hz, 50.0])
    expected = sampled(np.exp(2j * np.pi * frequencies / RATE_HZ))
    np.testing.assert_allclose(response(term, frequencies, RATE_HZ), expected, rtol=1e-6)
    np.testing.assert_allclose(response(term, [match_Hz], RATE_HZ), continuous(2j * np.pi * match_Hz), rtol=1e-6)


def test_a_lead_gives_its_phase_and_unit_gain_where_it_says() -> None:
    value = response(loop_shaping.lead(6.0, 50.0, RATE_HZ), [6.0], RATE_HZ)[0]
    assert abs(value) == pytest.approx(1.0)
    assert np.degrees(np.angle(value)) == pytest.approx(50.0)


@pytest.mark.parametrize(
    "make",
    [
        lambda: loop_shaping.lead(6.0, 95.0, RATE_HZ),
        lambda: loop_shaping.lag(2.0, 1.0, RATE_HZ),
        lambda: loop_shaping.notch(130.0, 0.1, 0.5, RATE_HZ),
    ],
)
def test_a_term_that_cannot_be_is_refused(make: Callable[..., object]) -> None:
    with pytest.raises(DesignError):
        make()


@given(output=st.floats(-8.0, 8.0), order=st.permutations(range(5)))
@settings(max_examples=examples(30), deadline=None)
def test_a_preloaded_cascade_holds_its_output_wherever_the_integrator_stands(output: float, order: list[int]) -> None:
    sections = np.ascontiguousarray(CONTROLLER[list(order)])
    state = preload_state(sections, output)
    np.testing.assert_allclose(run(sections, state, np.zeros(2000)), output, atol=1e-10)


def test_without_an_integrator_only_zero_can_be_held() -> None:
    sections = loop_shaping.lowpass(30.0, 0.7, RATE_HZ)
    assert not preload_state(sections, 0.0).any()
    with pytest.raises(DesignError, match=r"2\.5.*no integrator"):
        preload_state(sections, 2.5)


@given(position=st.floats(-2.0, 2.0), output=st.floats(-8.0, 8.0))
@settings(max_examples=examples(30), deadline=None)
def test_separate_filters_with_integrators_hold_together(position: float, output: float) -> None:
    from_reference = loop_shaping.cascade(loop_shaping.pid(80.0, 40.0, 0.0, 30.0, RATE_HZ), loop_shaping.lowpass(50.0, 0.8, RATE_HZ))
    from_position = loop_shaping.cascade(loop_shaping.pid(80.0, 40.0, 5.0, 30.0, RATE_HZ), loop_shaping.lowpass(50.0, 0.8, RATE_HZ))
    state_r, state_y = standstill_states(from_reference, from_position, position, output)
    held = run(from_reference, state_r, np.full(2000, position)) - run(from_position, state_y, np.full(2000, position))
    np.testing.assert_allclose(held, output, atol=1e-8)


def test_separate_filters_that_differ_at_standstill_are_refused() -> None:
    with pytest.raises(DesignError, match="integrator"):
        standstill_states(loop_shaping.gain(2.0), loop_shaping.gain(1.0), 0.5, 0.0)
    state_r, state_y = standstill_states(loop_shaping.gain(2.0), loop_shaping.gain(1.0), 0.5, 0.5)
    assert run(loop_shaping.gain(2.0), state_r, [0.5])[0] - run(loop_shaping.gain(1.0), state_y, [0.5])[0] == pytest.approx(0.5)
