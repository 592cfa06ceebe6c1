"""From images of bullets to the geometry of each exposure, within its own covariance; and the trap of six parameters."""

from __future__ import annotations

import numpy as np
import pytest
from phantom_images import DETECTOR, PHANTOM, RADIUS_PIXELS, image_of, nominal, scan
from scipy import stats

from hil.calibration.phantom.bullets import find_bullets
from hil.calibration.phantom.pose import fit_poses, match_bullets, observe
from hil.errors import UnusableInputError
from hil.imaging import ConeBeam
from virtual_bus.xray.imaging import Optics


def observations() -> tuple[ConeBeam, ConeBeam, np.ndarray, np.ndarray]:
    ideal, true, images = scan()
    rows = []
    for k, image in enumerate(images):
        found = find_bullets(image, RADIUS_PIXELS)
        rows.append(observe(found.pixels, found.variance, PHANTOM.centers_m, ideal[k : k + 1], DETECTOR, RADIUS_PIXELS, gate=12.0))
    return ideal, true, np.array([row[0] for row in rows]), np.array([row[1] for row in rows])


def test_bullets_are_centred_to_a_hundredth_of_a_pixel_as_their_variance_says() -> None:
    errors, sigmas = [], []
    for k, angle in enumerate((0.0, 0.3, -0.7, 0.9, 0.5, -0.4)):
        beam = nominal(np.array([angle]))
        found = find_bullets(image_of(beam, seed=k), RADIUS_PIXELS)
        true = DETECTOR.to_pixels(beam.project(PHANTOM.centers_m)[0])
        distance = np.linalg.norm(found.pixels[:, None] - true[None], axis=2)
        lonely = np.sort(np.linalg.norm(true[:, None] - true[None], axis=2), axis=1)[:, 1][distance.argmin(axis=1)] > 6 * RADIUS_PIXELS
        errors.append((found.pixels - true[distance.argmin(axis=1)])[lonely].ravel())
        sigmas.append(np.sqrt(found.variance[lonely]))
    rms = np.sqrt(np.mean(np.concatenate(errors) ** 2))
    assert rms < 0.02
    assert rms == pytest.approx(np.sqrt(np.mean(np.concatenate(sigmas) ** 2)), rel=0.25)


@pytest.mark.slow
def test_nine_parameters_lie_within_their_covariance() -> None:
    ideal, true, observed, sigma = observations()
    fit = fit_poses(PHANTOM.centers_m, observed, sigma, ideal, nine=True)
    assert fit.good.all()
    error = fit.beam.deviation_from(true)
    chi2 = np.einsum("na,nab,nb->n", error, np.linalg.inv(fit.covariance), error)
    assert 0.7 < np.mean(chi2) / 9.0 < 1.8, np.mean(chi2) / 9.0
    assert np.median(chi2) < stats.chi2.ppf(0.9, 9)


def test_a_source_shift_of_a_millimetre_hides_in_six_parameters_and_no_residual_shows_it() -> None:
    ideal = nominal(np.zeros(1))
    true = ideal.moved([[1e-3, 0, 0, 0, 0, 0, 0, 0, 0]])
    observed = true.project(PHANTOM.centers_m)
    six = fit_poses(PHANTOM.centers_m, observed, np.full((1, 23), 5e-6), ideal)
    bias = six.beam.deviation_from(true)[0]
    assert abs(abs(bias[3]) - 0.32e-3) < 0.03e-3
    assert abs(abs(bias[7]) - 0.85e-3) < 0.05e-3
    assert six.residual_m[0] < 5e-6
    nine = fit_poses(PHANTOM.centers_m, observed, np.full((1, 23), 5e-6), ideal, nine=True)
    np.testing.assert_allclose(nine.beam.deviation_from(true), 0.0, atol=1e-9)


def test_shadows_are_matched_after_a_common_shift_with_some_lost_and_some_false() -> None:
    rng = np.random.default_rng(5)
    predicted = DETECTOR.to_pixels(nominal(np.array([0.4])).project(PHANTOM.centers_m)[0])
    order = rng.permutation(23)[:18]
    seen = np.vstack([predicted[order] + [25.0, -14.0] + rng.normal(0.0, 1.0, (18, 2)), [[5.0, 5.0], [600.0, 400.0]]])
    matched = match_bullets(seen, predicted, gate=12.0)
    np.testing.assert_array_equal(matched[order], np.arange(18))
    assert (np.delete(matched, order) == -1).all()


def test_a_wrong_match_is_left_out() -> None:
    ideal = nominal(np.zeros(1))
    observed = ideal.project(PHANTOM.centers_m) + np.random.default_rng(6).normal(0.0, 5e-6, (1, 23, 2))
    observed[0, [2, 7]] = observed[0, [7, 2]]
    fit = fit_poses(PHANTOM.centers_m, observed, np.full((1, 23), 5e-6), ideal)
    assert fit.used[0] == 21
    assert np.abs(fit.beam.deviation_from(ideal)).max() < 0.1e-3


def test_overlapping_bullets_are_not_used() -> None:
    beam = nominal(np.array([1.0]))  # two bullets nearly hide each other here
    found = find_bullets(image_of(beam), RADIUS_PIXELS)
    observed, _ = observe(found.pixels, found.variance, PHANTOM.centers_m, beam, DETECTOR, RADIUS_PIXELS, gate=12.0)
    error = np.linalg.norm(observed - beam.project(PHANTOM.centers_m)[0], axis=1) / DETECTOR.pitch_m
    assert np.nanmax(error) < 0.06
    assert 15 < np.isfinite(error).sum() < 23


def test_images_without_bullets_show_none_and_unusable_ones_are_named() -> None:
    beam = nominal(np.zeros(1))
    assert len(find_bullets(image_of(beam, items=[]), RADIUS_PIXELS).pixels) == 0
    with pytest.raises(UnusableInputError, match="saturated"):
        find_bullets(image_of(beam, Optics(photons=1e5)), RADIUS_PIXELS)
    with pytest.raises(UnusableInputError, match="dark"):
        find_bullets(image_of(beam, Optics(photons=3.0)), RADIUS_PIXELS)
    with pytest.raises(UnusableInputError, match="no exposure shows 5 bullets"):
        fit_poses(PHANTOM.centers_m, np.full((1, 23, 2), np.nan), np.full((1, 23), np.nan), beam)


@pytest.mark.nightly
@pytest.mark.parametrize(("beside", "dark"), [(0.0, 0.8), (2.0, 0.33)])  # the second has no centre at all: it runs off the image
def test_a_dark_spot_in_a_ring_that_darkens_its_rim_is_doubtful(beside: float, dark: float) -> None:
    columns, rows = np.meshgrid(np.arange(160), np.arange(160))
    bullet, spot, ring = (np.hypot(columns - u, rows - v) for u, v in ((40, 40), (110, 110), (110 + beside, 110)))
    depth = 2.0 * np.sqrt(np.clip(1.0 - (bullet / 6.0) ** 2, 0.0, None)) + 1.6 * (spot < 4.0) + dark * ((ring > 9.6) & (ring < 13.2))
    found = find_bullets(2000.0 * np.exp(-depth), 6.0)
    np.testing.assert_allclose(found.pixels, [[40.0, 40.0]], atol=0.1)
    np.testing.assert_allclose(found.doubtful, [[110.0, 110.0]], atol=0.5)
