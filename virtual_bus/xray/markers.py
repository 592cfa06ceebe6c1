"""Marker plates in the beam: metal with etched grooves and an opening, as boxes in which a ray's length is exact."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit

from virtual_bus.xray.imaging import Optics, from_the_spot, read_out
from virtual_bus.xray.objects import Item
from virtual_bus.xray.render import Panel, View, attenuation, mean_through


@dataclass(frozen=True)
class Plate:
    """A plate in a frame of its own: x and y in its plane, z along the beam, z = 0 in the middle of the grooves' depth.

    Attributes
    ----------
    half_m : (2,) array
        Half its size in x and y.
    opening_m : (2,) array
        Half the size of the opening in its middle; zeros: none.
    thickness_m, depth_m : float
        Of the metal, and of the grooves in its side towards the source.
    across_x, across_y : (n, 4) arrays
        Grooves [low x, high x, low y, high y]: `across_x` are narrow in x, `across_y` in y. No two of a kind overlap.
    attenuation_1_m : float
    """

    half_m: np.ndarray
    opening_m: np.ndarray
    thickness_m: float
    depth_m: float
    across_x: np.ndarray
    across_y: np.ndarray
    attenuation_1_m: float

    def boxes(self) -> np.ndarray:
        """Return rows [low 3, high 3, attenuation] (n, 7) whose sum is the plate.

        Where two grooves cross, the overlap is taken away once only.
        """
        floor, roof = -0.5 * self.depth_m, self.thickness_m - 0.5 * self.depth_m
        (x, y), mu = self.half_m, self.attenuation_1_m
        rows = [[-x, -y, floor, x, y, roof, mu]]
        if self.opening_m.all():
            a, b = self.opening_m
            rows.append([-a, -b, floor, a, b, roof, -mu])
        for groove in (*self.across_x, *self.across_y):
            rows.append([groove[0], groove[2], floor, groove[1], groove[3], -floor, -mu])
        for one in self.across_x:
            for other in self.across_y:
                low, high = np.maximum(one[[0, 2]], other[[0, 2]]), np.minimum(one[[1, 3]], other[[1, 3]])
                if (low < high).all():
                    rows.append([*low, floor, *high, -floor, mu])
        return np.array(rows)


@dataclass(frozen=True)
class Mounted:
    """A plate and its pose: origin (3,) and orientation (3, 3) of its frame in the frame of the scene."""

    plate: Plate
    origin_m: np.ndarray
    rotation: np.ndarray


GOLDEN = 0.5 * (np.sqrt(5.0) - 1.0)


def ray_shifts(count: int) -> np.ndarray:
    """Return the shifts (count,) of the rays of each row along u, and of each column along v, in distances of rays.

    They lie between -1/2 and 1/2. On a square grid, an edge along the grid would be rounded to the next ray over its whole length;
    with shifts that fill the gap evenly its place is right on average over a few rows.
    """
    shifts: np.ndarray = (0.5 + GOLDEN * np.arange(count)) % 1.0 - 0.5
    return shifts


def plate_attenuation(view: View, panel: Panel, mounted: Mounted, rays: int = 3) -> np.ndarray:
    """Return attenuation times length (rows * rays, columns * rays) of every ray inside the plate."""
    to_plate = mounted.rotation.T
    result = np.zeros((panel.rows * rays, panel.columns * rays))
    _cast_boxes(
        mounted.plate.boxes(),
        np.ascontiguousarray(to_plate @ (view.source_m - mounted.origin_m)),
        np.ascontiguousarray(to_plate @ (view.panel_m - mounted.origin_m)),
        np.ascontiguousarray(to_plate @ view.panel_rotation),
        panel.pitch_m / rays,
        panel.aspect,
        panel.skew,
        ray_shifts(panel.rows * rays),
        ray_shifts(panel.columns * rays),
        result,
    )
    return result


def expected_with_plate(
    views: Sequence[View], panel: Panel, mounted: Sequence[Mounted], optics: Optics, items: Sequence[Item] = (), rays: int = 3
) -> np.ndarray:
    """Return the expected photons (rows, columns) behind a plate and whatever else stands in the beam.

    `mounted` is the plate's pose at each view. There are no dead pixels.
    """
    total = np.zeros((panel.rows, panel.columns))
    shares = np.empty_like(total)
    for k, moved, share in from_the_spot(views, optics):
        integrals = plate_attenuation(moved, panel, mounted[k], rays)
        if items:
            integrals += attenuation(moved, panel, items, rays)
        mean_through(integrals, rays, shares)
        total += share * shares
    return read_out(total, panel, optics)


@njit(cache=True, error_model="numpy")
def _cast_boxes(
    boxes: np.ndarray, source: np.ndarray, center: np.ndarray, rotation: np.ndarray, step: float, aspect: float, skew: float,
    along_u: np.ndarray, along_v: np.ndarray, result: np.ndarray,
) -> None:  # fmt: skip
    """Add attenuation times length of every ray inside the boxes to `result`.

    Source, panel centre and panel axes (columns of `rotation`) are in the plate's frame; `step` is the distance of rays.
    """
    rows, columns = result.shape
    middle_row, middle_column = (rows - 1) / 2.0, (columns - 1) / 2.0
    normal = rotation[:, 2]
    depth = np.sum((center - source) * normal)
    for k in range(boxes.shape[0]):
        first_row, last_row, first_column, last_column = rows, -1, columns, -1
        for corner in range(8):
            tip = np.array([boxes[k, 3 * (corner >> i & 1) + i] for i in range(3)])
            share = depth / np.sum((tip - source) * normal)
            seen = source + (tip - source) * share - center
            row = np.sum(seen * rotation[:, 1]) / (step * aspect) + middle_row
            column = np.sum(seen * rotation[:, 0]) / step + middle_column + skew * (row - middle_row)
            first_row, last_row = min(first_row, int(np.floor(row))), max(last_row, int(np.ceil(row)))
            first_column, last_column = min(first_column, int(np.floor(column))), max(last_column, int(np.ceil(column)))
        for row in range(max(0, first_row - 1), min(rows - 1, last_row + 1) + 1):
            for column in range(max(0, first_column - 1), min(columns - 1, last_column + 1) + 1):
                down = row - middle_row + along_v[column]
                u = (column - middle_column + along_u[row] - skew * down) * step
                v = down * step * aspect
                enter, leave, squared = 0.0, np.inf, 0.0
                for i in range(3):
                    way = center[i] + u * rotation[i, 0] + v * rotation[i, 1] - source[i]
                    squared += way * way
                    near, far = (boxes[k, i] - source[i]) / way, (boxes[k, i + 3] - source[i]) / way
                    enter, leave = max(enter, min(near, far)), min(leave, max(near, far))
                if leave > enter:
                    result[row, column] += boxes[k, 6] * (leave - enter) * np.sqrt(squared)
