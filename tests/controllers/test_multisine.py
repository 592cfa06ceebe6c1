"""Multisines have the rms and lines asked for, experiments are orthogonal, phases random, and crest factors low when asked."""

from __future__ import annotations

import numpy as np
import pytest
from examples import examples
from hypothesis import given, settings
from hypothesis import strategies as st

from controllers.errors import DesignError
from controllers.hadamard_experiments import mixing_matrix
from controllers.multisine import Multisine, crest_factor, multisine

PERIOD = 1024
LINES = np.arange(3, 160, 2)


def spectra(drawn: Multisine) -> np.ndarray:
    """W(k) as (n_lines, n_inputs, n_experiments), measured from the signals: sines of amplitude |W|."""
    return (np.fft.rfft(drawn.signals)[:, :, drawn.lines] * 2j / drawn.signals.shape[-1]).transpose(2, 1, 0)


@pytest.mark.parametrize("phases", ["random", "optimised"])
@pytest.mark.parametrize("inputs", [1, 2, 3, 4])
def test_every_input_has_its_rms_in_every_experiment_and_nothing_between_the_lines(inputs: int, phases: str) -> None:
    rms = np.linspace(0.5, 2.0, inputs)
    drawn = multisine(LINES, rms, PERIOD, phases=phases)
    np.testing.assert_allclose(np.sqrt(np.mean(drawn.signals**2, axis=-1)), np.tile(rms, (inputs, 1)), rtol=1e-12)
    free = np.setdiff1d(np.arange(PERIOD // 2 + 1), LINES)
    assert np.abs(np.fft.rfft(drawn.signals)[:, :, free]).max() < 1e-9
    np.testing.assert_allclose(spectra(drawn), drawn.spectrum, atol=1e-12)


@pytest.mark.parametrize("phases", ["random", "optimised"])
@pytest.mark.parametrize("inputs", [2, 3, 4])
def test_experiments_are_orthogonal_at_every_line(inputs: int, phases: str) -> None:
    rms = np.linspace(0.5, 2.0, inputs)
    w = spectra(multisine(LINES, rms, PERIOD, phases=phases))
    product = w @ w.conj().transpose(0, 2, 1)
    # per line: n_u experiments of amplitude sqrt(2/n_lines) rms each
    expected = np.diag(inputs * 2.0 / len(LINES) * rms**2)
    np.testing.assert_allclose(product, np.broadcast_to(expected, product.shape), atol=1e-12)


@pytest.mark.parametrize("inputs", [1, 2, 3, 4, 5, 8])
def test_the_mixing_matrix_is_unitary(inputs: int) -> None:
    mix = mixing_matrix(inputs, "orthogonal")
    np.testing.assert_allclose(mix @ mix.conj().T, np.eye(inputs), atol=1e-14)


def test_single_input_experiments_excite_one_input_each() -> None:
    drawn = multisine(LINES, np.array([1.0, 2.0]), PERIOD, mixing="single")
    assert np.array_equal(np.abs(drawn.signals).max(axis=-1) > 0.0, np.eye(2, dtype=bool))
    assert np.array_equal(drawn.crest_factor > 0.0, np.eye(2, dtype=bool))


@given(weights=st.lists(st.floats(0.01, 10.0), min_size=len(LINES), max_size=len(LINES)))
@settings(max_examples=examples(20), deadline=None)
def test_weights_shape_the_lines_and_leave_the_rms(weights: list[float]) -> None:
    drawn = multisine(LINES, np.array([1.5]), PERIOD, weights=np.array(weights))
    size = np.abs(spectra(drawn)[:, 0, 0])
    np.testing.assert_allclose(size / size[0], np.array(weights) / weights[0], rtol=1e-9)
    assert np.sqrt(np.mean(drawn.signals**2)) == pytest.approx(1.5)


@pytest.mark.nightly
@pytest.mark.parametrize("phases", ["random", "optimised"])
def test_phases_have_no_mean_over_realisations(phases: str) -> None:
    # |mean of M unit vectors| has rms 1/sqrt(M); (3.8) asks for E exp(i phi) = 0
    units = np.array(
        [np.exp(1j * np.angle(spectra(multisine(LINES[:20], np.ones(2), 128, realisation=m, phases=phases)))) for m in range(100)]
    )
    size = np.abs(units.mean(axis=0))
    assert np.sqrt(np.mean(size**2)) < 1.25 / np.sqrt(100)


def test_realisations_and_seeds_differ_and_repeat() -> None:
    first = multisine(LINES, np.ones(2), PERIOD, seed=3, realisation=1).signals
    assert np.array_equal(first, multisine(LINES, np.ones(2), PERIOD, seed=3, realisation=1).signals)
    assert not np.allclose(first, multisine(LINES, np.ones(2), PERIOD, seed=3, realisation=2).signals)
    assert not np.allclose(first, multisine(LINES, np.ones(2), PERIOD, seed=4, realisation=1).signals)


def test_crest_factors_of_known_signals() -> None:
    t = np.arange(1000) / 1000
    assert crest_factor(np.sin(2 * np.pi * 10 * t)) == pytest.approx(np.sqrt(2.0), rel=1e-3)
    assert crest_factor(np.sign(np.sin(2 * np.pi * 10 * t + 0.1))) == pytest.approx(1.0)
    assert crest_factor(np.zeros(10)) == 0.0


def test_optimised_phases_beat_schroeders_and_random_ones() -> None:
    lines = np.arange(1, 32)
    t = np.arange(PERIOD) / PERIOD
    schroeder = sum(np.cos(2 * np.pi * k * t - np.pi * k * (k - 1) / 31) for k in lines)
    optimised = multisine(lines, np.ones(1), PERIOD, phases="optimised").crest_factor[0, 0]
    assert 1.6 < crest_factor(schroeder) < 1.8  # Schroeder 1970: about 1.7 for a flat spectrum
    assert optimised < crest_factor(schroeder) - 0.1
    assert multisine(lines, np.ones(1), PERIOD).crest_factor[0, 0] > 2.0


@pytest.mark.parametrize(("inputs", "reached"), [(2, 2.0), (3, 2.3)])
def test_orthogonal_experiments_are_optimised_together(inputs: int, reached: float) -> None:
    rms = np.linspace(1.0, 2.0, inputs)
    random, optimised = (multisine(LINES, rms, PERIOD, phases=phases).crest_factor for phases in ("random", "optimised"))
    assert random.max() > 2.7
    assert optimised.max() < reached


@pytest.mark.parametrize(
    ("lines", "rms", "weights", "says"),
    [
        ([512], [1.0], None, "1 to 511"),
        ([3, 5], [1.0, -1.0], None, "positive"),
        ([3, 5], [np.nan], None, "positive"),
        ([3, 5], [1.0], [1.0], "weights"),
        ([3, 5], [1.0], [1.0, 0.0], "weights"),
    ],
)
def test_what_cannot_be_excited_is_refused(lines: list[int], rms: list[float], weights: list[float] | None, says: str) -> None:
    with pytest.raises(DesignError, match=says):
        multisine(np.array(lines), np.array(rms), PERIOD, weights=None if weights is None else np.array(weights))
