"""Poses from a phantom's bullets against the package `geometric-calibration` (least squares over seven parameters), where it installs."""

import matplotlib
import numpy as np
import pytest
from phantom_images import PHANTOM

from hil.calibration.phantom.pose import fit_poses
from hil.imaging import ConeBeam, Detector

matplotlib.use("agg")
theirs = pytest.importorskip(
    "geometric_calibration.geometric_calibration",
    reason="the package geometric-calibration is not installed: pip install geometric-calibration",
)

from geometric_calibration.utils import create_camera_matrix, project_camera_matrix  # noqa: E402
from scipy.optimize import least_squares  # noqa: E402

DETECTOR = Detector(columns=768, rows=1024, pitch_m=0.388e-3)
SEVEN = np.array([0.012, 0.4, -0.008, 390.0, 505.0, 1160.7, 810.4])
"""Panel angles [rad], image centre [pixel], source to panel and to isocentre [mm]: what their model knows."""


def pixels_of(seven: np.ndarray) -> np.ndarray:
    """(P, 2) where their model sees the bullets."""
    matrix = create_camera_matrix(seven[:3], seven[5], seven[6], [0.388, 0.388], [0, 0, 0])
    return project_camera_matrix(1e3 * PHANTOM.centers_m, seven[3:5], matrix)


def beam_of(seven: np.ndarray) -> ConeBeam:
    """Their model's projection matrix as our nine parameters."""
    matrix = create_camera_matrix(seven[:3], seven[5], seven[6], [0.388, 0.388], [0, 0, 0])[:3]
    center = np.array([[1.0, 0.0, seven[3]], [0.0, 1.0, seven[4]], [0.0, 0.0, 1.0]])
    return ConeBeam.from_matrices((center @ matrix @ np.diag([1e3, 1e3, 1e3, 1.0]))[None], DETECTOR)


def test_their_projections_are_ours() -> None:
    np.testing.assert_allclose(DETECTOR.to_pixels(beam_of(SEVEN).project(PHANTOM.centers_m)[0]), pixels_of(SEVEN), atol=1e-9)


def test_their_fit_and_ours_find_the_same_pose_in_the_same_noise() -> None:
    start = SEVEN - [0.01, 0.02, -0.01, 3.0, -4.0, 0.5, -0.4]
    seen = pixels_of(SEVEN) + np.random.default_rng(3).normal(0.0, 0.02, (len(PHANTOM.centers_m), 2))
    found = least_squares(
        theirs.calibration_cost_function, start, x_scale=np.abs(start), args=(1e3 * PHANTOM.centers_m, [0.388, 0.388], seen, [0, 0, 0])
    ).x
    observed = DETECTOR.to_metres(seen)[None]
    ours = fit_poses(PHANTOM.centers_m, observed, np.full((1, 23), 0.02 * DETECTOR.pitch_m), beam_of(start), nine=True)
    sigma = np.sqrt(np.diag(ours.covariance[0]))
    # Seven parameters and nine fit the same noise; the two more cost the nine some of their certainty, no more
    assert (np.abs(ours.beam.deviation_from(beam_of(found))[0]) < 4.0 * sigma).all()
    assert (np.abs(beam_of(found).deviation_from(beam_of(SEVEN))[0]) < 4.0 * sigma).all()
    assert (np.abs(ours.beam.deviation_from(beam_of(SEVEN))[0]) < 4.0 * sigma).all()
    exact = fit_poses(PHANTOM.centers_m, DETECTOR.to_metres(pixels_of(SEVEN))[None], np.full((1, 23), 1e-5), beam_of(start), nine=True)
    np.testing.assert_allclose(exact.beam.deviation_from(beam_of(SEVEN)), 0.0, atol=1e-9)
