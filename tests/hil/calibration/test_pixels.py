"""Aspect and skew of (6.4) from the phantom: within their covariance, and as an independent decomposition of the matrices says."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from commands import exposed_scan, isocenter
from flexible_machine import machine_file
from phantom_images import PHANTOM, nominal
from scipy.linalg import rq

from hil.calibration.phantom.pixel_shape import fit_pixels
from hil.errors import UnusableInputError
from hil.imaging import ConeBeam, Detector

TRUE = Detector(columns=640, rows=512, pitch_m=0.5e-3, aspect=1.013, skew=0.004)
DRAWN = Detector(columns=640, rows=512, pitch_m=0.5e-3)


def scan(noise: float, seed: int = 1, count: int = 40) -> tuple[ConeBeam, ConeBeam, np.ndarray]:
    rng = np.random.default_rng(seed)
    ideal = nominal(np.linspace(-1.5, 1.5, count))
    true = ideal.moved(rng.normal(0.0, np.repeat([1e-3, 3e-3, 5e-3], 3), (count, 9)))
    seen = TRUE.to_pixels(true.project(PHANTOM.centers_m))
    return ideal, true, seen + noise * rng.normal(size=seen.shape)


def test_the_matrices_are_those_of_the_direct_linear_transform() -> None:
    ideal, true, seen = scan(0.0)
    fit = fit_pixels(PHANTOM.centers_m, seen, np.full(seen.shape[:2], 0.02), ideal, DRAWN)
    np.testing.assert_allclose(fit.beam.deviation_from(true), 0.0, atol=1e-9)
    np.testing.assert_allclose(np.column_stack([fit.aspect, fit.skew]), np.tile([1.013, 0.004], (len(true), 1)), atol=1e-9)
    for k in (0, 17, 39):
        rows = []
        for (x, y, z), (column, row) in zip(PHANTOM.centers_m, seen[k], strict=True):
            point = np.array([x, y, z, 1.0])
            rows += [np.concatenate([point, np.zeros(4), -column * point]), np.concatenate([np.zeros(4), point, -row * point])]
        direct = np.linalg.svd(np.array(rows))[2][-1].reshape(3, 4)
        ours = fit.matrices(DRAWN)[k]
        np.testing.assert_allclose(
            direct / np.linalg.norm(direct) * np.sign(direct[2, 3] * ours[2, 3]), ours / np.linalg.norm(ours), atol=1e-8
        )
        upper = rq(direct[:, :3])[0]
        upper = np.abs(upper / upper[2, 2]) * np.sign(upper / upper[2, 2] * upper[1, 1])
        assert abs(upper[0, 0] / upper[1, 1]) == pytest.approx(1.013, abs=1e-6)
        assert abs(upper[0, 1] / upper[1, 1]) == pytest.approx(0.004, abs=1e-6)
        assert abs(upper[0, 0]) * DRAWN.pitch_m == pytest.approx(-true.source_m[k, 2], rel=1e-6)


def test_noise_stays_within_the_covariance_and_the_scan_knows_the_pixels_better() -> None:
    ideal, true, seen = scan(0.02)
    fit = fit_pixels(PHANTOM.centers_m, seen, np.full(seen.shape[:2], 0.02), ideal, DRAWN)
    error = np.column_stack([fit.beam.deviation_from(true), fit.aspect - 1.013, fit.skew - 0.004])
    chi2 = np.einsum("na,nab,nb->n", error, np.linalg.inv(fit.covariance), error) / 11.0
    assert 0.8 < np.mean(chi2) < 1.25
    panel, sigma = fit.of_the_panel(DRAWN)
    assert sigma.max() < 1e-3
    assert abs(panel.aspect - 1.013) < 3.0 * sigma[0]
    assert abs(panel.skew - 0.004) < 3.0 * sigma[1]


def test_exposures_that_show_too_little_are_left_out_and_a_scan_of_such_refused() -> None:
    ideal, _, seen = scan(0.01, count=4)
    seen[1, 8:] = np.nan
    fit = fit_pixels(PHANTOM.centers_m, seen, np.full(seen.shape[:2], 0.01), ideal, DRAWN)
    assert np.isnan(fit.covariance[1]).all()
    assert np.isfinite(fit.covariance[[0, 2, 3]]).all()
    seen[:, 8:] = np.nan
    with pytest.raises(UnusableInputError, match="no exposure shows 9 bullets"):
        fit_pixels(PHANTOM.centers_m, seen, np.full(seen.shape[:2], 0.01), ideal, DRAWN).of_the_panel(DRAWN)


@pytest.mark.slow
def test_a_scan_whose_description_has_square_pixels_is_told_its_aspect(tmp_path: Path) -> None:
    (tmp_path / "m.toml").write_text(machine_file({"detector_size_mm = [381.0, 295.0]": "detector_size_mm = [381.0, 298.0]"}))
    exposed_scan(tmp_path, "--scene", "dodecahedron", "--rate", "4", machine=tmp_path / "m.toml")
    description = tmp_path / "images" / "scan.toml"
    lines = [line if not line.startswith("aspect") else "aspect = 1.0" for line in description.read_text().splitlines()]
    description.write_text("\n".join(lines) + "\n")
    assert (
        isocenter("calibrate", "phantom", "carm", tmp_path / "images", "--pixels", "-o", tmp_path / "t.npz", "--json", tmp_path / "a.json")
        == 0
    )
    answer = json.loads((tmp_path / "a.json").read_text())
    assert answer["aspect"] == pytest.approx((298.0 / 1920) / (381.0 / 2480), abs=5e-4)
    assert answer["skew"] == pytest.approx(0.0, abs=5e-4)
