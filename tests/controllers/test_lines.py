"""The lines a band chooses are on the grid, in the band, and of the kind it promises."""

from __future__ import annotations

import numpy as np
import pytest
from examples import examples
from hypothesis import given, settings
from hypothesis import strategies as st

from controllers.errors import DesignError
from controllers.excitation_lines import Band, checked_lines

RATE_HZ, PERIOD = 256.0, 5120
SPACING_HZ = RATE_HZ / PERIOD

bands = st.builds(
    Band,
    low_Hz=st.floats(0.05, 5.0),
    high_Hz=st.floats(6.0, 120.0),
    per_decade=st.integers(0, 40),
    dense_Hz=st.lists(st.tuples(st.floats(0.1, 10.0), st.floats(10.1, 100.0)), max_size=2).map(tuple),
    odd=st.booleans(),
    one_free_in=st.sampled_from([0, 2, 3, 4]),
)


@given(band=bands, seed=st.integers(0, 5))
@settings(max_examples=examples(80), deadline=None)
def test_any_band_gives_ascending_lines_within_it(band: Band, seed: int) -> None:
    lines = band.lines(PERIOD, RATE_HZ, seed)
    assert (np.diff(lines) > 0).all()
    assert len(lines) > 0 or band.one_free_in
    if len(lines):
        assert lines[0] * SPACING_HZ >= band.low_Hz - 1e-6
        assert lines[-1] * SPACING_HZ <= band.high_Hz + 1e-6
        assert not band.odd or (lines % 2 == 1).all()
    assert np.array_equal(lines, band.lines(PERIOD, RATE_HZ, seed))


@given(band=bands.filter(lambda band: band.one_free_in), seed=st.integers(0, 5))
@settings(max_examples=examples(40), deadline=None)
def test_one_line_of_every_whole_group_stays_free(band: Band, seed: int) -> None:
    every = Band(band.low_Hz, band.high_Hz, band.per_decade, band.dense_Hz, band.odd).lines(PERIOD, RATE_HZ)
    lines = band.lines(PERIOD, RATE_HZ, seed)
    taken = np.isin(every, lines)
    whole = len(every) // band.one_free_in * band.one_free_in
    assert (taken[:whole].reshape(-1, band.one_free_in).sum(axis=1) == band.one_free_in - 1).all()
    assert taken[whole:].all()
    assert taken.sum() == len(lines)


def test_detection_lines_are_drawn_differently_by_seed() -> None:
    band = Band(one_free_in=3)
    assert not np.array_equal(band.lines(PERIOD, RATE_HZ, 0), band.lines(PERIOD, RATE_HZ, 1))


def test_the_default_band_is_odd_and_every_odd_line() -> None:
    lines = Band(0.15, 40.0).lines(PERIOD, RATE_HZ)
    assert np.array_equal(lines, np.arange(3, 800, 2))


def test_a_logarithmic_band_is_dense_where_asked() -> None:
    lines = Band(0.1, 100.0, per_decade=10, dense_Hz=((7.0, 9.0),), odd=False).lines(PERIOD, RATE_HZ)
    frequencies = lines * SPACING_HZ
    assert np.isin(np.arange(140, 181), lines).all()
    outside = frequencies[(frequencies > 10.0)]
    ratios = outside[1:] / outside[:-1]
    assert ratios.max() < 10**0.1 * 1.02
    assert ratios.min() > 10**0.1 * 0.98


@pytest.mark.parametrize(
    ("band", "says"),
    [
        (Band(0.1, 200.0), "128"),
        (Band(5.0, 1.0), "ascend"),
        (Band(1.01, 1.04), "no line of the 0.05 Hz grid"),
        (Band(one_free_in=5), "2, 3 or 4"),
        (Band(per_decade=5, dense_Hz=((9.0, 7.0),)), "dense band 9 to 7"),
    ],
)
def test_a_band_that_cannot_be_is_refused(band: Band, says: str) -> None:
    with pytest.raises(DesignError, match=says):
        band.lines(PERIOD, RATE_HZ)


@pytest.mark.parametrize(
    ("lines", "says"), [((), "no line"), ((0, 3), "line 0"), ((3, 2560), r"line 2560.*1 to 2559"), ((5, 7, 5), "line 5 is listed twice")]
)
def test_explicit_lines_that_cannot_be_are_refused(lines: tuple[int, ...], says: str) -> None:
    with pytest.raises(DesignError, match=says):
        checked_lines(lines, PERIOD)
