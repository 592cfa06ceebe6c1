"""A drive's own loops with the bench's filters around them, as one law in effort."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from examples import examples
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import sosfilt

from controllers.cascade import NO_SECTIONS, AxisCommand, DriveLoops, in_effort
from controllers.errors import DesignError
from controllers.settings import AxisController

RATE_Hz = 256.0
LOOPS = DriveLoops(position_gain=8.0, velocity_gain=60.0, velocity_integral_gain=150.0, speed_filter=0.25)
LEAD = np.array([[3.0, -2.9, 0.0, 1.0, -0.5, 0.0], [0.9, -1.6, 0.8, 1.0, -1.6, 0.7]])


def drive_by_steps(mode: str, loops: DriveLoops, target: np.ndarray, position: np.ndarray) -> np.ndarray:
    """Return the effort of the drive's loops, written as a drive's firmware has them: one sample after another."""
    period_s = 1.0 / RATE_Hz
    integral = speed = 0.0
    efforts = [0.0] * len(target)
    before = 0.0
    for k, (wanted, y) in enumerate(zip(target, position, strict=True)):
        speed += loops.speed_filter * ((y - before) / period_s - speed)
        before = y
        demand = loops.position_gain * (wanted - y) if mode == "position" else wanted
        lag = demand - speed
        efforts[k] = integral + loops.velocity_gain * lag
        integral += loops.velocity_integral_gain * lag * period_s
    return np.array(efforts)


def command_of(mode: str, sections: np.ndarray, reference_sections: np.ndarray | None, loops: DriveLoops = LOOPS) -> AxisCommand:
    controller = AxisController("roll", sections, reference_sections, 1e9, False)
    return AxisCommand(mode, controller, loops)  # type: ignore[arg-type]


@pytest.mark.parametrize("mode", ["velocity", "position"])
@pytest.mark.parametrize(
    "reference_sections", [None, np.array([[4.0, -3.9, 0.0, 1.0, -0.2, 0.0]]), np.array([[0.0, 2.0, 1.0, 1.0, 0.0, 0.0]])]
)
@pytest.mark.parametrize("sections", [LEAD, NO_SECTIONS, np.array([[0.0, 5.0, 0.0, 1.0, 0.0, 0.0]])], ids=["lead", "none", "delay"])
def test_bench_and_drive_are_the_law(mode: str, sections: np.ndarray, reference_sections: np.ndarray | None) -> None:
    rng = np.random.default_rng(5)
    reference, position = rng.normal(size=(2, 400))
    r = sections if reference_sections is None else reference_sections
    target = sosfilt(r, reference) - sosfilt(sections, position) + (reference if mode == "position" else 0.0)
    expected = drive_by_steps(mode, LOOPS, target, position)

    law = in_effort(command_of(mode, sections, reference_sections), 8.0, RATE_Hz)
    assert law.reference_sections is not None
    found = sosfilt(law.reference_sections, reference) - sosfilt(law.position_sections, position)
    assert np.abs(found - expected).max() < 1e-9 * np.abs(expected).max()
    assert law.limit == 8.0


@settings(max_examples=examples(50), deadline=None, derandomize=True)
@given(
    st.floats(0.0, 100.0),
    st.floats(0.01, 1e3),
    st.floats(0.0, 1e3),
    st.floats(0.05, 1.0),
    st.lists(st.tuples(st.floats(0.1, 0.9), st.floats(0.1, 0.9)), max_size=3),
)
def test_any_gains_and_leads(k: float, kp: float, ki: float, share: float, leads: list[tuple[float, float]]) -> None:
    loops = DriveLoops(k, kp, ki, share)
    sections = np.array([[1.0, -zero, 0.0, 1.0, -pole, 0.0] for zero, pole in leads]) if leads else NO_SECTIONS
    position = np.random.default_rng(1).normal(size=100)
    nothing = np.zeros(100)
    expected = drive_by_steps("position", loops, -sosfilt(sections, position), position)
    law = in_effort(command_of("position", sections, None, loops), 1.0, RATE_Hz)
    assert np.abs(-sosfilt(law.position_sections, position) - expected).max() <= 1e-8 * max(np.abs(expected).max(), 1e-9)
    assert not sosfilt(law.reference_sections, nothing).any()


def test_what_stands_holds_any_effort_and_a_second_integrator_is_refused() -> None:
    from controllers.feedback import Feedback

    law = in_effort(command_of("position", NO_SECTIONS, None), 8.0, RATE_Hz)
    feedback = Feedback([law])
    feedback.preload(np.array([2.5]), np.array([0.7]))
    out, zero, there = np.zeros(1), np.zeros(1), np.array([0.7])
    efforts = [feedback.step(there, there, zero, zero, out) or float(out[0]) for _ in range(20)]
    assert all(abs(b - a) < 1e-9 for a, b in pairwise(efforts))
    assert efforts[0] == pytest.approx(2.5)

    with pytest.raises(DesignError, match="roll: its controller integrates, and so does the drive's velocity loop; in velocity mode"):
        in_effort(command_of("velocity", np.array([[1.0, -0.9, 0.0, 1.0, -1.0, 0.0]]), None), 8.0, RATE_Hz)
