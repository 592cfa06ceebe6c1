"""The whitening filter against dense linear algebra: transitions, innovations, smoothed states, levels of noise."""

import numpy as np
import pytest
import scipy.linalg

from hil.diagnosis.residuals.discretisation import discretised
from hil.diagnosis.residuals.whitening import Linearised, smooth_states, whitening

ROWS, STATES, CHANNELS = 12, 3, 2
SEED = 9


@pytest.fixture
def linearised() -> Linearised:
    rng = np.random.default_rng(SEED)
    transition = rng.normal(0.0, 0.4, (4, STATES, STATES)) + 0.5 * np.eye(STATES)
    return Linearised(
        stride=3,
        transition=transition,
        of_effort=rng.normal(size=(4, STATES, 1)),
        of_rise=rng.normal(size=(4, STATES, 1)),
        observation=rng.normal(size=(4, CHANNELS, STATES)),
        through=rng.normal(size=(4, CHANNELS, 1)),
        noise=np.array([0.3, 0.7]),
        process=np.array([0.0, 0.2, 0.5]),
        start=np.array([1.0, 0.5, 2.0]),
    )


def dense(linearised: Linearised, present: np.ndarray, extra: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Covariance of the readings that there are, and of all states with all readings."""
    inputs = STATES * ROWS
    states = np.zeros((ROWS, STATES, inputs))
    states[0, :, :STATES] = np.eye(STATES)
    for k in range(ROWS - 1):
        states[k + 1] = linearised.transition[k // 3] @ states[k]
        states[k + 1, :, STATES * (k + 1) : STATES * (k + 2)] += np.eye(STATES)
    variances = np.concatenate([linearised.start, np.tile(linearised.process, ROWS - 1)])
    if extra is not None:  # after each row
        variances[STATES:] += extra[:-1].ravel()
    observed = np.concatenate([linearised.observation[k // 3] @ states[k] for k in range(ROWS)])
    covariance = (observed * variances) @ observed.T + np.diag(np.tile(linearised.noise, ROWS))
    return covariance[np.ix_(present.ravel(), present.ravel())], states * variances @ observed.T


@pytest.mark.parametrize("some_missing", [False, True])
def test_innovations_have_the_likelihood_of_the_whole_covariance(linearised: Linearised, some_missing: bool) -> None:
    print(f"seed {SEED}")
    rng = np.random.default_rng(SEED + 1)
    present = np.ones((ROWS, CHANNELS), dtype=bool)
    if some_missing:
        present[3, 1] = present[7] = False
    filtered = whitening(linearised, present)
    columns = rng.normal(size=(ROWS, CHANNELS, 2)) * present[..., None]
    nothing = np.zeros((ROWS, 1, 2))
    out = np.zeros((ROWS * CHANNELS, 2))
    filtered.columns(nothing, nothing, columns, 0, np.zeros((STATES, 2)), out)
    covariance, _ = dense(linearised, present)
    flat = columns.reshape(-1, 2)[present.ravel()]
    np.testing.assert_allclose(out.T @ out, flat.T @ np.linalg.solve(covariance, flat), rtol=1e-9)
    assert filtered.log_determinant == pytest.approx(np.linalg.slogdet(covariance)[1], rel=1e-9)
    assert filtered.readings == present.sum()


def test_efforts_are_taken_off_what_they_bring_about(linearised: Linearised) -> None:
    rng = np.random.default_rng(SEED + 2)
    start, end = rng.normal(size=(2, ROWS, 1, 1))
    state, readings = np.zeros(STATES), np.zeros((ROWS, CHANNELS, 1))
    for k in range(ROWS):
        readings[k, :, 0] = linearised.observation[k // 3] @ state + linearised.through[k // 3] @ start[k, :, 0]
        rise = end[k, :, 0] - start[k, :, 0]
        state = linearised.transition[k // 3] @ state + linearised.of_effort[k // 3] @ start[k, :, 0] + linearised.of_rise[k // 3] @ rise
    filtered = whitening(linearised, np.ones((ROWS, CHANNELS), dtype=bool))
    out = np.zeros((ROWS * CHANNELS, 1))
    filtered.columns(start, end, readings, 0, np.zeros((STATES, 1)), out)
    np.testing.assert_allclose(out, 0.0, atol=1e-12)


def test_columns_may_pass_in_several_parts(linearised: Linearised) -> None:
    rng = np.random.default_rng(SEED + 3)
    efforts, ends, readings = rng.normal(size=(ROWS, 1, 4)), rng.normal(size=(ROWS, 1, 4)), rng.normal(size=(ROWS, CHANNELS, 4))
    filtered = whitening(linearised, np.ones((ROWS, CHANNELS), dtype=bool))
    whole, parts = np.zeros((ROWS * CHANNELS, 4)), np.zeros((ROWS * CHANNELS, 4))
    filtered.columns(efforts, ends, readings, 0, np.zeros((STATES, 4)), whole)
    state = np.zeros((STATES, 4))
    for first in (0, 5):
        rows = slice(first, 5 if first == 0 else ROWS)
        filtered.columns(efforts[rows], ends[rows], readings[rows], first, state, parts[rows.start * CHANNELS : rows.stop * CHANNELS])
    np.testing.assert_allclose(parts, whole)


@pytest.mark.parametrize("some_missing", [False, True])
@pytest.mark.parametrize("some_more_unsure", [False, True])
def test_smoothed_states_are_the_conditional_means(linearised: Linearised, some_missing: bool, some_more_unsure: bool) -> None:
    rng = np.random.default_rng(SEED + 4)
    present = np.ones((ROWS, CHANNELS), dtype=bool)
    if some_missing:
        present[3, 1] = present[7] = False
    extra = rng.uniform(0.0, 5.0, (ROWS, STATES)) if some_more_unsure else None
    readings = rng.normal(size=(ROWS, CHANNELS)) * present
    nothing = np.zeros((ROWS, 1))
    states, deviations = smooth_states(whitening(linearised, present, extra), nothing, nothing, readings, present)
    covariance, across = dense(linearised, present, extra)
    across = across[:, :, present.ravel()]
    np.testing.assert_allclose(states, across @ np.linalg.solve(covariance, readings.ravel()[present.ravel()]), atol=1e-9)
    before = np.diag(linearised.start)
    after = before - across[0] @ np.linalg.solve(covariance, across[0].T)
    np.testing.assert_allclose(deviations[0], np.sqrt(np.diag(after)), rtol=1e-7)


def test_a_period_of_masses_springs_and_low_passes_is_the_matrix_exponential() -> None:
    inverse = np.linalg.inv(np.array([[2.0, 0.3], [0.3, 1.0]]))
    stiffness, damping = np.array([[900.0, -100.0], [-100.0, 400.0]]), np.array([[3.0, 0.2], [-0.2, 1.0]])
    felt, through, corner, period = np.array([[1.0, 2.0, 0.5, -0.5]]), np.array([[0.7, -0.4]]), np.array([60.0]), 0.01
    moved, held, risen = np.zeros((1, 7, 7)), np.zeros((1, 7, 2)), np.zeros((1, 7, 2))
    discretised(period, inverse[None], stiffness[None], damping[None], felt[None], through[None], corner, moved, held, risen)
    system = np.zeros((9, 9))  # positions, speeds, low pass, efforts, their rise
    system[:2, 2:4] = np.eye(2)
    system[2:4, :2], system[2:4, 2:4], system[2:4, 5:7] = -inverse @ stiffness, -inverse @ damping, inverse
    system[4, :4], system[4, 4], system[4, 5:7] = corner * felt, -corner[0], corner * through
    system[5:7, 7:9] = np.eye(2) / period
    exact = scipy.linalg.expm(system * period)
    order = [0, 1, 2, 3, 6]  # of the module: positions, speeds, efforts, low pass
    np.testing.assert_allclose(moved[0][np.ix_(order, order)], exact[:5, :5], atol=1e-11)
    np.testing.assert_allclose(held[0][order], exact[:5, 5:7], atol=1e-11)
    np.testing.assert_allclose(risen[0][order], exact[:5, 7:9], atol=1e-11)
