"""Projections of balls and rods: lengths in closed form, volumes, and RTK's projections of the same balls."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from virtual_bus.xray.objects import Ball, Ellipsoid, Rod, Slab
from virtual_bus.xray.render import Panel, View, attenuation, transmission

PANEL = Panel(columns=201, rows=161, pitch_m=0.5e-3)
STRAIGHT = View(np.array([0.0, 0.0, -0.8]), np.array([0.0, 0.0, 0.4]), np.eye(3))


def test_the_ray_through_the_middle_of_a_ball_is_its_diameter_long() -> None:
    image = attenuation(STRAIGHT, PANEL, [Ball(np.zeros(3), 0.01, 50.0)], rays=1)
    assert image[80, 100] == pytest.approx(50.0 * 0.02, rel=1e-12)
    assert image[80, 100] == image.max()
    assert image[0, 0] == 0.0


def test_a_ball_s_image_holds_its_volume() -> None:
    ball = Ball(np.array([0.01, -0.005, 0.02]), 0.004, 1.0)
    image = attenuation(STRAIGHT, PANEL, [ball], rays=5)
    magnification = 1.2 / 0.82
    volume = image.sum() * (0.1e-3 / magnification) ** 2
    assert volume == pytest.approx(4.0 / 3.0 * np.pi * 0.004**3, rel=2e-3)  # rays are slightly oblique


@pytest.mark.parametrize("tilt", [0.0, 0.3, 1.0])
def test_a_ray_across_a_tilted_rod_is_as_long_as_the_tilt_says(tilt: float) -> None:
    direction = np.array([0.0, np.cos(tilt), np.sin(tilt)])
    rod = Rod(-0.05 * direction, 0.05 * direction, 0.002, 1.0)
    image = attenuation(STRAIGHT, PANEL, [rod], rays=1)
    assert image[80, 100] == pytest.approx(0.004 / np.cos(tilt), rel=1e-12)


def test_a_ray_along_a_rod_is_the_rod_s_length() -> None:
    rod = Rod(np.array([0.0, 0.0, -0.03]), np.array([0.0, 0.0, 0.05]), 0.002, 1.0)
    assert attenuation(STRAIGHT, PANEL, [rod], rays=1)[80, 100] == pytest.approx(0.08, rel=1e-12)


def test_an_ellipsoid_with_equal_axes_is_a_ball_wherever_the_panel_stands() -> None:
    turned = Rotation.from_euler("xyz", [0.4, -0.7, 0.2]).as_matrix()
    view = View(turned @ STRAIGHT.source_m, turned @ STRAIGHT.panel_m, turned)
    center = np.array([0.004, -0.003, 0.01])
    ball = attenuation(view, PANEL, [Ball(center, 0.012, 20.0)], rays=2)
    np.testing.assert_allclose(attenuation(view, PANEL, [Ellipsoid(center, np.full(3, 0.012), 20.0)], rays=2), ball, atol=1e-9)


def test_an_ellipsoid_s_image_holds_its_volume_and_a_shell_is_the_difference_of_two() -> None:
    half = np.array([0.02, 0.012, 0.008])
    image = attenuation(STRAIGHT, PANEL, [Ellipsoid(np.zeros(3), half, 1.0)], rays=3)
    volume = image.sum() * (0.5e-3 / 3 / 1.5) ** 2  # the panel is 1.5 times as far as the middle
    assert volume == pytest.approx(4.0 / 3.0 * np.pi * half.prod(), rel=5e-3)
    shell = attenuation(STRAIGHT, PANEL, [Ellipsoid(np.zeros(3), half, 1.0), Ellipsoid(np.zeros(3), 0.9 * half, -1.0)], rays=3)
    assert shell.sum() == pytest.approx((1.0 - 0.9**3) * image.sum(), rel=5e-3)
    assert shell[241, 301] == pytest.approx(2.0 * 0.1 * half[2], rel=1e-9)


def test_a_slab_across_the_beam_is_its_thickness_over_the_cosine() -> None:
    slab = Slab(np.array([-1.0, -1.0, -0.01]), np.array([1.0, 1.0, 0.02]), 7.0)
    image = attenuation(STRAIGHT, PANEL, [slab], rays=1)
    assert image[80, 100] == pytest.approx(7.0 * 0.03, rel=1e-12)
    corner = np.array([50e-3, 40e-3, 1.2])
    assert image[160, 200] == pytest.approx(7.0 * 0.03 * np.linalg.norm(corner) / 1.2, rel=1e-12)


@pytest.mark.slow
def test_a_rod_s_image_does_not_depend_on_which_rays_were_left_out() -> None:
    rng = np.random.default_rng(3)
    for _ in range(20):
        ends = rng.uniform(-0.04, 0.04, (2, 3))
        rod = Rod(ends[0], ends[1], 0.001, 1.0)
        image = attenuation(STRAIGHT, PANEL, [rod], rays=1)
        # points along the rod, a little beyond its ends too, where they fall on the panel, and their neighbourhood: inside and just outside
        along = ends[0] + rng.uniform(-0.05, 1.05, (30, 1)) * (ends[1] - ends[0])
        seen = along[:, :2] * 1.2 / (along[:, 2:] + 0.8) / 0.5e-3 + rng.uniform(-4.0, 4.0, (30, 2))
        for row, column in np.clip(np.rint(seen[:, ::-1] + [80, 100]), 0, [160, 200]).astype(int):
            pixel = np.array([(column - 100) * 0.5e-3, (row - 80) * 0.5e-3, 0.4])
            assert image[row, column] == pytest.approx(length_by_sampling(rod, STRAIGHT.source_m, pixel), abs=3e-5)


def length_by_sampling(rod: Rod, source: np.ndarray, pixel: np.ndarray, count: int = 40001) -> float:
    points = source + np.linspace(0.55, 0.75, count)[:, None] * (pixel - source)  # the part near the isocentre
    axis = rod.end_m - rod.start_m
    along = (points - rod.start_m) @ axis / (axis @ axis)
    away = np.linalg.norm(points - rod.start_m - along[:, None] * axis, axis=1)
    return np.mean((along >= 0) & (along <= 1) & (away <= rod.radius_m)) * 0.2 * np.linalg.norm(pixel - source)


def test_transmission_of_nothing_is_one_and_of_a_thick_ball_nearly_none() -> None:
    image = transmission(STRAIGHT, PANEL, [Ball(np.zeros(3), 0.01, 900.0)])
    assert image[0, 0] == 1.0
    assert image[80, 100] < 1e-7
