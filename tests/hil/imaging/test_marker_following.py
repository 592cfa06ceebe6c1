"""A plate followed from image to image shows what each image shows alone, and a state that has become wrong is left at once."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from marker_images import NOMINAL, TRUE

from hil.calibration.marker.scan import SPOT_M
from hil.calibration.marker.tube_to_panel import fit_marker
from hil.emulated.marker_images import expected_image
from hil.errors import UnusableInputError
from hil.imaging import Detector
from hil.imaging.markers import PLATES, MarkerPoints, MarkerProjection, find_marker
from virtual_bus.xray.imaging import Optics, exposed

AGREE = 0.15
"""Of a stated deviation: answers with and without the image before."""

PANEL = Detector(columns=2480, rows=1920, pitch_m=381e-3 / 2480)
"""The C-arm's."""

COARSE, FINE = PANEL.binned(4), PANEL.binned(2)

STILL = (0.0,) * 6
PITCH_M = 6e-3 * 1.16 / 0.25
"""Of the experimental plate's grooves, on the panel."""


@cache
def moved(plate: str, by: tuple[float, ...], seed: int, detector: Detector = COARSE) -> np.ndarray:
    """An image of the plate with (focal_u, focal_v, focal_length, theta_x, theta_y, theta_z) off by `by`."""
    return exposed(mean_image(plate, by, detector), Optics(), np.random.default_rng(seed))


@cache
def mean_image(plate: str, by: tuple[float, ...], detector: Detector) -> np.ndarray:
    return expected_image(PLATES[plate](), at(by), detector, Optics())


def at(by: tuple[float, ...]) -> MarkerProjection:
    return MarkerProjection(TRUE.values + np.append(by, np.zeros(9 - len(by))))


def answer(points: MarkerPoints, plate: str, detector: Detector = COARSE) -> tuple[np.ndarray, np.ndarray]:
    """Six parameters and their covariance."""
    fit = fit_marker(points, PLATES[plate](), detector, NOMINAL, spot_m=SPOT_M)
    return fit.projection.values[:6], fit.covariance[:6, :6]


def found(picture: np.ndarray, plate: str, before: MarkerPoints | None = None, detector: Detector = COARSE) -> MarkerPoints | str:
    """What is found, or why nothing is."""
    try:
        return find_marker(picture, PLATES[plate](), NOMINAL, detector, before)
    except UnusableInputError as error:
        return str(error)


def assert_agree(one: MarkerPoints | str, other: MarkerPoints | str, plate: str, detector: Detector = COARSE) -> None:
    if isinstance(one, str) or isinstance(other, str):
        assert one == other
        return
    assert one.refused.keys() == other.refused.keys()
    (values, covariance), (alone, its_own) = answer(one, plate, detector), answer(other, plate, detector)
    sigma = np.sqrt(np.diag(its_own))
    assert (np.abs(values - alone) < AGREE * sigma).all(), (values - alone) / sigma
    np.testing.assert_allclose(np.sqrt(np.diag(covariance)), sigma, rtol=0.1)


@pytest.mark.parametrize("plate", ["experimental", "clinical"])
def test_a_plate_that_shakes_is_found_as_in_each_image_alone(plate: str) -> None:
    """By up to 0.05 mm on the panel between two images, as much as a scan's bending and a jog's shaking make in a thirtieth of a second."""
    before, cold = None, 0
    for k in range(6):
        by = (3e-5 * np.sin(0.9 * k), 2e-5 * np.cos(0.7 * k), 1e-4 * np.sin(0.5 * k), 0.0, 0.0, 5e-5 * np.sin(1.3 * k))
        picture = moved(plate, by, k, FINE)
        alone, followed = found(picture, plate, None, FINE), found(picture, plate, before, FINE)
        assert not isinstance(followed, str)
        assert not isinstance(alone, str)
        assert_agree(followed, alone, plate, FINE)
        cold += np.array_equal(followed.pixels, alone.pixels)
        true = FINE.to_pixels(at(by).project(PLATES[plate]().points_m))[followed.index]
        assert np.sqrt(np.mean((followed.pixels - true) ** 2)) < 0.03
        before = followed
    assert cold == 1  # the first


@pytest.mark.parametrize("share", [-0.8, -0.3, -0.1, -0.02, 0.02, 0.05, 0.1, 0.3, 0.5, 1.0])
def test_a_plate_that_jumps_is_found_where_it_is_or_not_at_all(share: float) -> None:
    """By a share of the grooves' distance, of which a groove is 0.13 wide."""
    start = (-0.3 * PITCH_M if share > 0 else 0.3 * PITCH_M, 0.0)
    before = found(moved("experimental", start, 1), "experimental")
    assert isinstance(before, MarkerPoints)
    picture = moved("experimental", (start[0] + share * PITCH_M, 0.0), 2)
    assert_agree(found(picture, "experimental", before), found(picture, "experimental"), "experimental")


@pytest.mark.parametrize(("first", "then"), [("experimental", "clinical"), ("clinical", "experimental")])
def test_a_plate_that_was_swapped_is_not_followed(first: str, then: str) -> None:
    before = found(moved(first, STILL, 1), first)
    assert isinstance(before, MarkerPoints)
    picture = moved(then, STILL, 2)
    assert_agree(found(picture, first, before), found(picture, first), first)


@pytest.mark.parametrize("plate", ["experimental", "clinical"])
def test_a_region_of_the_panel_that_dies_is_named_as_in_each_image_alone_and_forgotten_when_it_is_back(plate: str) -> None:
    before = found(moved(plate, STILL, 1), plate)
    assert isinstance(before, MarkerPoints)
    column = round(float(before.lines[1].at(240.0)))
    regions = [np.s_[:, column - 40 : column + 40], np.s_[100:300, column - 40 : column + 40], np.s_[:, column - 3 : column + 1], None]
    for k, region in enumerate(regions):
        for seed in (10 + 2 * k, 11 + 2 * k):
            picture = moved(plate, STILL, seed).copy()
            if region is not None:
                picture[region] = 0
            alone, followed = found(picture, plate), found(picture, plate, before)
            assert_agree(followed, alone, plate)
            before = followed if isinstance(followed, MarkerPoints) else None
    assert isinstance(before, MarkerPoints)
    assert not before.refused
