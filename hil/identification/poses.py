"""Windows over scheduling parameters: which poses help to estimate which, and how their offsets enter a basis. Secs. 4.3.2 and 4.3.5."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from hil.identification.errors import IdentificationError

PoseBorder = Literal["adaptive", "asymmetric"]
SAME_LEVEL = 1e-6  # of a direction's range: poses closer than this share a level
GRID_FILL = 0.5  # poses that fill less than this share of their levels' product are scattered, not a grid


@dataclass(frozen=True)
class PoseWindow:
    """Neighbours of one pose.

    Attributes
    ----------
    poses : (k,) indices, the pose itself included.
    offsets : (k, m) scheduling offsets from the pose, scaled to at most 1.
    reach : (m,) levels to either side in each direction; 0 where the window does not extend.
    """

    poses: np.ndarray
    offsets: np.ndarray
    reach: tuple[int, ...]


def varying_directions(poses: np.ndarray) -> np.ndarray:
    """(m,) columns of `poses` (n, all) that are not the same in all poses."""
    spread = np.ptp(poses, axis=0) if len(poses) else np.zeros(0)
    return np.flatnonzero(spread > SAME_LEVEL * max(np.abs(poses).max(initial=0.0), 1e-3))


def pose_windows(poses: np.ndarray, half_widths: Sequence[int], border: PoseBorder = "adaptive") -> list[PoseWindow]:
    """Window of every pose.

    On a grid, complete or not, a window takes the poses within p_i levels in each direction, (4.21). At its edges "adaptive" shrinks it
    evenly, so that the edge poses fall back on the method for one pose; "asymmetric" shifts it. Scattered poses take as many nearest ones
    as a full window would have.

    Parameters
    ----------
    poses : (n, m) scheduling parameters. half_widths : p_i per direction; none lets every pose stand alone.
    """
    n, m = poses.shape
    if len(half_widths) == 0:
        return [PoseWindow(np.array([i]), np.zeros((1, 0)), ()) for i in range(n)]
    if len(half_widths) != m:
        raise IdentificationError(f"{len(half_widths)} pose windows for {m} scheduling parameters that vary")
    levels = [_levels(poses[:, x]) for x in range(m)]
    if n < GRID_FILL * np.prod([index.max() + 1 for index in levels]):
        return _nearest(poses, half_widths)
    return [_on_grid(poses, levels, centre, half_widths, border) for centre in range(n)]


def multi_indices(orders: Sequence[int]) -> np.ndarray:
    """(k, directions) exponents of a Taylor series, (4.23) and (4.53): each at most its direction's order, together at most the largest.

    The constant is left out; pure powers of every direction are in (errata to (4.53)).
    """
    every = itertools.product(*(range(order + 1) for order in orders))
    return np.array([i for i in every if 0 < sum(i) <= max(orders, default=0)], int).reshape(-1, len(orders))


def monomials(coordinates: np.ndarray, orders: Sequence[int]) -> np.ndarray:
    """(..., directions) coordinates to (..., k) products of their powers."""
    return np.prod(coordinates[..., None, :] ** multi_indices(orders), axis=-1)


def _levels(values: np.ndarray) -> np.ndarray:
    """(n,) index of each value among the distinct ones."""
    order = np.argsort(values)
    steps = np.diff(values[order]) > SAME_LEVEL * np.ptp(values)
    index = np.empty(len(values), int)
    index[order] = np.concatenate(([0], np.cumsum(steps)))
    return index


def _on_grid(poses: np.ndarray, levels: list[np.ndarray], centre: int, half_widths: Sequence[int], border: PoseBorder) -> PoseWindow:
    inside = np.ones(len(poses), bool)
    reach = []
    for index, p in zip(levels, half_widths, strict=True):
        last, at = int(index.max()), int(index[centre])
        if border == "adaptive":
            lower, upper = at - min(p, at, last - at), at + min(p, at, last - at)
        else:
            lower = int(np.clip(at - p, 0, max(last - 2 * p, 0)))
            upper = min(lower + 2 * p, last)
        inside &= (index >= lower) & (index <= upper)
        reach.append(max(at - lower, upper - at))
    return _window(poses, centre, np.flatnonzero(inside), tuple(reach))


def _nearest(poses: np.ndarray, half_widths: Sequence[int]) -> list[PoseWindow]:
    scaled = poses / np.ptp(poses, axis=0)
    count = min(int(np.prod([2 * p + 1 for p in half_widths])), len(poses))
    windows = []
    for centre in range(len(poses)):
        distance = np.linalg.norm(scaled - scaled[centre], axis=1)
        windows.append(_window(poses, centre, np.sort(np.argsort(distance, kind="stable")[:count]), tuple(half_widths)))
    return windows


def _window(poses: np.ndarray, centre: int, members: np.ndarray, reach: tuple[int, ...]) -> PoseWindow:
    offsets = poses[members] - poses[centre]
    largest = np.abs(offsets).max(axis=0)
    return PoseWindow(members, offsets / np.where(largest > 0.0, largest, 1.0), reach)
