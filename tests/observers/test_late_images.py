"""Claims: an image counts for the row it shows, however late it comes."""

from __future__ import annotations

import numpy as np
import pytest
from observed_models import DenseModel, drawn_rows, small_model, small_noise

from controllers.errors import DesignError
from controllers.observers.late import LateImages
from controllers.observers.modal_observer import ModalObserver

SEEN = np.array([2e-4, -1e-4, np.nan, np.nan, np.nan, 3e-4])
STD = np.array([1e-5, 1e-5, 1e-5, 1e-4, 1e-4, 1e-4])


@pytest.fixture(scope="module")
def drawn() -> tuple[np.ndarray, np.ndarray]:
    measured, commands, _ = drawn_rows(DenseModel(small_model(), small_noise()), small_noise(), 120, seed=31)
    return measured, commands


def _fresh(rows: int = 64) -> LateImages:
    return LateImages(ModalObserver(small_model(), small_noise(), "ukf"), rows)


@pytest.mark.parametrize("shown", [0, 1, 50])
def test_a_late_image_counts_for_what_it_would_have_in_time(drawn, shown: int) -> None:
    measured, commands = drawn
    in_time, late = _fresh(), _fresh()
    for k in range(60):
        for observer in (in_time, late):
            observer.step_measured(measured[k], commands[max(k - 1, 0)])
        if k == shown:
            in_time.image(k, SEEN, STD)
    late.image(shown, SEEN, STD)
    assert np.array_equal(in_time.observer.state, late.observer.state)
    assert np.array_equal(in_time.observer.covariance, late.observer.covariance)
    for k in range(60, 120):
        for observer in (in_time, late):
            observer.step_measured(measured[k], commands[max(k - 1, 0)])
    assert np.array_equal(in_time.observer.estimate[:46], late.observer.estimate[:46])


def test_an_exact_image_is_believed(drawn) -> None:
    measured, commands = drawn
    late = _fresh()
    for k in range(60):
        late.step_measured(measured[k], commands[max(k - 1, 0)])
    before = late.observer.covariance
    late.image(59, SEEN, np.full(6, 1e-9))
    late.observer.step_measured(np.full(10, np.nan), commands[58])
    column = [name for name, _ in late.observer.channels].index("estimate_detector_x")
    assert abs(late.observer.estimate[column] - SEEN[0]) < 0.3 * abs(SEEN[0])  # one sample of motion later
    assert np.trace(late.observer.covariance[:2, :2]) < np.trace(before[:2, :2]) * 2.0


def test_an_image_from_too_long_ago_or_without_a_deviation_is_refused(drawn) -> None:
    measured, commands = drawn
    late = _fresh(rows=16)
    for k in range(40):
        late.step_measured(measured[k], commands[max(k - 1, 0)])
    with pytest.raises(DesignError, match="rows 25 to 39 are kept"):
        late.image(10, SEEN, STD)
    with pytest.raises(DesignError, match="must be positive"):
        late.image(39, SEEN, np.zeros(6))
