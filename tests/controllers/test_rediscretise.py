"""Sections carried to another sample rate are what the continuous term is there, by SciPy's and python-control's own maps."""

from __future__ import annotations

import math

import control
import numpy as np
import pytest
import scipy.signal
from hypothesis import given
from hypothesis import strategies as st

from controllers import loop_shaping
from controllers.errors import DesignError
from controllers.rediscretise import rediscretised, rediscretised_share
from controllers.sections import integrates, response

OLD_HZ = 256.0
RATES_HZ = (128.0, 200.0, 512.0, 1000.0)
ALIKE = 0.15
"""Relative difference of the responses below a tenth of both rates: two poles and two zeros, warped by 2.6 % each there, and corners up to
a quarter of the lowest rate."""


def section_of(numerator: np.ndarray, denominator: np.ndarray) -> np.ndarray:
    section = np.zeros((1, 6))
    section[0, : len(numerator)] = numerator
    section[0, 3 : 3 + len(denominator)] = denominator
    return section


@pytest.mark.parametrize("rate_Hz", RATES_HZ)
def test_prewarped_terms_become_their_own_design_at_the_new_rate(rate_Hz: float) -> None:
    for term in (
        lambda rate: loop_shaping.lead(3.7, 76.0, rate),
        lambda rate: loop_shaping.notch(22.0, 0.2, 0.5, rate),
        lambda rate: loop_shaping.lowpass(40.0, 0.7, rate),
        lambda _: loop_shaping.gain(3.0),
    ):
        np.testing.assert_allclose(rediscretised(term(OLD_HZ), OLD_HZ, rate_Hz), term(rate_Hz), rtol=1e-11, atol=1e-12)


@pytest.mark.parametrize("rate_Hz", RATES_HZ)
def test_sections_of_python_control_become_its_own_at_the_new_rate(rate_Hz: float) -> None:
    w = 2.0 * np.pi * 15.0
    term = control.tf([1.0, 0.04 * w, w * w], [1.0, 1.2 * w, w * w])
    old, new = (control.c2d(term, 1.0 / rate, "tustin", prewarp_frequency=w) for rate in (OLD_HZ, rate_Hz))
    section = section_of(old.num[0][0], old.den[0][0])
    np.testing.assert_allclose(rediscretised(section, OLD_HZ, rate_Hz), section_of(new.num[0][0], new.den[0][0]), atol=1e-11)


def test_a_section_without_corner_is_scipys_bilinear_map() -> None:
    integrator = section_of(*scipy.signal.bilinear([5.0], [1.0, 0.0], OLD_HZ))
    expected = section_of(*scipy.signal.bilinear([5.0], [1.0, 0.0], 100.0))
    np.testing.assert_allclose(rediscretised(integrator, OLD_HZ, 100.0), expected, rtol=1e-12, atol=1e-15)


@pytest.mark.parametrize("rate_Hz", RATES_HZ)
def test_a_section_of_matched_poles_and_zeros_becomes_nearly_that_of_the_new_rate(rate_Hz: float) -> None:
    term = control.tf([1.0, 2.0 * np.pi * 2.0], [1.0, 2.0 * np.pi * 9.0])
    old, new = (section_of(d.num[0][0], d.den[0][0]) for d in (control.c2d(term, 1.0 / rate, "matched") for rate in (OLD_HZ, rate_Hz)))
    frequencies = np.linspace(0.1, 0.1 * min(rate_Hz, OLD_HZ), 50)
    carried = response(rediscretised(old, OLD_HZ, rate_Hz), frequencies, rate_Hz)
    np.testing.assert_allclose(carried, response(new, frequencies, rate_Hz), rtol=0.03)


corners = st.floats(0.05, 32.0)
pairs = st.tuples(corners, st.floats(0.05, 0.95)).map(lambda pair: ("pair", *pair))
reals = st.tuples(corners, corners).map(lambda two: ("real", *two))
factors = st.one_of(pairs, reals, st.just(("none",)))


def polynomial(factor: tuple[object, ...]) -> np.ndarray:
    """Of v, highest power first, with corners in Hz at the old rate."""
    if factor[0] == "pair":
        size = math.tan(math.pi * factor[1] / OLD_HZ)
        return np.array([1.0 / size**2, 2.0 * factor[2] / size, 1.0])
    if factor[0] == "real":
        return np.convolve(*([1.0 / math.tan(math.pi * corner / OLD_HZ), 1.0] for corner in factor[1:]))
    return np.array([1.0])


@st.composite
def sections(draw: st.DrawFn) -> np.ndarray:
    """A section with poles and zeros up to 32 Hz, with or without an integrator; missing zeros are at half the rate."""
    gain = draw(st.floats(0.01, 1000.0))
    if draw(st.booleans()):
        corner, filtered = (math.tan(math.pi * draw(corners) / OLD_HZ) for _ in range(2))
        numerator, denominator = polynomial(draw(factors)), np.convolve([1.0, 0.0], [1.0 / filtered, 1.0])
        numerator = numerator if len(numerator) > 1 else np.array([1.0 / corner, 1.0])
    else:
        numerator, denominator = polynomial(draw(factors)), polynomial(draw(st.one_of(pairs, reals)))
    return section_of(*scipy.signal.bilinear(gain * numerator, denominator, 0.5))  # s = v


