"""A plate's projection is the length of metal on each ray, found again by walking along the rays in small steps."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hil.emulated.marker_images import steel
from hil.imaging.markers import PLATES, MarkerPlate
from virtual_bus.xray.markers import Mounted, plate_attenuation, ray_shifts
from virtual_bus.xray.render import Panel, View

PANEL = Panel(columns=40, rows=32, pitch_m=8e-3, aspect=1.02, skew=0.01)
SOURCE = np.array([3e-3, -2e-3, -1.16])
STEPS = 4000


def metal(plate: MarkerPlate, points: np.ndarray) -> np.ndarray:
    """Whether points (..., 3) of the plate's frame lie in it, by the drawing's words."""
    x, y, z = np.moveaxis(points, -1, 0)
    low = -0.5 * plate.depth_m
    solid = (np.abs(x) < plate.half_m[0]) & (np.abs(y) < plate.half_m[1]) & (z > low) & (z < low + plate.thickness_m)
    solid &= ~((np.abs(x) < plate.opening_m[0]) & (np.abs(y) < plate.opening_m[1]))
    half = 0.5 * plate.groove_m
    etched = np.zeros(x.shape, dtype=bool)
    for place in plate.x_m:
        etched |= (np.abs(x - place) < half) & (y > plate.y_reach_m[0]) & (y < plate.y_reach_m[1])
    for place in plate.y_m:
        etched |= (np.abs(y - place) < half) & (x > plate.x_reach_m[0]) & (x < plate.x_reach_m[1])
    return solid & ~(etched & (z < -low))


@pytest.mark.slow
@pytest.mark.parametrize("name", list(PLATES))
def test_a_ray_s_length_in_the_metal_is_what_walking_along_it_finds(name: str) -> None:
    plate = PLATES[name]()
    turn = Rotation.from_euler("xyz", [0.05, -0.04, 0.03]).as_matrix()
    origin = SOURCE + np.array([1e-3, 0.5e-3, 0.25])
    cast = plate_attenuation(View(SOURCE, np.zeros(3), np.eye(3)), PANEL, Mounted(steel(plate), origin, turn), rays=1)
    rows, columns = np.mgrid[: PANEL.rows, : PANEL.columns]
    down = rows - 15.5 + ray_shifts(PANEL.columns)[None, :]
    u = (columns - 19.5 + ray_shifts(PANEL.rows)[:, None] - PANEL.skew * down) * PANEL.pitch_m
    v = down * PANEL.pitch_m * PANEL.aspect
    ray = np.stack([u, v, np.zeros_like(u)], axis=-1) - SOURCE
    share = np.linspace(0.20, 0.23, STEPS)
    walked = np.zeros(u.shape)
    for part in share:
        walked += metal(plate, (SOURCE + part * ray - origin) @ turn)
    walked *= (share[1] - share[0]) * np.linalg.norm(ray, axis=-1)
    step = 0.03 * 1.2 / STEPS
    np.testing.assert_allclose(cast / steel(plate).attenuation_1_m, walked, atol=4.0 * step)
    assert cast.max() > 1.5
    assert cast.min() < 1.2
