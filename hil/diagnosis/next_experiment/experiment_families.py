"""Experiments as points of a unit cube: one search runs over scans, jogs and multisines of every axis within the machine's limits."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from controllers.excitation_lines import Band
from hil.errors import ExperimentError
from hil.experiments import Experiment, Jog, JogOnly, Multisine, Scan
from hil.machine import Machine

LONGEST_s = 40.0
"""Of one recording: what a person at the bench waits for without thinking about it."""

DWELL_s = 0.5
SWEEPS = 2
PERIOD_s = 8.0
PERIODS = 2
LARGEST_LINE = 24
"""Of a jog: 3 Hz with a period of 8 s."""

SMALLEST_SHARE = 0.02
"""Of a limit, for speeds, accelerations and amplitudes."""

HIGHEST_SHARE = 0.2
"""Of the sample rate, for excited lines."""


@dataclass(frozen=True)
class Request:
    """Which family, on which axis."""

    family: str
    axis: int


class Family(Protocol):
    """One kind of experiment."""

    def dimensions(self, machine: Machine) -> int:
        """Numbers that make one."""
        ...

    def experiment(self, machine: Machine, request: Request, point: np.ndarray) -> Experiment:
        """Return the experiment of a point in the unit cube; raise ExperimentError where there is none."""
        ...


class Scans:
    """Centre and width of the way, speed, acceleration, and the other axes' pose."""

    def dimensions(self, machine: Machine) -> int:
        """Return how many numbers make one."""
        return 4 + len(machine.axes) - 1

    def experiment(self, machine: Machine, request: Request, point: np.ndarray) -> Experiment:
        """Return the experiment of a point in the unit cube; raise ExperimentError where there is none."""
        limit = machine.limits[request.axis]
        low, high = _range(machine, request.axis)
        half = 0.5 * (high - low) * _geometric(point[1], SMALLEST_SHARE, 1.0)
        centre = low + half + point[0] * (high - low - 2.0 * half)
        speed = limit.speed * _geometric(point[2], SMALLEST_SHARE, 0.95)
        if SWEEPS * 2.0 * half / speed > LONGEST_s:
            raise ExperimentError(f"scan: takes longer than {LONGEST_s:g} s")
        others = [axis for axis in range(len(machine.axes)) if axis != request.axis]
        return Scan(
            axis=machine.axes[request.axis],
            start=float(centre - half),
            stop=float(centre + half),
            speed=float(speed),
            acceleration=float(limit.acceleration * _geometric(point[3], SMALLEST_SHARE, 0.95)),
            pose=_pose(machine, others, point[4:]),
            dwell_s=DWELL_s,
            sweeps=SWEEPS,
        )


class Jogs:
    """Pose, amplitude and line of a sine."""

    def dimensions(self, machine: Machine) -> int:
        """Return how many numbers make one."""
        return 2 + len(machine.axes)

    def experiment(self, machine: Machine, request: Request, point: np.ndarray) -> Experiment:
        """Return the experiment of a point in the unit cube; raise ExperimentError where there is none."""
        jog = _jog(machine, request.axis, point[0], round(_geometric(point[1], 1.0, LARGEST_LINE)))
        pose = _pose(machine, list(range(len(machine.axes))), point[2:])
        axis = machine.axes[request.axis]
        return JogOnly(pose=pose, axes=(axis,), jog=jog, period_s=_period_s(machine), periods=PERIODS, settle_periods=1)


class Multisines:
    """Level, lower edge and width of the band, jog amplitude, and pose; the jog is on line 1."""

    def dimensions(self, machine: Machine) -> int:
        """Return how many numbers make one."""
        return 4 + len(machine.axes)

    def experiment(self, machine: Machine, request: Request, point: np.ndarray) -> Experiment:
        """Return the experiment of a point in the unit cube; raise ExperimentError where there is none."""
        drive = machine.plant.drives[request.axis]
        highest = HIGHEST_SHARE * machine.sample_rate_Hz
        low = _geometric(point[1], 2.5 / _period_s(machine), 0.5 * highest)
        high = _geometric(point[2], 1.5 * low, highest)
        return Multisine(
            pose=_pose(machine, list(range(len(machine.axes))), point[4:]),
            axes=(machine.axes[request.axis],),
            experiments="single",
            lines=Band(low, high),
            amplitude_A=float(drive.limit * _geometric(point[0], 0.005, 0.3)),
            period_s=_period_s(machine),
            periods=PERIODS,
            settle_periods=1,
            jog=_jog(machine, request.axis, point[3], 1),
        )


FAMILIES: dict[str, Family] = {"scan": Scans(), "jog": Jogs(), "multisine": Multisines()}


def requests(machine: Machine) -> list[Request]:
    """Every family on every axis that has limits."""
    axes = [k for k, limit in enumerate(machine.limits) if math.isfinite(limit.lower) and math.isfinite(limit.upper)]
    return [Request(family, axis) for axis in axes for family in FAMILIES]


def _jog(machine: Machine, axis: int, share: float, line: int) -> Jog:
    """Its amplitude between a small share of the range and what the speed limit allows on that line."""
    low, high = _range(machine, axis)
    omega = 2.0 * math.pi * line / _period_s(machine)
    limit = machine.limits[axis]
    most = min(0.5 * (high - low), limit.speed / omega, limit.acceleration / omega**2)
    return Jog(amplitude_rad=float(_geometric(share, SMALLEST_SHARE, 0.95) * most), line=line)


def _period_s(machine: Machine) -> float:
    return round(PERIOD_s * machine.sample_rate_Hz) / machine.sample_rate_Hz


def _pose(machine: Machine, axes: list[int], point: np.ndarray) -> dict[str, float]:
    pose = {}
    for axis, share in zip(axes, point, strict=True):
        low, high = _range(machine, axis)
        pose[machine.axes[axis]] = float(low + share * (high - low))
    return pose


def _range(machine: Machine, axis: int) -> tuple[float, float]:
    """Of positions, a hundredth inside the limits."""
    limit = machine.limits[axis]
    if not (math.isfinite(limit.lower) and math.isfinite(limit.upper)):
        return 0.0, 0.0
    inside = 0.01 * (limit.upper - limit.lower)
    return limit.lower + inside, limit.upper - inside


def _geometric(share: float, low: float, high: float) -> float:
    """Between two positive ends on a logarithmic scale."""
    return float(low * (high / low) ** share) if high > low else float(low)