@given(section=sections(), rate_Hz=st.sampled_from(RATES_HZ))
def test_there_and_back_gives_the_same_response(section: np.ndarray, rate_Hz: float) -> None:
    back = rediscretised(rediscretised(section, OLD_HZ, rate_Hz), rate_Hz, OLD_HZ)
    frequencies = np.geomspace(0.1, 0.1 * min(rate_Hz, OLD_HZ), 40)
    np.testing.assert_allclose(response(back, frequencies, OLD_HZ), response(section, frequencies, OLD_HZ), rtol=1e-6)


@given(section=sections(), rate_Hz=st.sampled_from(RATES_HZ))
def test_below_a_tenth_of_the_rates_the_response_is_alike(section: np.ndarray, rate_Hz: float) -> None:
    frequencies = np.geomspace(0.1, 0.1 * min(rate_Hz, OLD_HZ), 40)
    ratio = response(rediscretised(section, OLD_HZ, rate_Hz), frequencies, rate_Hz) / response(section, frequencies, OLD_HZ)
    assert np.abs(ratio - 1.0).max() < ALIKE


@given(section=sections(), rate_Hz=st.sampled_from(RATES_HZ))
def test_static_and_integral_gains_stay_and_integrators_stand_at_1(section: np.ndarray, rate_Hz: float) -> None:
    carried = rediscretised(section, OLD_HZ, rate_Hz)
    b, a, carried_b, carried_a = section[0, :3], section[0, 3:], carried[0, :3], carried[0, 3:]
    if integrates(section)[0]:
        assert carried_a.sum() == 0.0  # not nearly
        per_second = OLD_HZ * b.sum() / (2.0 * a[0] + a[1])  # b(1) / a'(1) over the period
        assert rate_Hz * carried_b.sum() / (2.0 * carried_a[0] + carried_a[1]) == pytest.approx(per_second, rel=1e-6)
    else:
        assert carried_b.sum() / carried_a.sum() == pytest.approx(b.sum() / a.sum(), rel=1e-6)


@pytest.mark.parametrize("rate_Hz", RATES_HZ)
def test_a_first_order_integrator_has_the_same_denominator_at_every_rate(rate_Hz: float) -> None:
    lag = rediscretised(loop_shaping.lag(0.0, 0.1, OLD_HZ), OLD_HZ, rate_Hz)
    assert lag[0, 2:].tolist() == [0.0, 1.0, -1.0, 0.0]
    np.testing.assert_allclose(lag, loop_shaping.lag(0.0, 0.1, rate_Hz), rtol=1e-5)


@given(at_Hz=st.floats(2.0, 60.0), depth=st.floats(0.01, 0.5), rate_Hz=st.sampled_from(RATES_HZ))
def test_a_notch_stays_where_it_is_and_as_deep(at_Hz: float, depth: float, rate_Hz: float) -> None:
    carried = rediscretised(loop_shaping.notch(at_Hz, depth, 0.3, OLD_HZ), OLD_HZ, rate_Hz)
    near = np.abs(response(carried, at_Hz * np.array([0.99, 1.0, 1.01]), rate_Hz))
    assert near[1] == pytest.approx(depth, rel=1e-6)
    assert near[1] == near.min()


@pytest.mark.parametrize(
    ("section", "rate_Hz", "says"),
    [
        (loop_shaping.notch(64.0, 0.1, 0.3, OLD_HZ), 128.0, "section 2: zero at 64 Hz; at 128 Hz it must lie below 64 Hz"),
        (loop_shaping.lowpass(80.0, 0.7, OLD_HZ), 128.0, "section 2: pole at 80 Hz; at 128 Hz it must lie below 64 Hz"),
        (np.array([[0.0, 1.0, 0.0, 1.0, 0.0, 0.0]]), 128.0, "section 2: zero at 64 Hz"),  # a delay
        (np.array([[1.0, 0.0, 0.0, 1.0, 1.0, 0.0]]), 512.0, "section 2: pole at 128 Hz; at 512 Hz it must lie below 128 Hz"),
    ],
)
def test_what_lies_beyond_half_the_new_rate_is_refused(section: np.ndarray, rate_Hz: float, says: str) -> None:
    with pytest.raises(DesignError, match=says):
        rediscretised(np.vstack([loop_shaping.gain(2.0), section]), OLD_HZ, rate_Hz)


@pytest.mark.parametrize("rate_Hz", RATES_HZ)
def test_the_share_of_a_speed_filter_keeps_its_corner(rate_Hz: float) -> None:
    w = 2.0 * np.pi * 11.6
    poles = [
        control.c2d(control.tf([w], [1.0, w]), 1.0 / rate, "tustin", prewarp_frequency=w).poles()[0].real for rate in (OLD_HZ, rate_Hz)
    ]
    assert rediscretised_share(1.0 - poles[0], OLD_HZ, rate_Hz) == pytest.approx(1.0 - poles[1], rel=1e-9)


def test_no_speed_filter_stays_none_and_one_too_fast_is_refused() -> None:
    assert rediscretised_share(1.0, OLD_HZ, 128.0) == 1.0
    with pytest.raises(DesignError, match="must lie below 32 Hz"):
        rediscretised_share(0.7, OLD_HZ, 128.0)
