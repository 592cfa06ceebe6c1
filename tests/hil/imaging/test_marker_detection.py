"""Crossings of a marker plate are found to the stated fractions of a pixel, and lines that are none of the plate's are refused."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from marker_images import DETECTOR, NOMINAL, TRUE, image, mean_image, optics, truth
from scipy.spatial.transform import Rotation
from scipy.special import erf

from hil.emulated.anatomy import with_patient
from hil.emulated.beam import Beam
from hil.emulated.marker_images import steel
from hil.errors import UnusableInputError
from hil.imaging.markers import PLATES, MarkerProjection, experimental_plate, find_marker
from hil.imaging.markers.canny_hough import coarse_points
from hil.imaging.markers.hybrid_median import hybrid_median
from hil.imaging.markers.pieces import fit_pieces, profiles
from virtual_bus.xray.imaging import exposed
from virtual_bus.xray.markers import Mounted, expected_with_plate
from virtual_bus.xray.render import Panel, View


@pytest.mark.slow
@pytest.mark.parametrize(("photons", "limit"), [(2000.0, 0.03), (200.0, 0.15)])
@pytest.mark.parametrize("plate", ["experimental", "clinical"])
def test_crossings_are_found_to_the_stated_accuracy(plate: str, photons: float, limit: float) -> None:
    found = find_marker(image(plate, photons, 1), PLATES[plate](), NOMINAL, DETECTOR)
    assert len(found.index) == len(truth(plate))
    assert not found.refused
    error = found.pixels - truth(plate)[found.index]
    assert np.sqrt(np.mean(error**2)) < limit


def test_the_profile_s_fit_is_more_than_twice_as_close_as_edges_alone() -> None:
    plate = experimental_plate()
    fine = find_marker(image("experimental", 2000.0, 2), plate, NOMINAL, DETECTOR)
    coarse = coarse_points(image("experimental", 2000.0, 2), plate, NOMINAL, DETECTOR)
    fine_rms, coarse_rms = (np.sqrt(np.mean((each.pixels - truth("experimental")[each.index]) ** 2)) for each in (fine, coarse))
    assert len(coarse.index) == 99
    assert 2.0 * fine_rms < coarse_rms < 0.1


@pytest.mark.slow
def test_lines_are_scattered_as_their_covariance_says() -> None:
    plate = experimental_plate()
    standard = []
    for seed in range(16):
        found = find_marker(image("experimental", 200.0, 10 + seed), plate, NOMINAL, DETECTOR)
        error = (found.pixels - truth("experimental")[found.index]).ravel()
        values, vectors = np.linalg.eigh(found.covariance)
        seen = values > 1e-9 * values.max()
        assert seen.sum() == 40  # 20 lines of two parameters
        standard.append(np.mean((vectors[:, seen].T @ error) ** 2 / values[seen]))
    assert 0.8 < np.mean(standard) < 1.25, standard


def bent(mean: np.ndarray) -> np.ndarray:
    """The sixth groove along y, 0.6 pixel beside its place."""
    column = round(truth("experimental")[5 * 9 : 6 * 9, 0].mean())
    here = mean[:, column - 25 : column + 26]
    moved = mean.copy()
    moved[:, column - 24 : column + 26] = 0.4 * here[:, 1:] + 0.6 * here[:, :-1]
    return moved


def covered(mean: np.ndarray) -> np.ndarray:
    """A wire lies along the sixth groove, over half of it."""
    column = round(truth("experimental")[5 * 9 : 6 * 9, 0].mean())
    shaded = mean.copy()
    shaded[:260, column - 3 : column + 1] *= 0.6
    return shaded


def spoilt(spoil: Callable[..., np.ndarray]) -> np.ndarray:
    return exposed(spoil(mean_image("experimental", 2000.0)), optics(2000.0), np.random.default_rng(3))


def test_a_bent_line_is_refused_and_the_rest_keeps_its_accuracy() -> None:
    found = find_marker(spoilt(bent), experimental_plate(), NOMINAL, DETECTOR)
    assert list(found.refused) == [5], found.refused
    assert "pixels from where the other lines put it" in found.refused[5]
    assert len(found.index) == 90
    assert not np.isin(np.arange(45, 54), found.index).any()
    assert np.sqrt(np.mean((found.pixels - truth("experimental")[found.index]) ** 2)) < 0.03


def test_of_a_line_half_under_a_wire_the_other_half_is_used_and_known_less_well() -> None:
    clean = find_marker(image("experimental", 2000.0, 3), experimental_plate(), NOMINAL, DETECTOR)
    found = find_marker(spoilt(covered), experimental_plate(), NOMINAL, DETECTOR)
    assert not found.refused
    assert found.spoilt > clean.spoilt + 0.015
    error = found.pixels - truth("experimental")[found.index]
    assert np.abs(error).max() < 0.1
    spread = [np.sqrt(np.trace(each.lines[5].covariance[:1, :1])) for each in (clean, found)]
    assert spread[1] > 1.2 * spread[0]
    assert found.lines[5].half_length < 0.8 * clean.lines[5].half_length


@pytest.mark.parametrize("plate", ["experimental", "clinical"])
def test_crossings_behind_a_patient_are_as_far_off_as_their_deviation_says(plate: str) -> None:
    squared, stated = [], []
    panel = Panel(DETECTOR.columns, DETECTOR.rows, DETECTOR.pitch_m)
    for seed in range(6):
        turned = Rotation.from_euler("xy", [20.0 * seed - 50.0, 15.0 * seed - 40.0], degrees=True).as_matrix()
        beam = with_patient(Beam([], None), seed)
        center = turned @ np.array([0.0, 0.0, 0.35])
        view = View(center + turned @ TRUE.source_m, center, turned)
        mounted = Mounted(steel(PLATES[plate]()), center + turned @ TRUE.plate_m, turned @ TRUE.rotation)
        mean = expected_with_plate([view], panel, [mounted], beam.optics, beam.items, rays=2)
        found = find_marker(exposed(mean, beam.optics, np.random.default_rng(seed)), PLATES[plate](), NOMINAL, DETECTOR)
        assert len(found.index) >= 0.7 * len(truth(plate))
        error = found.pixels - truth(plate)[found.index]
        squared.append(np.mean(error**2 / np.diag(found.covariance).reshape(-1, 2)))
        stated.append(np.sqrt(np.mean(np.diag(found.covariance))))
    assert 0.7 < 1.0 / np.sqrt(np.mean(squared)) < 1.5, squared
    assert np.median(stated) < 0.05


def test_a_bright_scratch_and_a_dark_wire_between_the_grooves_are_taken_for_no_groove() -> None:
    mean = mean_image("experimental", 2000.0).copy()
    places = np.sort(truth("experimental").reshape(11, 9, 2)[:, 4, 0])
    between = np.rint(0.5 * (places[:-1] + places[1:])).astype(int)
    mean[:, between[2] - 4 : between[2] + 4] *= 1.8
    mean[:, between[6] - 4 : between[6] + 4] *= 0.5
    found = find_marker(exposed(mean, optics(2000.0), np.random.default_rng(4)), experimental_plate(), NOMINAL, DETECTOR)
    assert len(found.index) == 99
    assert np.sqrt(np.mean((found.pixels - truth("experimental")) ** 2)) < 0.03


def test_a_plate_that_stands_elsewhere_is_found_up_to_less_than_half_a_pitch() -> None:
    away = MarkerProjection(NOMINAL.values + np.array([9e-3, -8e-3, 0, 0, 0, 0, 0, 0, 0]))
    found = find_marker(image("experimental", 2000.0, 5), experimental_plate(), away, DETECTOR)
    assert np.sqrt(np.mean((found.pixels - truth("experimental")[found.index]) ** 2)) < 0.03


def test_the_hybrid_median_removes_single_pixels_and_keeps_a_corner() -> None:
    corner = np.full((30, 30), 100.0)
    corner[15:, 15:] = 500.0
    spoilt = corner.copy()
    spoilt[5, 5], spoilt[20, 22] = 65535.0, 0.0
    filtered = hybrid_median(spoilt)
    assert filtered[5, 5] == 100.0
    assert filtered[20, 22] == 500.0
    np.testing.assert_array_equal(hybrid_median(corner)[:, 17:], corner[:, 17:])


@pytest.mark.parametrize(
    ("picture", "line"),
    [
        (np.full((512, 640), 400, np.uint16), "0 of 11 lines along y and 0 of 9 along x of the experimental plate are in the image"),
        (np.full((512, 640), 65535, np.uint16), "100% of the pixels are saturated at 65535; expose less"),
        (np.zeros((512, 640), np.uint16), "the image is dark"),
        (np.full((480, 640), 400, np.uint16), "the detector has 512 rows and 640 columns"),
    ],
)
def test_an_image_without_a_plate_is_one_line(picture: np.ndarray, line: str) -> None:
    with pytest.raises(UnusableInputError, match=line):
        find_marker(picture, experimental_plate(), NOMINAL, DETECTOR)


def test_noise_alone_makes_no_plate() -> None:
    noise = np.random.default_rng(6).poisson(400.0, (512, 640)).astype(np.uint16)
    with pytest.raises(UnusableInputError, match="of the experimental plate are in the image"):
        find_marker(noise, experimental_plate(), TRUE, DETECTOR)


def test_a_narrow_groove_looked_for_beside_its_place_is_found_there_or_not_at_all() -> None:
    """Three pixels wide, as the clinical plate's on a panel read 8 x 8: a fit that runs away is a piece refused."""
    away = np.arange(80) - 47.6
    profile = 400.0 + 240.0 * (erf((away + 1.5) / 2.1) - erf((away - 1.5) / 2.1))
    counts = np.random.default_rng(399).poisson(np.tile(profile, (195, 1))).astype(np.float32)
    whole = np.zeros(195, dtype=np.int64)
    found = 0
    for beside in np.arange(30.0, 70.0, 0.5):
        piece = fit_pieces(profiles(counts, beside, 0.0, whole, 5.0), 3.0, 1.3)
        if abs(beside - 47.6) < 1.6 and np.isfinite(piece.variance[0]):
            assert abs(piece.across[0] - 47.6) < 0.05
            found += 1
    assert found >= 4
