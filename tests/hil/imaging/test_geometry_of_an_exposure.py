"""The nine parameters, the projection matrices and where points fall agree with each other and with RTK."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hil.imaging import ConeBeam, Detector

DETECTOR = Detector(columns=640, rows=512, pitch_m=0.5e-3, aspect=1.01, skew=0.003)


def some_exposures(n: int = 50, seed: int = 5) -> ConeBeam:
    rng = np.random.default_rng(seed)
    parameters = np.zeros((n, 9))
    parameters[:, :3] = rng.normal((0.004, -0.003, -1.16), 0.005, (n, 3))
    parameters[:, 3:6] = rng.normal((0.01, 0.002, -0.35), 0.01, (n, 3))
    parameters[:, 6:] = rng.uniform(-1.5, 1.5, (n, 3))
    return ConeBeam.from_parameters(parameters)


def test_a_point_on_the_ray_from_the_focal_spot_falls_where_the_ray_meets_the_panel() -> None:
    beam = some_exposures()
    on_panel = np.array([[0.05, -0.08, 0.0]] * len(beam))  # in the detector's frame
    inside = beam.source_m + 0.6 * (on_panel - beam.source_m)
    points = (beam.rotation @ (inside - beam.phantom_m)[..., None])[..., 0]
    np.testing.assert_allclose(beam.project(points[:, None, :])[:, 0], on_panel[:, :2], atol=1e-12)


def test_matrices_say_what_project_says() -> None:
    beam = some_exposures()
    points = np.random.default_rng(6).uniform(-0.1, 0.1, (20, 3))
    homogeneous = np.einsum("nij,pj->npi", beam.matrices(DETECTOR), np.column_stack([points, np.ones(20)]))
    assert (homogeneous[..., 2] > 0.0).all()
    np.testing.assert_allclose(homogeneous[..., :2] / homogeneous[..., 2:], DETECTOR.to_pixels(beam.project(points)), atol=1e-9)


def test_matrices_of_any_scale_and_sign_give_the_parameters_back() -> None:
    beam = some_exposures()
    scale = np.random.default_rng(7).choice([-3.0, 0.01, 250.0], len(beam))
    again = ConeBeam.from_matrices(beam.matrices(DETECTOR) * scale[:, None, None], DETECTOR)
    np.testing.assert_allclose(again.parameters, beam.parameters, atol=1e-11)


def test_a_matrix_that_is_no_projection_is_refused() -> None:
    with pytest.raises(ValueError, match="matrix 0 is no projection"):
        ConeBeam.from_matrices(np.ones((1, 3, 4)), DETECTOR)


def test_frames_and_change_of_reference_keep_the_images() -> None:
    beam = some_exposures()
    again = ConeBeam.from_frames(beam.source_in_phantom_m, beam.detector_in_phantom_m, beam.rotation)
    np.testing.assert_allclose(again.parameters, beam.parameters, atol=1e-12)
    origin, rotation = np.array([0.02, -0.01, 0.03]), Rotation.from_euler("xyz", [0.2, -0.4, 0.9]).as_matrix()
    points = np.random.default_rng(8).uniform(-0.1, 0.1, (20, 3))
    np.testing.assert_allclose(beam.referred_to(origin, rotation).project((points - origin) @ rotation), beam.project(points), atol=1e-12)


def test_pixels_and_metres_are_each_other_s_inverse_and_the_centre_is_the_middle() -> None:
    points = np.random.default_rng(9).uniform(-0.1, 0.1, (20, 2))
    np.testing.assert_allclose(DETECTOR.to_metres(DETECTOR.to_pixels(points)), points, atol=1e-15)
    np.testing.assert_allclose(DETECTOR.to_pixels(np.zeros(2)), [319.5, 255.5])


@pytest.mark.nightly
def test_rtk_projects_points_to_the_same_places() -> None:
    itk = pytest.importorskip("itk")
    beam = some_exposures()
    points = np.random.default_rng(10).uniform(-100.0, 100.0, (20, 3))
    geometry = itk.RTK.ThreeDCircularProjectionGeometry.New()
    point, vector = itk.Point[itk.D, 3], itk.Vector[itk.D, 3]
    for k in range(len(beam)):
        assert geometry.AddProjection(
            point(1e3 * beam.source_in_phantom_m[k]),
            point(1e3 * beam.detector_in_phantom_m[k]),
            vector(beam.rotation[k, :, 0]),
            vector(beam.rotation[k, :, 1]),
        )
    for k in range(len(beam)):
        homogeneous = np.column_stack([points, np.ones(20)]) @ np.array(itk.array_from_matrix(geometry.GetMatrix(k))).T
        np.testing.assert_allclose(homogeneous[:, :2] / homogeneous[:, 2:], 1e3 * beam.project(1e-3 * points)[k], rtol=1e-9, atol=1e-9)
