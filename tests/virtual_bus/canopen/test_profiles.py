"""Trapezoidal profiles against a closed form, against the library ruckig with unlimited jerk, and against their own limits."""

from __future__ import annotations

import math

import numpy as np
import pytest
import ruckig
from examples import examples
from hypothesis import given, settings
from hypothesis import strategies as st

from virtual_bus.canopen.modes.profile import Limits, Profile, ramped, to_rest, to_target

speeds, rates = st.floats(1.0, 1e5), st.floats(1.0, 1e6)
places = st.integers(-(10**6), 10**6)
# for ruckig, whose tolerances are absolute: of the order of one
few, some, near = st.floats(0.5, 5.0), st.floats(0.5, 20.0), st.floats(-20.0, 20.0)


def by_ruckig(position: float, speed: float, target: float, limits: Limits) -> ruckig.Trajectory:
    """The time-optimal trajectory whose acceleration away from the start and deceleration towards the target are these."""
    forward = target >= position
    asked = ruckig.InputParameter(1)
    asked.current_position, asked.current_velocity, asked.target_position = [position], [speed], [target]
    asked.max_velocity = [limits.speed]
    asked.max_acceleration = [limits.acceleration if forward else limits.deceleration]
    asked.min_acceleration = [-limits.deceleration if forward else -limits.acceleration]
    asked.max_jerk = [math.inf]
    trajectory = ruckig.Trajectory(1)
    assert ruckig.Ruckig(1).calculate(asked, trajectory) == ruckig.Result.Working
    return trajectory


def agree(profile: Profile, trajectory: ruckig.Trajectory) -> None:
    assert profile.duration_s == pytest.approx(trajectory.duration, rel=1e-6, abs=1e-9)
    for time_s in np.linspace(0.0, trajectory.duration, 41):
        (position,), (speed,), _ = trajectory.at_time(float(time_s))
        assert profile.at(float(time_s)) == (pytest.approx(position, abs=1e-6), pytest.approx(speed, abs=1e-6))


@settings(max_examples=examples(300), deadline=None, derandomize=True)
@given(start=near, target=near, speed=few, acceleration=some, deceleration=some)
def test_from_rest_it_is_ruckigs(start: float, target: float, speed: float, acceleration: float, deceleration: float) -> None:
    limits = Limits(speed, acceleration, deceleration)
    agree(to_target(start, 0.0, target, limits), by_ruckig(start, 0.0, target, limits))


@settings(max_examples=examples(300), deadline=None, derandomize=True)
@given(start=near, target=near, initial=st.floats(-8.0, 8.0), speed=few, acceleration=some)
def test_from_any_speed_it_is_ruckigs(start: float, target: float, initial: float, speed: float, acceleration: float) -> None:
    limits = Limits(speed, acceleration, acceleration)
    agree(to_target(start, initial, target, limits), by_ruckig(start, initial, target, limits))


@pytest.mark.parametrize("direction", [1, -1])
def test_a_trapezoid_is_what_pencil_and_paper_give(direction: int) -> None:
    """1000 counts with 200 counts/s, 400 and 100 counts/s^2: 0.5 s up, 50 counts; 2 s down, 200 counts; 3.75 s between."""
    profile = to_target(7.0, 0.0, 7.0 + direction * 1000.0, Limits(200.0, 400.0, 100.0))
    assert profile.duration_s == pytest.approx(6.25)
    for time_s, way, speed in ((0.25, 12.5, 100.0), (0.5, 50.0, 200.0), (2.5, 450.0, 200.0), (4.25, 800.0, 200.0), (5.25, 950.0, 100.0)):
        position, now = profile.at(time_s)
        assert (direction * (position - 7.0), direction * now) == (pytest.approx(way), pytest.approx(speed))
    assert profile.at(6.25) == profile.at(99.0) == (7.0 + direction * 1000.0, 0.0)


def test_a_short_way_is_a_triangle() -> None:
    """75 counts with 400 and 100 counts/s^2: the peak is sqrt(2 * 75 / (1/400 + 1/100)) = 109.5 counts/s."""
    profile = to_target(0.0, 0.0, 75.0, Limits(1e9, 400.0, 100.0))
    peak = math.sqrt(2.0 * 75.0 / (1 / 400 + 1 / 100))
    assert profile.at(peak / 400.0)[1] == pytest.approx(peak)
    assert profile.duration_s == pytest.approx(peak / 400.0 + peak / 100.0)


def test_what_is_too_fast_stops_behind_the_target_and_comes_back() -> None:
    profile = to_target(0.0, 100.0, 10.0, Limits(1000.0, 400.0, 100.0))
    assert profile.at(1.0) == (pytest.approx(50.0), pytest.approx(0.0)), "it slows down with the deceleration"
    assert profile.at(1.0 + 0.1)[0] == pytest.approx(50.0 - 0.5 * 400.0 * 0.01), "and comes back with the acceleration"
    assert profile.end == 10.0


def test_to_rest_is_the_shortest_way() -> None:
    assert to_rest(5.0, -100.0, 50.0).end == pytest.approx(5.0 - 100.0)
    assert to_rest(5.0, -100.0, 50.0).duration_s == pytest.approx(2.0)
    assert to_rest(5.0, 0.0, 50.0).at(0.0) == (5.0, 0.0)


@settings(max_examples=examples(300), deadline=None, derandomize=True)
@given(start=places, target=places, initial=st.floats(-1e5, 1e5), speed=speeds, acceleration=rates, deceleration=rates)
def test_no_limit_is_passed_and_nothing_jumps(
    start: int, target: int, initial: float, speed: float, acceleration: float, deceleration: float
) -> None:
    limits = Limits(speed, acceleration, deceleration)
    profile = to_target(start, initial, target, limits)
    step = max(profile.duration_s, 1e-6) / 200.0
    before = profile.at(0.0)
    assert before == (pytest.approx(start, abs=1e-6), pytest.approx(initial, abs=1e-6)) or profile.duration_s == 0.0
    for k in range(1, 201):
        now = profile.at(k * step)
        assert abs(now[1]) <= max(speed, abs(initial)) * (1.0 + 1e-9)
        assert abs(now[1] - before[1]) <= max(acceleration, deceleration) * step * (1.0 + 1e-6) + 1e-5
        assert now[0] - before[0] == pytest.approx(0.5 * (now[1] + before[1]) * step, abs=max(acceleration, deceleration) * step**2 + 1e-3)
        before = now
    assert profile.at(profile.duration_s) == (target, 0.0)


@settings(max_examples=examples(200), deadline=None, derandomize=True)
@given(speed=st.floats(-1e4, 1e4), target=st.floats(-1e4, 1e4), acceleration=rates, deceleration=rates, pieces=st.integers(1, 50))
def test_a_ramp_of_speed_does_not_depend_on_how_often_it_is_sampled(
    speed: float, target: float, acceleration: float, deceleration: float, pieces: int
) -> None:
    limits = Limits(1e9, acceleration, deceleration)
    once, often = ramped(speed, target, limits, 0.01), speed
    for _ in range(pieces):
        often = ramped(often, target, limits, 0.01 / pieces)
    assert often == pytest.approx(once, rel=1e-9, abs=1e-6)
