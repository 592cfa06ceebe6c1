"""Jerk-limited moves between standstills, by ruckig, sampled at the machine's rate."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import ruckig

from controllers.edge_units import at_the_edge
from controllers.errors import DesignError
from controllers.settings import AxisLimits

LIMIT_SLACK = 1e-9
"""Rounding of the sampled profile, relative to a limit (absolute for positions, rad or m)."""


@dataclass(frozen=True)
class Trajectory:
    """A sampled move, first row at the start's standstill, last row at the goal's.

    Attributes
    ----------
    position, velocity, acceleration : (N, n_axes) arrays
    """

    position: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray


def move(start: np.ndarray, goal: np.ndarray, limits: tuple[AxisLimits, ...], sample_rate_Hz: float) -> Trajectory:
    """Move all axes from standstill at `start` to standstill at `goal`, arriving together, within their limits.

    Parameters
    ----------
    start, goal : (n_axes,) arrays
    limits : tuple of AxisLimits
        In axis order.

    Raises
    ------
    DesignError
        Start or goal outside an axis's range, or limits that are not positive and finite.

    Examples
    --------
    >>> import numpy as np
    >>> from controllers.settings import AxisLimits
    >>> from controllers.trajectory import move
    >>> roll = AxisLimits("roll", lower=-1.0, upper=1.0, speed=0.5, acceleration=1.0, jerk=10.0, tracking_error=0.05)
    >>> moved = move(np.array([0.0]), np.array([0.5]), (roll,), 100.0)
    >>> moved.position[-1].round(6).tolist(), float(moved.velocity.max().round(6))
    ([0.5], 0.5)
    """
    start, goal = np.asarray(start, dtype=float), np.asarray(goal, dtype=float)
    for axis, limit in enumerate(limits):
        if not (0.0 < limit.speed < np.inf and 0.0 < limit.acceleration < np.inf and 0.0 < limit.jerk < np.inf):
            raise DesignError(f"{limit.axis}: a move needs limits of speed, acceleration and jerk; the machine has none")
        for name, position in (("start", start[axis]), ("goal", goal[axis])):
            if not limit.lower <= position <= limit.upper:
                asked, lower, upper = (at_the_edge(each, limit.unit) for each in (position, limit.lower, limit.upper))
                raise DesignError(f"{limit.axis}: {name} {asked} is outside the range {lower} to {upper}")
    request = ruckig.InputParameter(len(limits))
    request.current_position, request.target_position = start.tolist(), goal.tolist()
    request.max_velocity = [limit.speed for limit in limits]
    request.max_acceleration = [limit.acceleration for limit in limits]
    request.max_jerk = [limit.jerk for limit in limits]
    planned = ruckig.Trajectory(len(limits))
    try:
        ruckig.Ruckig(len(limits)).calculate(request, planned)
    except ruckig.RuckigError as error:
        raise DesignError(f"no move from {start.tolist()} to {goal.tolist()}: {error}") from None
    rows = int(np.ceil(planned.duration * sample_rate_Hz)) + 1
    sampled = np.array([planned.at_time(min(k / sample_rate_Hz, planned.duration)) for k in range(rows)])
    trajectory = Trajectory(sampled[:, 0], sampled[:, 1], sampled[:, 2])
    check_limits(trajectory, limits, sample_rate_Hz)
    return trajectory


def sweep(axis: int, start: np.ndarray, stop: float, speed: float, limits: tuple[AxisLimits, ...], sample_rate_Hz: float) -> Trajectory:
    """Move one axis from `start` to `stop` with a part at constant `speed`, the others standing still.

    Raises
    ------
    DesignError
        The speed exceeds the axis's limit, or the way is too short to reach it; the message names the way it would take.
    """
    limit = limits[axis]
    if not 0.0 < speed <= limit.speed:
        asked, most = (at_the_edge(each, f"{limit.unit}/s") for each in (speed, limit.speed))
        raise DesignError(f"{limit.axis}: sweep speed {asked} must be positive and at most {most}")
    slowed = tuple(replace(each, speed=speed if index == axis else each.speed) for index, each in enumerate(limits))
    goal = np.array(start, dtype=float)
    goal[axis] = stop
    trajectory = move(start, goal, slowed, sample_rate_Hz)
    way, needed = abs(stop - start[axis]), way_to_reach(speed, limit.acceleration, limit.jerk)
    if way < needed * (1.0 - LIMIT_SLACK):
        short = f"a way of {at_the_edge(way, limit.unit)} is too short for a speed of {at_the_edge(speed, f'{limit.unit}/s')}"
        raise DesignError(f"{limit.axis}: {short}; it takes {at_the_edge(needed, limit.unit)}")
    return trajectory


def way_to_reach(speed: float, acceleration: float, jerk: float) -> float:
    """Return the way of a symmetric move that just reaches `speed`: two jerk-limited ramps of it."""
    if speed * jerk < acceleration**2:  # full acceleration is never reached
        way: float = 2.0 * speed * np.sqrt(speed / jerk)
        return way
    return speed * (speed / acceleration + acceleration / jerk)


def check_limits(trajectory: Trajectory, limits: tuple[AxisLimits, ...], sample_rate_Hz: float) -> None:
    """Check a sampled move against its limits, the jerk by differences of the acceleration.

    Raises
    ------
    DesignError
        A limit is exceeded; the message names axis, quantity, value and limit.
    """
    slack = 1.0 + LIMIT_SLACK
    jerk = np.diff(trajectory.acceleration, axis=0) * sample_rate_Hz
    for axis, limit in enumerate(limits):
        position = trajectory.position[:, axis]
        if position.min() < limit.lower - LIMIT_SLACK or position.max() > limit.upper + LIMIT_SLACK:
            raise DesignError(f"{limit.axis}: the move leaves the range {limit.lower:.5g} to {limit.upper:.5g}")
        for name, values, most in (
            ("speed", trajectory.velocity, limit.speed),
            ("acceleration", trajectory.acceleration, limit.acceleration),
            ("jerk", jerk, limit.jerk),
        ):
            reached = float(np.abs(values[:, axis]).max(initial=0.0))
            if reached > most * slack:
                raise DesignError(f"{limit.axis}: the move reaches a {name} of {reached:.5g}, the limit is {most:.5g}")
