"""Exposures that show something else than the phantom where it is expected are not used, and a scan of such is refused by one line."""

from __future__ import annotations

import numpy as np
import pytest
from phantom_images import PHANTOM, nominal

from hil.calibration.phantom.pose import fit_poses
from hil.calibration.use.lookup_table import look_up_of
from hil.errors import UnusableInputError
from hil.imaging import ConeBeam


def observations(wrong: tuple[int, ...]) -> tuple[ConeBeam, np.ndarray, np.ndarray]:
    """Six exposures; in the `wrong` ones bullets stand where those of another pose are."""
    beam = nominal(np.linspace(-0.5, 0.5, 6))
    seen = beam.moved(np.full((6, 9), 1e-3)).project(PHANTOM.centers_m)
    rng = np.random.default_rng(1)
    for k in wrong:
        seen[k] = seen[k][rng.permutation(len(PHANTOM.centers_m))]
    return beam, seen + rng.normal(0.0, 5e-6, seen.shape), np.full(seen.shape[:2], 5e-6)


def test_swapped_bullets_are_no_exposure_of_the_phantom() -> None:
    beam, seen, sigma = observations(wrong=(1, 4))
    fit = fit_poses(PHANTOM.centers_m, seen, sigma, beam, nine=True)
    np.testing.assert_array_equal(fit.good, [True, False, True, True, False, True])
    assert np.isnan(fit.covariance[[1, 4]]).all()
    assert np.isnan(fit.residual_m[[1, 4]]).all()
    table = look_up_of(fit, beam, ("propeller", "roll"), np.zeros((6, 2)), {})
    assert len(table.positions) == 4
    assert np.abs(table.deviation - 1e-3).max() < 3e-3


def test_a_scan_that_mostly_shows_something_else_is_refused() -> None:
    beam, seen, sigma = observations(wrong=(0, 1, 3, 5))
    fit = fit_poses(PHANTOM.centers_m, seen, sigma, beam, nine=True)
    with pytest.raises(UnusableInputError, match="2 of 6 exposures show the phantom where it is expected; compare phantom") as refused:
        look_up_of(fit, beam, ("propeller", "roll"), np.zeros((6, 2)), {})
    assert "\n" not in str(refused.value)
