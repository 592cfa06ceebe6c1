"""Marker plates as measurements of the data-driven filter (thesis Sec. 6.4.2, case II): a swinging detector that no observer sees."""

from __future__ import annotations

import numpy as np
import pytest

from hil.calibration.data_driven.calibrate import calibrate_data
from hil.calibration.data_driven.observed_beam import ObservedBeam
from hil.calibration.data_driven.quasi_static import QuasiStatic, marker_view
from hil.calibration.data_driven.values import Measurement, Parameters
from hil.machine import load_machine

CARM = load_machine("carm")
MODEL = QuasiStatic.of(CARM)
DOWN = np.array([0.0, 0.0, -1.0])
ROWS, SECONDS = 512, 16.0
PLATE = np.array([2e-4, -3e-4, 4e-4, 1e-3, -2e-3, 5e-4])
SIGMA_9 = np.repeat([1e-4, 3e-5, 1e-4], 3)
SIGMA_6 = np.array([1.6e-4, 2.0e-4, 1.5e-5, 1.7e-4, 1.4e-4, 1e-5])
SEEN_TOGETHER = 15e-6
"""Of focal spot and angle a flat plate's image shows the sum far better than either."""

TURN = MODEL.names.index("detector_turn_x")
LASTS_s = 3.0  # so long an error of the observer's displacement lasts, most of which lies below 0.5 Hz


def marker_covariance() -> np.ndarray:
    """As a plate's images have it: f_x + Z theta_y and f_y - Z theta_x to micrometres, each alone to a tenth of a millimetre."""
    covariance = np.diag(SIGMA_6**2)
    for place, angle, sign in ((0, 4, -1.16), (1, 3, 1.16)):
        part = np.array([sign, 1.0]) * SIGMA_6[angle]
        covariance[np.ix_([place, angle], [place, angle])] = np.outer(part, part) + np.diag([SEEN_TOGETHER**2, 1e-12])
    return covariance


@pytest.fixture(scope="module")
def swinging() -> tuple[ObservedBeam, np.ndarray, np.ndarray]:
    """Path, and the true deviations of a machine whose parameters and swing are drawn from what the filter believes."""
    generator = np.random.default_rng(4)
    time = np.linspace(0.0, SECONDS, ROWS)
    places = np.column_stack([1.2 * np.sin(0.8 * time), 1.4 * np.sin(0.5 * time + 0.3)])
    observed = ObservedBeam(time, places, np.zeros((ROWS, 9)), np.tile(DOWN, (ROWS, 1)), np.repeat([2e-5, 3e-4], 3))
    parameters = generator.normal(size=len(MODEL.names)) * MODEL.prior
    parameters[MODEL.names.index("plate_place_x") :] = PLATE
    rows = MODEL.rows(places, observed.load)
    swing = 4e-4 * np.sin(2.0 * np.pi * 0.21 * time)
    moved = swing[:, None] * rows[:, :, TURN]
    return observed, rows @ parameters + moved, marker_view(moved) + np.einsum("nka,a->nk", MODEL.marker_rows(rows), parameters)


def seen(swinging: tuple[ObservedBeam, np.ndarray, np.ndarray], kind: str, every: int, first: int = 0, seed: int = 0) -> list[Measurement]:
    """Images of one kind."""
    observed, nine, six = swinging
    generator, covariance = np.random.default_rng(seed), np.diag(SIGMA_9**2) if kind == "phantom" else marker_covariance()
    truth = nine if kind == "phantom" else six
    return [
        Measurement(float(observed.time_s[k]), generator.multivariate_normal(truth[k], covariance), covariance, kind)
        for k in range(first, ROWS - 10, every)
    ]


