"""The pose from a marker plate: true within its covariance, and silent about nothing it cannot tell apart."""

from __future__ import annotations

import numpy as np
import pytest
from marker_images import DETECTOR, NOMINAL, TRUE, image

from hil.calibration.marker.tube_to_panel import LINEAR, NONLINEAR, fit_marker, fit_marker_linear
from hil.errors import UnusableInputError
from hil.imaging import ConeBeam, Detector
from hil.imaging.markers import MarkerPoints, MarkerProjection, experimental_plate, find_marker
from hil.imaging.markers.projection import PARAMETERS

PLATE = experimental_plate()
FINE = Detector(2480, 1920, 381e-3 / 2480)


def points(
    projection: MarkerProjection, detector: Detector, deviation: float = 0.1, rng: np.random.Generator | None = None
) -> MarkerPoints:
    pixels = detector.to_pixels(projection.project(PLATE.points_m))
    if rng is not None:
        pixels = pixels + deviation * rng.standard_normal(pixels.shape)
    return MarkerPoints(np.arange(99), pixels, deviation**2 * np.eye(198), {}, {})


def test_a_plate_projects_as_the_cone_beam_geometry_says() -> None:
    beam = ConeBeam(TRUE.source_m[None], TRUE.plate_m[None], TRUE.rotation.T[None])
    np.testing.assert_allclose(TRUE.project(PLATE.points_m), beam.project(PLATE.points_m)[0], atol=1e-13)


@pytest.mark.parametrize("free", [LINEAR, NONLINEAR, (*NONLINEAR[:2], *NONLINEAR[3:], "plate_distance")])
def test_without_noise_the_parameters_come_back(free: tuple[str, ...]) -> None:
    true = NOMINAL.values.copy()
    for name in free:
        k = PARAMETERS.index(name)
        true[k] = TRUE.values[k] if name != "plate_distance" else 0.2504
    fit = fit_marker(points(MarkerProjection(true), FINE), PLATE, FINE, NOMINAL, free)
    np.testing.assert_allclose(fit.projection.values, true, atol=1e-9)
    assert fit.residual_pixels < 1e-6
    assert set(fit.held) == set(PARAMETERS) - set(free)


def test_free_angles_take_f_x_from_micrometres_to_tenths_of_a_millimetre() -> None:
    straight = fit_marker(points(NOMINAL, FINE), PLATE, FINE, NOMINAL, LINEAR)
    turned = fit_marker(points(NOMINAL, FINE), PLATE, FINE, NOMINAL, NONLINEAR)
    assert np.sqrt(straight.covariance[0, 0]) == pytest.approx(1.5e-6, rel=0.1)  # 0.1 pixel over the root of 99 points
    assert np.sqrt(turned.covariance[0, 0]) == pytest.approx(0.2e-3, rel=0.3)


def test_the_linear_case_is_the_nonlinear_one_where_angles_are_known() -> None:
    seen = points(TRUE, FINE, 0.1, np.random.default_rng(1))
    known = MarkerProjection(np.concatenate([NOMINAL.values[:3], TRUE.values[3:]]))
    linear, steps = fit_marker_linear(seen, PLATE, FINE, known), fit_marker(seen, PLATE, FINE, known, LINEAR)
    np.testing.assert_allclose(linear.projection.values, steps.projection.values, atol=1e-11)
    np.testing.assert_allclose(linear.covariance, steps.covariance, rtol=1e-6, atol=1e-18)


def test_neglected_angles_bias_the_linear_case() -> None:
    seen = points(TRUE, FINE)
    biased = fit_marker_linear(seen, PLATE, FINE, NOMINAL)
    # theta_y = -3 mrad turns the plate's shadow by 1.16 m of focal length: 3.5 mm that the linear case takes for f_x
    assert biased.projection.values[0] - TRUE.values[0] == pytest.approx(-3e-3 * 1.16, rel=0.05)


@pytest.mark.slow
def test_poses_are_scattered_as_their_covariance_says() -> None:
    rng = np.random.default_rng(2)
    fits = [fit_marker(points(TRUE, FINE, 0.1, rng), PLATE, FINE, NOMINAL) for _ in range(300)]
    error = np.array([fit.projection.values - TRUE.values for fit in fits])[:, :6]
    inverse = np.linalg.inv(fits[0].covariance[:6, :6])
    chi2 = np.einsum("na,ab,nb->n", error, inverse, error)
    assert np.mean(chi2) == pytest.approx(6.0, abs=4.0 * np.sqrt(12.0 / 300))
    assert np.std(error, axis=0, ddof=1) == pytest.approx(np.sqrt(np.diag(fits[0].covariance)[:6]), rel=0.15)


@pytest.mark.slow
def test_from_images_the_pose_is_true_within_the_covariance_that_correlated_points_have() -> None:
    chi2 = []
    for seed in range(8):
        found = find_marker(image("experimental", 2000.0, 30 + seed), PLATE, NOMINAL, DETECTOR)
        fit = fit_marker(found, PLATE, DETECTOR, NOMINAL)
        error = (fit.projection.values - TRUE.values)[:6]
        chi2.append(error @ np.linalg.solve(fit.covariance[:6, :6], error) / 6.0)
    assert 0.5 < np.mean(chi2) < 2.0, chi2  # 48 degrees of freedom: 0.2


@pytest.mark.parametrize(
    ("free", "line"),
    [
        (("focal_length", "plate_distance"), "focal_length and plate_distance: a flat plate shows their ratio alone; hold one of them"),
        (("focal_u", "focal_v", "offset_x"), "focal_u.*cannot tell them apart|offset_x.*cannot tell them apart"),
        (("focal_v", "offset_y", "theta_z"), "offset_y.*cannot tell them apart|focal_v.*cannot tell them apart"),
        (("tilt",), "tilt to fit: the parameters of a marker are focal_u"),
    ],
)
def test_what_one_image_cannot_tell_apart_is_named(free: tuple[str, ...], line: str) -> None:
    with pytest.raises(UnusableInputError, match=line):
        fit_marker(points(NOMINAL, FINE), PLATE, FINE, NOMINAL, free)
