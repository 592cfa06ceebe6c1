"""Moves and sweeps stay within their limits, measured on their samples, and end where they should."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest
from examples import examples
from hypothesis import given, settings
from hypothesis import strategies as st

from controllers.errors import DesignError
from controllers.settings import AxisLimits
from controllers.trajectory import Trajectory, check_limits, move, sweep, way_to_reach

RATE_HZ = 256.0
DEG = np.pi / 180.0
LIMITS = tuple(
    AxisLimits(axis, -end * DEG, end * DEG, speed=60 * DEG, acceleration=120 * DEG, jerk=600 * DEG, tracking_error=3 * DEG)
    for axis, end in (("propeller", 120.0), ("roll", 90.0))
)


def differences(position: np.ndarray) -> list[float]:
    from_rest = np.vstack([np.tile(position[0], (3, 1)), position, np.tile(position[-1], (3, 1))])
    return [np.abs(np.diff(from_rest, order, axis=0)).max() * RATE_HZ**order for order in (1, 2, 3)]


@given(st.tuples(st.floats(-120, 120), st.floats(-90, 90)), st.tuples(st.floats(-120, 120), st.floats(-90, 90)))
@settings(max_examples=examples(40), deadline=None)
def test_any_move_keeps_its_limits_by_differences_and_arrives(start: tuple[float, float], goal: tuple[float, float]) -> None:
    start, goal = np.array(start) * DEG, np.array(goal) * DEG
    moved = move(start, goal, LIMITS, RATE_HZ)
    np.testing.assert_allclose(moved.position[0], start, atol=1e-12)
    np.testing.assert_allclose(moved.position[-1], goal, atol=1e-9)
    np.testing.assert_allclose(moved.velocity[-1], 0.0, atol=1e-9)
    speed, acceleration, jerk = differences(moved.position)
    assert speed <= 60 * DEG * (1 + 1e-6)
    assert acceleration <= 120 * DEG * (1 + 1e-6)
    assert jerk <= 600 * DEG * (1 + 1e-4)


@pytest.mark.parametrize("speed_deg_s", [30.0, 55.0])
def test_a_sweep_has_a_part_at_its_speed_and_takes_the_closed_form_time(speed_deg_s: float) -> None:
    swept = sweep(1, np.array([0.2, -90 * DEG]), 90 * DEG, speed_deg_s * DEG, LIMITS, RATE_HZ)
    assert (swept.position[:, 0] == 0.2).all()
    constant = np.isclose(swept.velocity[:, 1], speed_deg_s * DEG, rtol=1e-9)
    # ramps: speed/acceleration + acceleration/jerk each; a symmetric ramp covers half its time at speed
    ramp_s = speed_deg_s / 120.0 + 120.0 / 600.0
    total_s = 180.0 / speed_deg_s + ramp_s
    assert len(swept.position) == pytest.approx(total_s * RATE_HZ + 1, abs=1.0)
    assert constant.sum() == pytest.approx((total_s - 2 * ramp_s) * RATE_HZ, abs=2.0)


@given(st.floats(1.0, 60.0))
@settings(max_examples=examples(20), deadline=None)
def test_a_way_too_short_names_the_way_that_would_do(speed_deg_s: float) -> None:
    speed, start = speed_deg_s * DEG, np.zeros(2)
    needed = way_to_reach(speed, 120 * DEG, 600 * DEG)
    with pytest.raises(DesignError, match=rf"roll.*too short.*takes {needed / DEG:.5g} deg"):
        sweep(1, start, 0.98 * needed, speed, LIMITS, RATE_HZ)
    swept = sweep(1, start, 1.02 * needed, speed, LIMITS, RATE_HZ)
    assert swept.velocity[:, 1].max() == pytest.approx(speed, rel=1e-3)


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda: move(np.zeros(2), np.array([0.0, 2.0]), LIMITS, RATE_HZ), "roll: goal 114.59 deg is outside"),
        (lambda: move(np.array([-3.0, 0.0]), np.zeros(2), LIMITS, RATE_HZ), "propeller: start -171.89 deg is outside"),
        (lambda: sweep(1, np.zeros(2), 1.0, 70 * DEG, LIMITS, RATE_HZ), "speed"),
        (lambda: move(np.zeros(1), np.ones(1), (dataclasses.replace(LIMITS[0], jerk=np.inf),), RATE_HZ), "machine has none"),
        (lambda: move(np.zeros(1), np.ones(1), (dataclasses.replace(LIMITS[0], speed=-1.0),), RATE_HZ), "propeller"),
    ],
)
def test_what_cannot_be_moved_is_refused(call: Callable[..., object], says: str) -> None:
    with pytest.raises(DesignError, match=says):
        call()


@pytest.mark.parametrize("name", ["position", "speed", "acceleration", "jerk"])
def test_a_profile_beyond_a_limit_is_found(name: str) -> None:
    fields = {"position": np.zeros((9, 2)), "velocity": np.zeros((9, 2)), "acceleration": np.zeros((9, 2))}
    rows = {"position": ("position", 2.0), "speed": ("velocity", 1.1), "acceleration": ("acceleration", 2.2), "jerk": ("acceleration", 0.5)}
    field, value = rows[name]
    fields[field][4:, 1] = value
    with pytest.raises(DesignError, match="roll: the move (leaves|reaches)" + ("" if name == "position" else f" a (jerk|{name})")):
        check_limits(Trajectory(**fields), LIMITS, RATE_HZ)
