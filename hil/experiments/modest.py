"""Where a machine has room to move, a scan there that asks little of it, and experiments scaled to what its drives can give."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from hil.errors import ExperimentError
from hil.experiments.multisine import Multisine
from hil.experiments.plan import Plan
from hil.experiments.scan import Scan
from hil.machine import Machine

SCAN_PACE = 0.5
"""Share of the axis's speed at which it sweeps."""

SCAN_SHARE = 0.4
"""Share of the axis's range, about its pose, that the scan sweeps."""

LARGEST_SCAN_rad = np.radians(120.0)

SHARES = (1.0, 0.5, 0.25)
"""Of acceleration, speed and amplitude that a machine is asked for, one after the other, until its drives can give it."""

WAYS = (1.0, 0.75, 0.5)
"""Shares of a scan's way, about its middle, at last: beside friction and gravity a drive may have nothing left at an end of the range."""


def middle_pose(machine: Machine, room: float) -> dict[str, float]:
    """Return the pose about which a machine moves: zero, or the middle of a range that has not room about zero.

    Parameters
    ----------
    machine : Machine
    room : float
        To either side [rad or m].

    Returns
    -------
    dict
        Positions by axis [rad or m].
    """
    middle = {}
    for limit in machine.limits:
        has_room = limit.lower + room < 0.0 < limit.upper - room
        middle[limit.axis] = 0.0 if has_room else 0.5 * (limit.lower + limit.upper)
    return middle


def modest_scan(machine: Machine, axis: str, pose: Mapping[str, float]) -> Scan:
    """Return a scan of an axis about a pose [rad or m], at half its speed over two fifths of its range, 120 degrees at most.

    Where the pose is too close to an end of the range, the scan is about the closest place that is not.
    """
    limit = machine.limits[machine.axis_index(axis)]
    span = limit.upper - limit.lower
    half = 0.5 * min(LARGEST_SCAN_rad, SCAN_SHARE * span)
    speed = SCAN_PACE * limit.speed if np.isfinite(limit.speed) else Scan.speed
    at = float(np.clip(pose[axis], limit.lower + half, limit.upper - half))
    others = {name: position for name, position in pose.items() if name != axis}
    return Scan(axis, at - half, at + half, speed, others)


@dataclass(frozen=True)
class Possible:
    """A scan or a multisine as large as the machine can make it."""

    experiment: Scan | Multisine

    def plans(self, machine: Machine) -> list[Plan]:
        """Return its plans, or those of the first lesser one that is possible; raises as they do."""
        return (
            possible_scan(machine, self.experiment) if isinstance(self.experiment, Scan) else possible_multisine(machine, self.experiment)
        )


def possible_scan(machine: Machine, scan: Scan) -> list[Plan]:
    """Return the plans of a scan, or of the first lesser one that the machine can make: it lies in its ramps, its speed, at last its way.

    Raises
    ------
    ExperimentError
        Not even the least is possible; the message is that of the scan itself.
    """
    limit, axis = machine.limits[machine.axis_index(scan.axis)], scan.axis
    steepest = limit.acceleration if scan.acceleration is None else scan.acceleration
    middle, half = 0.5 * (scan.start + scan.stop), 0.5 * (scan.stop - scan.start)
    refused: ExperimentError | None = None
    for way, speed, ramp in product(WAYS, SHARES, SHARES):
        lesser = Scan(
            axis, middle - way * half, middle + way * half, speed * scan.speed, scan.pose, scan.dwell_s, scan.sweeps, ramp * steepest
        )
        try:
            return lesser.plans(machine)
        except ExperimentError as error:
            refused = refused or error
    assert refused is not None
    raise refused


def possible_multisine(machine: Machine, experiment: Multisine) -> list[Plan]:
    """Return the plans of a multisine, with a smaller amplitude where the drives cannot give the one that it has.

    Raises
    ------
    ExperimentError
        Not even the least is possible; the message is that of the multisine itself.
    """
    asked, refused = experiment.amplitude_A, None
    for share in SHARES:
        amplitude = {axis: share * each for axis, each in asked.items()} if isinstance(asked, Mapping) else share * asked
        try:
            return replace(experiment, amplitude_A=amplitude).plans(machine)
        except ExperimentError as error:
            refused = refused or error
    assert refused is not None
    raise refused
