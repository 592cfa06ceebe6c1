"""Overlay errors, the reconstruction volume and the compensation of images against closed forms."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
from phantom_images import DETECTOR, PHANTOM, RADIUS_PIXELS, image_of, nominal
from scipy.spatial.transform import Rotation

from hil.calibration.phantom.bullets import find_bullets
from hil.calibration.use.compensation import compensated, compensation
from hil.calibration.use.lookup_table import LookUp, standing
from hil.calibration.use.roadmap import PLACES, Overlay, overlay, registered
from hil.calibration.use.volume import reconstruction_volume
from hil.errors import BadAnswerError, UnusableInputError
from hil.figures.roadmap import roadmap_figure
from hil.imaging import ConeBeam, Detector

BEAM = nominal(np.linspace(-1.2, 1.2, 20))


def deviation(**mm_or_mrad: float) -> np.ndarray:
    names = ("source_u", "source_v", "source_w", "phantom_u", "phantom_v", "phantom_w", "rotation_u", "rotation_v", "rotation_w")
    return np.tile([1e-3 * mm_or_mrad.get(name, 0.0) for name in names], (len(BEAM), 1))


def test_a_phantom_that_shifts_moves_its_shadow_by_the_magnification() -> None:
    table = overlay(BEAM, BEAM.moved(deviation(phantom_u=1.0)), DETECTOR).table
    for place in ("centre", "1/3", "2/3"):
        assert table[place]["mean"] == pytest.approx(1.16 / 0.81 * 1e-3, rel=1e-9)
        assert table[place]["max"] == pytest.approx(table[place]["mean"])


def test_a_turn_in_the_panel_grows_with_the_distance_from_the_middle() -> None:
    table = overlay(BEAM, BEAM.moved(deviation(rotation_w=1.0)), DETECTOR).table
    half = 0.5 * 0.5e-3 * np.array([640, 512])
    angles = np.arange(8) * np.pi / 4
    ring = np.mean(np.hypot(half[0] * np.cos(angles), half[1] * np.sin(angles)))
    assert table["centre"]["mean"] < 1e-12
    assert table["1/3"]["mean"] == pytest.approx(1e-3 * ring / 3.0, rel=1e-3)
    assert table["2/3"]["mean"] == pytest.approx(2e-3 * ring / 3.0, rel=1e-3)


def test_the_best_nine_tenths_leave_out_the_worst_pose() -> None:
    change = deviation(phantom_v=0.1)
    change[[3, 11]] *= 50.0
    table = overlay(BEAM, BEAM.moved(change), DETECTOR).table["centre"]
    assert table["max"] == pytest.approx(50.0 * table["max_90"], rel=1e-6)


def test_what_is_wrong_alike_in_all_poses_is_no_overlay_error_of_a_volume_made_alike() -> None:
    turn = Rotation.from_rotvec([3e-3, -2e-3, 5e-3]).as_matrix()
    other = BEAM.referred_to(np.array([2e-3, -3e-3, 1e-3]), turn)
    assert overlay(BEAM, other, DETECTOR).table["centre"]["mean"] > 1e-3
    assert overlay(BEAM, registered(BEAM, other, DETECTOR), DETECTOR).errors_m.max() < 1e-9
    rng = np.random.default_rng(1)
    noisy = other.moved(rng.normal(0.0, 1e-4, (20, 9)))
    before, after = overlay(BEAM, noisy, DETECTOR), overlay(BEAM, registered(BEAM, noisy, DETECTOR), DETECTOR)
    assert after.errors_m.mean() < 0.2 * before.errors_m.mean()


def test_the_volume_of_one_exposure_is_its_pyramid_and_of_a_turn_the_ball_it_holds() -> None:
    one = reconstruction_volume(BEAM[:1], DETECTOR)
    assert one.volume_m3 == pytest.approx(0.32 * 0.256 * 1.16 / 3.0, rel=1e-9)
    all_round = nominal(np.linspace(-np.pi, np.pi, 73))
    volume = reconstruction_volume(all_round, DETECTOR)
    narrow = 0.81 * np.sin(np.arctan(0.128 / 1.16))  # from the isocentre to the nearest side of the pyramid
    assert volume.radius_m == pytest.approx(narrow, rel=1e-9)
    assert volume.volume_m3 > 4.0 / 3.0 * np.pi * narrow**3
    points = volume.corners_m * 0.999
    on_panel = DETECTOR.to_pixels(all_round.project(points))
    assert (on_panel > -0.5).all()
    assert (on_panel < [639.5, 511.5]).all()


def test_exposures_that_share_nothing_have_no_volume() -> None:
    apart = ConeBeam.from_frames(
        np.array([[0.0, 0.0, -0.81], [2.0, 0.0, -0.81]]), np.array([[0.0, 0.0, 0.35], [2.0, 0.0, 0.35]]), np.tile(np.eye(3), (2, 1, 1))
    )
    with pytest.raises(BadAnswerError, match="no point is seen by all exposures"):
        reconstruction_volume(apart, DETECTOR)


def test_a_compensated_image_shows_the_bullets_where_they_should_be() -> None:
    wanted = nominal(np.array([0.4]))
    true = wanted.moved([[1e-3, -2e-3, 0.0, 3e-3, -2e-3, 0.0, 1e-3, 2e-3, 20e-3]])
    image = image_of(true, seed=2)
    motion = compensation(true, wanted)
    found = find_bullets(compensated(image, motion.turn_rad[0], motion.shift_m[0], DETECTOR), RADIUS_PIXELS)
    should = DETECTOR.to_pixels(wanted.project(PHANTOM.centers_m)[0])
    distance = np.linalg.norm(found.pixels[:, None] - should[None], axis=2).min(axis=1)
    was = np.linalg.norm(DETECTOR.to_pixels(true.project(PHANTOM.centers_m)[0]) - should, axis=1)
    assert was.mean() > 8.0
    assert np.median(distance) < 0.6
    assert len(distance) > 15
    assert motion.turn_rad[0] == pytest.approx(20e-3, abs=1e-3)  # the panel turned by so much, its shadows back
    stretched = Detector(columns=640, rows=512, pitch_m=0.5e-3, aspect=1.3)
    spot = np.zeros((512, 640))
    spot[256, 420] = 1.0
    place = stretched.to_metres(np.array([420.0, 256.0]))
    turned = compensated(spot, 0.3, np.array([4e-3, -6e-3]), stretched)
    row, column = np.unravel_index(np.argmax(turned), turned.shape)
    expected = stretched.to_pixels(Rotation.from_euler("z", 0.3).as_matrix()[:2, :2] @ place + [4e-3, -6e-3])
    np.testing.assert_allclose([column, row], expected, atol=1.0)


def test_a_grid_holds_the_poses_at_which_the_machine_stood() -> None:
    places = np.array([[0.0, -1.0], [0.0, 0.0], [0.5, 0.0]])
    way = np.concatenate([np.tile(places[0], (5, 1)), np.linspace(places[0], places[1], 6)[1:-1], np.tile(places[1], (4, 1))])
    way = np.concatenate([way, np.linspace(places[1], places[2], 5)[1:-1], np.tile(places[2], (3, 1))])
    rng = np.random.default_rng(3)
    positions = way + rng.normal(0.0, 1e-4, way.shape)
    notes = {"machine": "carm", "speed": [0.1, 0.2]}
    table = LookUp(("propeller", "roll"), positions, way.sum(axis=1)[:, None] * np.ones(9), np.tile(np.eye(9), (19, 1, 1)), notes)
    grid = standing(replace(table, shared=0.4 * table.covariance))
    assert grid.notes == {"machine": "carm"}, "what stands has no speed"
    np.testing.assert_allclose(grid.positions, places, atol=2e-4)
    np.testing.assert_allclose(grid.deviation[:, 0], places.sum(axis=1), atol=1e-12)
    np.testing.assert_allclose(grid.covariance[:, 0, 0], [0.4 + 0.6 / 5, 0.4 + 0.6 / 4, 0.4 + 0.6 / 3])
    with pytest.raises(UnusableInputError, match="the machine never stood"):
        standing(LookUp(("propeller", "roll"), np.linspace([0, 0], [1, 1], 9), np.zeros((9, 9)), np.zeros((9, 9, 9))))


@pytest.mark.parametrize("times", [1.0, 1.02, 1.5, 3.0, 4.9, 5.1, 20.0, 49.0, 51.0, 1e3, 1e6])
def test_numbers_on_the_figure_s_axes_do_not_overlap(times: float) -> None:
    errors = 1.7e-6 * np.tile(np.geomspace(1.0, times, 9), (len(PLACES), 1))
    figure = roadmap_figure({"nominal": Overlay(errors)}, "overlay")
    figure.canvas.draw()
    for panel in figure.axes:
        low, high = panel.get_xlim()
        shown = [label for label in panel.get_xticklabels() if low <= label.get_position()[0] <= high and label.get_text()]
        ends = [label.get_window_extent().intervalx for label in shown]
        assert len(ends) >= 2 or times < 1.5
        assert all(left[1] < right[0] for left, right in itertools.pairwise(ends)), [label.get_text() for label in shown]
