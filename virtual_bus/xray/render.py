"""Line integrals of attenuation over a panel: exact lengths of rays inside objects, several rays a pixel."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit

from virtual_bus.xray.objects import Item, packed, packed_bodies

MARGIN_PIXELS = 1.0
"""Added around an item's shadow before its rays are cast: a ball's shadow is an ellipse a little larger than its centre's ray suggests."""


@dataclass(frozen=True)
class Panel:
    """The flat panel: columns grow with u, rows with v from the first stored value on.

    The middle of the image is the panel's centre.
    """

    columns: int
    rows: int
    pitch_m: float
    aspect: float = 1.0  # row pitch over column pitch
    skew: float = 0.0  # columns of shift to the right for each row


@dataclass(frozen=True)
class View:
    """Positions of focal spot and panel in the frame of the scene."""

    source_m: np.ndarray  # (3,)
    panel_m: np.ndarray  # (3,) its centre
    panel_rotation: np.ndarray  # (3, 3) u, v, w as columns


def attenuation(view: View, panel: Panel, items: Sequence[Item], rays: int = 3) -> np.ndarray:
    """Integrate the attenuation along rays.

    Parameters
    ----------
    view : View
    panel : Panel
    items : sequence of Item
    rays : int
        Rays in a row and in a column of each pixel, evenly spread.

    Returns
    -------
    (rows * rays, columns * rays) array
        Sum of attenuation times length, dimensionless.
    """
    result = np.zeros((panel.rows * rays, panel.columns * rays))
    _cast(
        packed(items),
        np.asarray(view.source_m, dtype=float),
        np.asarray(view.panel_m, dtype=float),
        np.ascontiguousarray(view.panel_rotation, dtype=float),
        panel.pitch_m,
        panel.aspect,
        panel.skew,
        rays,
        result,
    )
    bodies = packed_bodies(items)
    if len(bodies):
        source, center, rotation = (np.ascontiguousarray(each, dtype=float) for each in (view.source_m, view.panel_m, view.panel_rotation))
        _cast_bodies(bodies, source, center, rotation, panel.pitch_m / rays, panel.aspect, panel.skew, result)
    return result


def transmission(view: View, panel: Panel, items: Sequence[Item], rays: int = 3) -> np.ndarray:
    """Return the share (rows, columns) of photons that reach each pixel: the mean over its rays of exp(-attenuation)."""
    result = np.empty((panel.rows, panel.columns))
    mean_through(attenuation(view, panel, items, rays), rays, result)
    return result


@njit(cache=True, error_model="numpy")
def mean_through(integrals: np.ndarray, rays: int, result: np.ndarray) -> None:
    """Fill (rows, columns) with the mean over each pixel's rays of exp(-integral)."""
    rows, columns = result.shape
    for row in range(rows):
        for column in range(columns):
            through = 0.0
            for i in range(row * rays, (row + 1) * rays):
                for j in range(column * rays, (column + 1) * rays):
                    integral = integrals[i, j]
                    through += 1.0 if integral == 0.0 else np.exp(-integral)
            result[row, column] = through / rays**2


@njit(cache=True, error_model="numpy")
def _cast(
    items: np.ndarray, source: np.ndarray, center: np.ndarray, rotation: np.ndarray, pitch: float, aspect: float, skew: float, rays: int,
    result: np.ndarray,
) -> None:  # fmt: skip
    rows, columns = result.shape
    local_source = rotation.T @ (source - center)
    step = pitch / rays
    for k in range(items.shape[0]):
        radius = items[k, 6]
        start = rotation.T @ (items[k, :3] - center)
        end = rotation.T @ (items[k, 3:6] - center)
        low_u, high_u, low_v, high_v = np.inf, -np.inf, np.inf, -np.inf
        for tip in (start, end):
            share = local_source[2] / (local_source[2] - tip[2])
            reach = radius * abs(share) * 1.5 + MARGIN_PIXELS * pitch
            u = local_source[0] + (tip[0] - local_source[0]) * share
            v = local_source[1] + (tip[1] - local_source[1]) * share
            low_u, high_u = min(low_u, u - reach), max(high_u, u + reach)
            low_v, high_v = min(low_v, v - reach), max(high_v, v + reach)
        axis = end - start
        length = np.sqrt(np.sum(axis**2))
        middle_row, middle_column = (rows - 1) / 2.0, (columns - 1) / 2.0
        first_row = max(0, int(np.floor(low_v / (step * aspect) + middle_row)))
        last_row = min(rows - 1, int(np.ceil(high_v / (step * aspect) + middle_row)))
        for row in range(first_row, last_row + 1):
            v = (row - middle_row) * step * aspect
            shift = skew * (row - middle_row)
            left, right = low_u, high_u
            if length > 0.0 and high_v - low_v > 4.0 * pitch:  # a long rod: only the rays near its shadow's line
                left, right = _near(start, end, radius, local_source, v, pitch, low_u, high_u)
            first = max(0, int(np.floor(left / step + middle_column + shift)))
            last = min(columns - 1, int(np.ceil(right / step + middle_column + shift)))
            for column in range(first, last + 1):
                u = (column - middle_column - shift) * step
                inside = _inside(local_source, u, v, start, axis, length, radius)
                result[row, column] += items[k, 7] * inside


