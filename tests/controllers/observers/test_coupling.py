"""Claims: axes' speeds couple the modes to the axes as the matrices say, and a command acts as its drive rounds it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from observed_models import DenseModel, drawn_rows, small_model, small_noise
from scipy.linalg import expm

from controllers.errors import DesignError
from controllers.observers.extended_kalman import linearised
from controllers.observers.modal_observer import ModalObserver

SPEEDS = np.array([0.7, -0.4])
STEP_A = np.array([0.005, 0.02])


def stepped(observer: ModalObserver) -> np.ndarray:
    """The transition of [q, q', η, η'] (12, 12) while the axes turn."""
    states = len(observer.state)
    x, F, H = np.zeros(states), np.zeros((states, states)), np.zeros((10, states))
    x[2:4] = SPEEDS
    linearised(observer.constants, observer.scheduled, x, F, H)
    return F[:12, :12]


@pytest.mark.nightly
def test_turning_axes_couple_as_in_the_matrices() -> None:
    model = small_model()
    coupling = 0.3 * np.random.default_rng(5).normal(size=(2, 2, 4, 1))
    A, *_ = model.frozen(np.zeros(2))
    turning = A.copy()
    turning[6:8, 8:12] += np.einsum("a,abk->bk", SPEEDS, coupling[..., 0])  # [q, η, q', η']
    order = np.array([0, 1, 6, 7, 2, 3, 4, 5, 8, 9, 10, 11])
    exact, without = (expm(matrix / model.sample_rate_Hz)[np.ix_(order, order)] for matrix in (turning, A))
    found = stepped(ModalObserver(replace(model, coupling=coupling), small_noise(), "ekf")) - stepped(
        ModalObserver(model, small_noise(), "ekf")
    )
    assert np.abs(found - (exact - without)).max() < 0.25 * np.abs(exact - without).max()
    speeds = np.ix_([2, 3], [8, 9, 10, 11])
    assert found[speeds] == pytest.approx((exact - without)[speeds], abs=0.1 * np.abs(exact - without)[speeds].max())


def test_at_rest_nothing_is_coupled() -> None:
    model = small_model()
    coupled = replace(model, coupling=np.ones((2, 2, 4, 1)))
    steps = [ModalObserver(each, small_noise(), "ukf").linearised(np.zeros(2))[0] for each in (model, coupled)]
    assert np.array_equal(*steps)


@pytest.mark.nightly
@pytest.mark.parametrize("kind", ["kf", "ukf"])
def test_a_command_acts_as_the_drive_rounds_it(kind: str) -> None:
    model, noise = small_model(), small_noise()
    measured, commands, _ = drawn_rows(DenseModel(model, noise), noise, 40, seed=6)
    rounded = STEP_A * np.rint(commands / STEP_A)
    knowing, told = ModalObserver(replace(model, effort_step=STEP_A), noise, kind), ModalObserver(model, noise, kind)  # type: ignore[arg-type]
    for k, z in enumerate(measured):
        knowing.step_measured(z, commands[max(k - 1, 0)])
        told.step_measured(z, rounded[max(k - 1, 0)])
        assert np.array_equal(knowing.state, told.state), f"row {k}"
    assert not np.array_equal(commands, rounded)


def test_tables_that_do_not_fit_are_refused_in_a_line() -> None:
    with pytest.raises(DesignError, match=r"coupling has shape \(2, 2, 3, 1\), \(2, 2, 4, 1\) fits"):
        replace(small_model(), coupling=np.ones((2, 2, 3, 1)))
    for step in (-1.0, np.inf, np.nan):
        with pytest.raises(DesignError, match="effort_step must be 2 finite numbers"):
            replace(small_model(), effort_step=np.array([0.005, step]))
