"""What blurs and disturbs an image: focal spot, motion, point spread, scatter, photons, dead pixels; and what the vessel scene holds."""

from __future__ import annotations

import numpy as np
import pytest

from hil.emulated.scenes import scene
from virtual_bus.xray.imaging import Optics, expected, exposed
from virtual_bus.xray.motion import FocalSpot
from virtual_bus.xray.objects import Ball, Rod
from virtual_bus.xray.render import Panel, View

PANEL = Panel(columns=301, rows=3, pitch_m=0.05e-3)
CLEAN = {"photons": 1.0, "spot_m": 0.0, "spread_m": 0.0, "scatter": 0.0, "dead": 0.0}
EDGE = [Rod(np.array([0.03, -0.3, 0.0]), np.array([0.03, 0.3, 0.0]), 0.03, 1e7)]
"""A rod so thick and dense that its edge, in the middle of the panel, is a step."""
MAGNIFIED = 1.2 / 0.8


def view(source_u_m: float = 0.0) -> View:
    """Focal spot 0.8 m before the isocentre, panel 0.4 m behind it."""
    return View(np.array([source_u_m, 0.0, -0.8]), np.array([0.0, 0.0, 0.4]), np.eye(3))


def edge_width_m(image: np.ndarray) -> float:
    """Standard deviation of the edge's profile along u."""
    slope = np.abs(np.diff(image[1]))
    u = np.arange(len(slope)) * PANEL.pitch_m
    middle = np.average(u, weights=slope)
    return np.sqrt(np.average((u - middle) ** 2, weights=slope))


def test_the_focal_spot_s_penumbra_is_its_size_magnified() -> None:
    image = expected([view()], PANEL, EDGE, Optics(**CLEAN | {"spot_m": 4e-3}))
    assert edge_width_m(image) == pytest.approx(4e-3 / 4.0 * (MAGNIFIED - 1.0), rel=0.03)  # a disc's second moment: a quarter of its size


def test_an_exposure_s_motion_is_in_its_image() -> None:
    moved = np.linspace(-1.5e-3, 1.5e-3, 4)
    image = expected([view(u) for u in moved], PANEL, EDGE, Optics(**CLEAN))
    assert edge_width_m(image) == pytest.approx(np.std(moved) * (MAGNIFIED - 1.0), rel=0.03)


def test_the_panel_s_point_spread_is_what_it_says() -> None:
    assert edge_width_m(expected([view()], PANEL, EDGE, Optics(**CLEAN | {"spread_m": 0.4e-3}))) == pytest.approx(0.4e-3, rel=0.03)


def test_scatter_is_a_share_of_the_open_beam_and_reaches_behind_what_is_dark() -> None:
    wide = Panel(columns=301, rows=241, pitch_m=1e-3)
    ball = [Ball(np.zeros(3), 2e-3, 1e5)]
    image = expected([view()], wide, ball, Optics(**CLEAN | {"photons": 1000.0, "scatter": 0.1}))
    assert image[20, 20] == pytest.approx(1100.0, rel=1e-3)
    assert image[120, 150] == pytest.approx(100.0, rel=0.03), "in the ball's shadow there is scatter alone"


def test_counts_are_poisson_s_and_dead_pixels_read_nothing_or_everything() -> None:
    image = exposed(np.full((500, 600), 400.0), Optics(dead=0.01), np.random.default_rng(1)).astype(float)
    black, white = np.mean(image == 0), np.mean(image == np.iinfo(np.uint16).max)
    assert black == pytest.approx(0.005, rel=0.1)
    assert white == pytest.approx(0.005, rel=0.1)
    counts = image[(image > 0) & (image < 60000)]
    assert counts.mean() == pytest.approx(400.0, rel=1e-3)
    assert counts.var() == pytest.approx(400.0, rel=0.02)


def test_the_focal_spot_drifts_with_the_anode_s_heat_and_wobbles_with_its_turns() -> None:
    spot = FocalSpot(np.array([8e-6, 4e-6, 0.0]), 4.0, np.array([10e-6, 0.0, 0.0]), 50.0)
    cold, warm, turned = spot.offset_m(np.array([1.0, 5.0, 1.005]), hot_since_s=1.0)
    np.testing.assert_allclose(cold, 0.0, atol=1e-12)
    np.testing.assert_allclose(warm, (1.0 - np.exp(-1.0)) * spot.heating_m, atol=1e-12)
    assert turned[0] == pytest.approx(10e-6, rel=2e-3), "a quarter of a turn"


def test_the_vessel_branches_and_has_an_aneurysm_at_its_first_branching() -> None:
    items = scene("vessel")
    branches, (aneurysm,) = [each for each in items if isinstance(each, Rod)], [each for each in items if isinstance(each, Ball)]
    trunk, *others = branches
    for branch in others:
        parents = [each for each in branches if np.array_equal(each.end_m, branch.start_m)]
        assert len(parents) == 1
        assert branch.radius_m < parents[0].radius_m
    assert aneurysm.radius_m < np.linalg.norm(aneurysm.center_m - trunk.end_m) < aneurysm.radius_m + trunk.radius_m, "beside it, and joined"
    assert aneurysm.radius_m > trunk.radius_m
    (attenuation_1_m,) = {each.attenuation_1_m for each in items}
    iodine_m2_kg = 0.758  # at 60 keV: NIST XCOM
    assert 100.0 < attenuation_1_m / iodine_m2_kg < 200.0  # kg/m^3 of iodine: contrast agents have up to 400, and blood thins them