def source_error(
    swinging: tuple[ObservedBeam, np.ndarray, np.ndarray], *sources: list[Measurement], **options: int
) -> tuple[np.ndarray, float]:
    """Rms over the second half, along u, v and w, of what is known at the time; and the reported deviation."""
    observed, nine, _ = swinging
    measurements = sorted((each for group in sources for each in group), key=lambda each: each.time_s)
    found = calibrate_data(MODEL, observed, measurements, Parameters.unknown(MODEL), late_s=0.0, **options)
    half = slice(ROWS // 2, ROWS - 10)
    error = (found.live - nine)[half, :3]
    return np.sqrt(np.mean(error**2, axis=0)), np.sqrt(np.mean((error / found.sigma[half, :3]) ** 2))


def test_the_plate_follows_a_source_that_swings_against_the_panel(swinging: tuple[ObservedBeam, np.ndarray, np.ndarray]) -> None:
    phantoms = seen(swinging, "phantom", 13)
    alone, _ = source_error(swinging, phantoms, most=20)
    with_plate, standard = source_error(swinging, phantoms, seen(swinging, "marker", 7, seed=1), most=20)
    assert np.hypot(*alone[:2]) > 0.25e-3  # 0.4 mrad over 1.16 m, swinging
    assert with_plate[1] < 0.6 * alone[1]
    assert with_plate[0] < 0.1e-3
    assert with_plate[2] < 0.1e-3
    assert 0.5 < standard < 1.5


def test_where_the_plate_is_mounted_is_found_with_the_phantom_and_not_without(
    swinging: tuple[ObservedBeam, np.ndarray, np.ndarray],
) -> None:
    observed, _, _ = swinging
    first = MODEL.names.index("plate_place_x")
    both = sorted([*seen(swinging, "phantom", 13), *seen(swinging, "marker", 7, seed=1)], key=lambda each: each.time_s)
    found = calibrate_data(MODEL, observed, both, Parameters.unknown(MODEL)).parameters
    lone = calibrate_data(MODEL, observed, seen(swinging, "marker", 7, seed=1), Parameters.unknown(MODEL)).parameters
    deviation = np.sqrt(np.diag(found.covariance))[first : first + 6]
    assert (np.abs(found.values[first : first + 6] - PLATE) < 3.5 * deviation).all()
    assert (deviation[:3] < 0.2e-3).all()
    assert np.sqrt(lone.covariance[first, first]) > 0.4e-3


def test_afterwards_every_sample_has_what_all_images_tell_of_it(swinging: tuple[ObservedBeam, np.ndarray, np.ndarray]) -> None:
    """Against the conditional mean of parameters and displacement together, all covariances written out."""
    observed, nine, _ = swinging
    plates, phantoms = seen(swinging, "marker", 17, seed=1), seen(swinging, "phantom", 61)
    images = sorted([*plates, *phantoms], key=lambda each: each.time_s)
    found = calibrate_data(MODEL, observed, images, Parameters.unknown(MODEL))
    assert found.used
    assert not found.changes
    at = np.searchsorted(observed.time_s, [each.time_s for each in images])
    of_phantom = MODEL.rows(observed.positions, observed.load)
    of_plate = MODEL.marker_rows(of_phantom)
    rows = [of_phantom[k] if each.kind == "phantom" else of_plate[k] for k, each in zip(at, images, strict=True)]
    twist = slice(MODEL.names.index("detector_place_x"), MODEL.names.index("detector_place_x") + 6)
    place = np.cumsum([0, *(len(each.values) for each in images)])
    gradient, values = np.vstack(rows), np.concatenate([each.values for each in images])
    spread = np.diag(observed.displacement_std**2)
    together = (gradient * MODEL.prior**2) @ gradient.T
    for i, one in enumerate(images):
        for j, other in enumerate(images):
            alike = np.exp(-abs(one.time_s - other.time_s) / LASTS_s) * spread
            together[place[i] : place[i + 1], place[j] : place[j + 1]] += rows[i][:, twist] @ alike @ rows[j][:, twist].T
        together[place[i] : place[i + 1], place[i] : place[i + 1]] += one.covariance
    weights = np.linalg.solve(together, values)
    parameters = MODEL.prior**2 * (gradient.T @ weights)
    for row in (0, 100, 301, ROWS - 1):
        strays = sum(
            np.exp(-abs(observed.time_s[row] - each.time_s) / LASTS_s) * spread @ part[:, twist].T @ weights[place[i] : place[i + 1]]
            for i, (each, part) in enumerate(zip(images, rows, strict=True))
        )
        expected = of_phantom[row] @ parameters + of_phantom[row][:, twist] @ strays
        assert np.abs(found.final[row] - expected).max() < 1e-9
    error = (found.final - nine)[50:-50, :2]
    assert (np.sqrt(np.mean(error**2, axis=0)) < 0.9 * np.sqrt(np.mean((found.live - nine)[50:-50, :2] ** 2, axis=0))).all()
