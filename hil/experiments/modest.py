"""Where a machine has room to move, and a scan there that asks little of it."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from hil.experiments.scan import Scan
from hil.machine import Machine

SCAN_PACE = 0.5
"""Share of the axis's speed at which it sweeps."""

SCAN_SHARE = 0.4
"""Share of the axis's range, about its pose, that the scan sweeps."""

LARGEST_SCAN_rad = np.radians(120.0)


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