@njit(cache=True, error_model="numpy")
def _cast_bodies(
    bodies: np.ndarray, source: np.ndarray, center: np.ndarray, rotation: np.ndarray, step: float, aspect: float, skew: float,
    result: np.ndarray,
) -> None:  # fmt: skip
    """Add attenuation times length of every ray inside large bodies; all in the scene's frame, `step` is the distance of rays."""
    rows, columns = result.shape
    middle_row, middle_column = (rows - 1) / 2.0, (columns - 1) / 2.0
    ray = np.empty(3)
    for row in range(rows):
        v = (row - middle_row) * step * aspect
        for column in range(columns):
            u = (column - middle_column - skew * (row - middle_row)) * step
            squared = 0.0
            for i in range(3):
                ray[i] = center[i] + u * rotation[i, 0] + v * rotation[i, 1] - source[i]
                squared += ray[i] * ray[i]
            total = 0.0
            for k in range(bodies.shape[0]):
                if bodies[k, 7] == 0.0:
                    enter, leave = 0.0, np.inf
                    for i in range(3):
                        near, far = (bodies[k, i] - source[i]) / ray[i], (bodies[k, i + 3] - source[i]) / ray[i]
                        enter, leave = max(enter, min(near, far)), min(leave, max(near, far))
                    inside = leave - enter
                else:  # scaled to a unit ball: shares of the ray stay what they are
                    a = b = 0.0
                    c = -1.0
                    for i in range(3):
                        half, middle = 0.5 * (bodies[k, i + 3] - bodies[k, i]), 0.5 * (bodies[k, i + 3] + bodies[k, i])
                        along, start = ray[i] / half, (source[i] - middle) / half
                        a += along * along
                        b += along * start
                        c += start * start
                    root = b * b - a * c
                    inside = 2.0 * np.sqrt(root) / a if root > 0.0 else 0.0
                if inside > 0.0:
                    total += bodies[k, 6] * inside
            result[row, column] += total * np.sqrt(squared)


@njit(cache=True, error_model="numpy")
def _near(
    start: np.ndarray, end: np.ndarray, radius: float, source: np.ndarray, v: float, pitch: float, low_u: float, high_u: float
) -> tuple[float, float]:
    """Return the range of u in which rays through row v may meet the rod."""
    share_0 = source[2] / (source[2] - start[2])
    share_1 = source[2] / (source[2] - end[2])
    u0, v0 = source[0] + (start[0] - source[0]) * share_0, source[1] + (start[1] - source[1]) * share_0
    u1, v1 = source[0] + (end[0] - source[0]) * share_1, source[1] + (end[1] - source[1]) * share_1
    reach = 1.5 * radius * max(abs(share_0), abs(share_1)) + MARGIN_PIXELS * pitch
    run, rise = u1 - u0, v1 - v0
    along = np.hypot(run, rise)
    if abs(rise) < 0.02 * along:
        return low_u, high_u
    middle = u0 + (v - v0) * run / rise
    half = reach * along / abs(rise)
    return max(low_u, middle - half), min(high_u, middle + half)


@njit(cache=True, error_model="numpy")
def _inside(source: np.ndarray, u: float, v: float, start: np.ndarray, axis: np.ndarray, length: float, radius: float) -> float:
    """Return the length of the ray from the source to (u, v, 0) inside a ball (length 0) or a rod with flat ends."""
    x, y, z = u - source[0], v - source[1], -source[2]  # numbers, not arrays: this is the innermost loop
    norm = np.sqrt(x * x + y * y + z * z)
    x, y, z = x / norm, y / norm, z / norm
    from_x, from_y, from_z = source[0] - start[0], source[1] - start[1], source[2] - start[2]
    if length == 0.0:
        along = x * from_x + y * from_y + z * from_z
        rest = radius**2 - (from_x**2 + from_y**2 + from_z**2 - along**2)
        return 2.0 * np.sqrt(rest) if rest > 0.0 else 0.0
    unit_x, unit_y, unit_z = axis[0] / length, axis[1] / length, axis[2] / length
    ray_along, offset_along = x * unit_x + y * unit_y + z * unit_z, from_x * unit_x + from_y * unit_y + from_z * unit_z
    x, y, z = x - ray_along * unit_x, y - ray_along * unit_y, z - ray_along * unit_z  # across the rod from here on
    from_x, from_y, from_z = from_x - offset_along * unit_x, from_y - offset_along * unit_y, from_z - offset_along * unit_z
    a = x * x + y * y + z * z
    b = x * from_x + y * from_y + z * from_z
    c = from_x**2 + from_y**2 + from_z**2 - radius**2
    if a < 1e-18:  # along the rod's axis
        low, high = (-np.inf, np.inf) if c < 0.0 else (0.0, 0.0)
    else:
        root = b * b - a * c
        if root <= 0.0:
            return 0.0
        low, high = (-b - np.sqrt(root)) / a, (-b + np.sqrt(root)) / a
    if abs(ray_along) > 1e-15:
        first, second = -offset_along / ray_along, (length - offset_along) / ray_along
        low, high = max(low, min(first, second)), min(high, max(first, second))
    elif offset_along < 0.0 or offset_along > length:
        return 0.0
    return max(0.0, high - low)
