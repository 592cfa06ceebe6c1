"""Windows over scheduling parameters: which poses help to estimate which, and how their offsets enter a basis. Secs. 4.3.2 and 4.3.5."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from hil.errors import IdentificationError
from hil.identification.local.monomials import symmetric_monomials

PoseBorder = Literal["adaptive", "asymmetric"]
SAME_LEVEL = 1e-6  # of a direction's range: poses closer than this share a level
GRID_FILL = 0.5  # poses that fill less than this share of their levels' product are scattered, not a grid


@dataclass(frozen=True)
class PoseSymmetry:
    """Poses along one scheduling parameter at which a machine responds alike; every channel keeps its sign.

    Attributes
    ----------
    mirrors : values m [rad or m] with G(2 m - theta) = G(theta). period : T with G(theta + T) = G(theta), or None.
    """

    mirrors: tuple[float, ...] = ()
    period: float | None = None

    def images(self, values: np.ndarray) -> np.ndarray:
        """Return the values themselves first, then those that respond like them, within one turn: (n,) to (n, i)."""
        shifts = () if self.period is None else (values + self.period, values - self.period)
        return np.stack((values, *(2.0 * m - values for m in self.mirrors), *shifts), axis=1)


NO_SYMMETRY = PoseSymmetry()


@dataclass(frozen=True)
class PoseWindow:
    """Neighbours of one pose.

    Attributes
    ----------
    poses : (k,) indices, the pose itself included.
    offsets : (k, i, m) scheduling offsets from the pose, scaled to at most 1, of every place in the window at which a neighbour's response
        is expected: its own, and its images under a symmetry. NaN where there are fewer than i.
    reach : (m,) levels to either side in each direction; 0 where the window does not extend.
    centre : which of `poses` it is.
    """

    poses: np.ndarray
    offsets: np.ndarray
    reach: tuple[int, ...]
    centre: int

    def coordinates(self, psi: np.ndarray, records: int) -> tuple[np.ndarray, np.ndarray]:
        """Return offsets of line and scheduling parameters for every row of the windows, psi (B, n) over frequency.

        There are `records` at each pose.

        Returns
        -------
        coordinates : (B, poses records n, i, 1 + m). centre : (i, 1 + m).
        """
        k, i, m = self.offsets.shape
        made = np.empty((len(psi), k, records, psi.shape[1], i, 1 + m))
        made[..., 0] = psi[:, None, None, :, None]
        made[..., 1:] = self.offsets[None, :, None, None, :, :]
        centre = np.concatenate((np.zeros((i, 1)), self.offsets[self.centre]), axis=1)
        return made.reshape(len(psi), -1, i, 1 + m), centre

    def weights(self, orders: Sequence[int]) -> np.ndarray:
        """Return the weights (k,) with which a least-squares polynomial over the poses gives its value at the centre."""
        basis = symmetric_monomials(self.offsets, self.offsets[self.centre], orders)
        at_centre: np.ndarray = np.linalg.pinv(np.concatenate((np.ones((len(basis), 1)), basis), axis=1))[0]
        return at_centre


def varying_directions(poses: np.ndarray) -> np.ndarray:
    """Return the columns (m,) of `poses` (n, all) that are not the same in all poses."""
    spread = np.ptp(poses, axis=0) if len(poses) else np.zeros(0)
    return np.flatnonzero(spread > SAME_LEVEL * max(np.abs(poses).max(initial=0.0), 1e-3))


def pose_windows(
    poses: np.ndarray, half_widths: Sequence[int], border: PoseBorder = "adaptive", symmetry: Sequence[PoseSymmetry] = ()
) -> list[PoseWindow]:
    """Return the window of every pose.

    On a grid, complete or not, a window takes the poses within p_i levels in each direction, (4.21). At its edges "adaptive" shrinks it
    evenly, so that the edge poses fall back on the method for one pose; "asymmetric" shifts it. With a symmetry the grid goes on with
    images, and its edge lies further out. Scattered poses take as many nearest ones as a full window would have.

    Parameters
    ----------
    poses : (n, m) scheduling parameters. half_widths : p_i per direction; none lets every pose stand alone.
    symmetry : one per direction, or none.
    """
    n, m = poses.shape
    if len(half_widths) == 0:
        return [PoseWindow(np.array([i]), np.zeros((1, 1, 0)), (), 0) for i in range(n)]
    if len(half_widths) != m:
        raise IdentificationError(f"{len(half_widths)} pose windows for {m} scheduling parameters that vary")
    if len(symmetry) not in (0, m):
        raise IdentificationError(f"{len(symmetry)} symmetries for {m} scheduling parameters that vary")
    along = [(each or NO_SYMMETRY).images(poses[:, x]) for x, each in enumerate(symmetry or (NO_SYMMETRY,) * m)]
    images = np.stack([np.stack(each, axis=1) for each in itertools.product(*(list(values.T) for values in along))], axis=1)  # (n, i, m)
    levels = [_levels(poses[:, x]) for x in range(m)]
    if n < GRID_FILL * np.prod([index.max() + 1 for index in levels]):
        return _nearest(poses, images, half_widths)
    extended = np.stack([_levels(images[:, :, x].ravel()).reshape(images.shape[:2]) for x in range(m)], axis=2)
    return [_on_grid(poses, images, extended, centre, half_widths, border) for centre in range(n)]


def _levels(values: np.ndarray) -> np.ndarray:
    """Return the index (n,) of each value among the distinct ones."""
    order = np.argsort(values)
    steps = np.diff(values[order]) > SAME_LEVEL * np.ptp(values)
    index = np.empty(len(values), int)
    index[order] = np.concatenate(([0], np.cumsum(steps)))
    return index


def _on_grid(
    poses: np.ndarray, images: np.ndarray, levels: np.ndarray, centre: int, half_widths: Sequence[int], border: PoseBorder
) -> PoseWindow:
    inside = np.ones(images.shape[:2], bool)
    reach = []
    for x, p in enumerate(half_widths):
        index = levels[:, :, x]
        last, at = int(index.max()), int(index[centre, 0])
        if border == "adaptive":
            lower, upper = at - min(p, at, last - at), at + min(p, at, last - at)
        else:
            lower = int(np.clip(at - p, 0, max(last - 2 * p, 0)))
            upper = min(lower + 2 * p, last)
        inside &= (index >= lower) & (index <= upper)
        reach.append(max(at - lower, upper - at))
    return _window(poses, images, centre, inside, tuple(reach))


def _nearest(poses: np.ndarray, images: np.ndarray, half_widths: Sequence[int]) -> list[PoseWindow]:
    scale = np.ptp(poses, axis=0)
    count = min(int(np.prod([2 * p + 1 for p in half_widths])), len(poses))
    windows = []
    for centre in range(len(poses)):
        distance = np.linalg.norm((images - poses[centre]) / scale, axis=2)
        members = np.argsort(distance.min(axis=1), kind="stable")[:count]
        near = distance <= distance.min(axis=1)[members].max() * (1.0 + SAME_LEVEL)
        windows.append(_window(poses, images, centre, near, tuple(half_widths)))
    return windows


def _window(poses: np.ndarray, images: np.ndarray, centre: int, inside: np.ndarray, reach: tuple[int, ...]) -> PoseWindow:
    """Return the window of the poses with an image inside (n, i); places that coincide count once."""
    members = np.flatnonzero(inside.any(axis=1))
    offsets = np.where(inside[:, :, None], images - poses[centre], np.nan)[members]
    largest = np.nanmax(np.abs(offsets), axis=(0, 1))
    offsets = offsets / np.where(largest > 0.0, largest, 1.0)
    packed = np.full_like(offsets, np.nan)
    for row, places in enumerate(offsets):
        present = places[~np.isnan(places).any(axis=1)]
        different = present[
            [not any(np.abs(present[i] - earlier).max() < SAME_LEVEL for earlier in present[:i]) for i in range(len(present))]
        ]
        packed[row, : len(different)] = different
    return PoseWindow(members, packed[:, ~np.isnan(packed).all(axis=(0, 2))], reach, int(np.flatnonzero(members == centre)[0]))
