"""The shaper sample by sample: the same as by convolution, without a jump when it is switched, within limits, and indifferent to gaps."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.signal
from examples import examples
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as st_arrays

from controllers.errors import DesignError
from controllers.settings import AxisLimits
from controllers.shapers.delays import DelayFilter
from controllers.shapers.dynamics import Dynamics
from controllers.shapers.filter import ReferenceShaper
from controllers.shapers.sampled import AxisShaper, axis_shaper

RATE = 256.0
AXES = ("propeller", "roll")
FREE = tuple(AxisLimits(axis, -10.0, 10.0, 1e6, np.inf, np.inf, 1.0) for axis in AXES)


def shaper_of(
    gains: list[float | list[float]] | np.ndarray, delays: list[int] | np.ndarray, axis: str = "roll", **fields: object
) -> AxisShaper:
    return AxisShaper(axis, np.asarray(delays), np.atleast_2d(gains), np.asarray(fields.pop("positions", [0.0])), **fields)


def run(shaper: ReferenceShaper, raw: np.ndarray, start: np.ndarray) -> np.ndarray:
    shaper.start(start)
    out = np.empty_like(raw)
    for k in range(len(raw)):
        shaper.step(raw[k], out[k])
    return out


@given(
    gains=st_arrays.arrays(float, 5, elements=st.floats(-2.0, 2.0)),
    delays=st.lists(st.integers(1, 60), min_size=5, max_size=5, unique=True),
    start=st.floats(-1.0, 1.0),
)
@settings(max_examples=examples(30), deadline=None)
def test_it_is_the_convolution_with_its_taps_from_a_standstill(gains: np.ndarray, delays: list[int], start: float) -> None:
    gains = np.append(gains, 1.0 - gains.sum())
    delays = np.array([0, *sorted(delays)])
    raw = np.tile([0.3, start], (200, 1))
    raw[:, 1] += np.cumsum(np.random.default_rng(0).standard_normal(200)) * 0.01
    shaped = run(ReferenceShaper(AXES, [shaper_of(gains, delays)], FREE, RATE), raw, np.array([0.3, start]))
    padded = np.concatenate([np.full(60, start), raw[:, 1]])
    expected = sum(gain * padded[60 - delay : 60 - delay + 200] for gain, delay in zip(gains, delays, strict=True))
    assert shaped[:, 1] == pytest.approx(expected, abs=1e-12)
    assert (shaped[:, 0] == raw[:, 0]).all()  # an axis without a shaper passes


def test_standstill_is_held_to_the_last_bit() -> None:
    gains = np.array([0.7, -0.5, 0.8])
    raw = np.tile([0.1, 0.3], (300, 1))
    shaped = run(ReferenceShaper(AXES, [shaper_of(gains, [0, 7, 19])], FREE, RATE), raw, raw[0])
    assert (shaped == raw).all()


def test_the_tail_filters_the_last_tap() -> None:
    system = Dynamics.from_polynomials([0.1, 0.0], [1.0, -0.9], 1.0 / RATE)
    shaper = axis_shaper("roll", [DelayFilter(np.array([0.0, 10.0]) / RATE, np.array([0.4, 0.6]), system)], RATE)
    raw = np.tile([0.0, 0.5], (100, 1))
    raw[20:, 1] = 1.5
    shaped = run(ReferenceShaper(AXES, [shaper], FREE, RATE), raw, raw[0])
    late = np.concatenate([np.zeros(10), raw[:90, 1] - 0.5])
    expected = 0.5 + 0.4 * (raw[:, 1] - 0.5) + 0.6 * scipy.signal.lfilter([0.1], [1.0, -0.9], late)
    assert shaped[:, 1] == pytest.approx(expected, abs=1e-12)


def test_gains_are_interpolated_over_the_scheduling_axis_and_held_beyond_its_ends() -> None:
    gains = np.array([[1.0, 0.0], [0.5, 0.5], [0.2, 0.8]])
    shaper = shaper_of(gains, [0, 4], axis="propeller", positions=[-1.0, 0.0, 1.0], schedule_axis="roll")
    for roll, first in ((-2.0, 1.0), (-1.0, 1.0), (-0.5, 0.75), (0.0, 0.5), (0.5, 0.35), (1.0, 0.2), (3.0, 0.2)):
        raw = np.tile([0.0, roll], (6, 1))
        raw[1:, 0] = 1.0
        shaped = run(ReferenceShaper(AXES, [shaper], FREE, RATE), raw, raw[0])
        assert shaped[1, 0] == pytest.approx(first, abs=1e-12)


def test_switching_on_the_way_makes_no_jump_in_position_or_speed() -> None:
    shaper = ReferenceShaper(AXES, [shaper_of([2.0, -1.0, -0.5, 0.5], [0, 20, 30, 40])], FREE, RATE)
    times = np.arange(1500) / RATE
    raw = np.column_stack([np.zeros(1500), 0.5 * np.sin(2.0 * times)])
    shaper.start(raw[0], on=False)
    out = np.empty_like(raw)
    for k in range(1500):
        if k == 400:
            shaper.switch(True)
        if k == 900:
            shaper.switch(False)
        shaper.step(raw[k], out[k])
    fade_s = 0.5  # the design value: half a second from raw to shaped
    blend = round(fade_s * RATE)
    assert (out[:400] == raw[:400]).all()
    assert (out[900 + blend :] == raw[900 + blend :]).all()
    always = run(ReferenceShaper(AXES, [shaper_of([2.0, -1.0, -0.5, 0.5], [0, 20, 30, 40])], FREE, RATE), raw, raw[0])
    assert out[400 + blend : 900] == pytest.approx(always[400 + blend : 900], abs=1e-14)
    apart = np.abs(always - raw).max()
    acceleration = np.abs(np.diff(out[:, 1], 2)).max() * RATE**2
    by_itself = max(np.abs(np.diff(each[50:, 1], 2)).max() for each in (raw, always)) * RATE**2
    assert acceleration < by_itself + apart * 5.78 / fade_s**2 + 4.0 * 1.9 / fade_s


def test_range_and_speed_are_held_whatever_comes() -> None:
    limits = (FREE[0], AxisLimits("roll", -1.0, 1.0, 2.0, 10.0, 100.0, 0.1))
    shaper = ReferenceShaper(AXES, [shaper_of([3.0, -2.0], [0, 10])], limits, RATE)
    raw = np.zeros((200, 2))
    raw[50:, 1] = 0.9
    shaper.start(raw[0])
    out, masks = np.empty_like(raw), []
    for k in range(200):
        masks.append(shaper.step(raw[k], out[k]))
    assert np.abs(out[:, 1]).max() <= 1.0
    assert np.abs(np.diff(out[:, 1])).max() <= 2.0 / RATE * (1 + 1e-12)
    assert masks[10] == 0
    assert masks[50] == 0b10
    assert out[-1, 1] == 0.9


def test_a_missing_reference_repeats_the_last_one() -> None:
    raw = np.tile([0.0, 0.2], (100, 1))
    gap = raw.copy()
    gap[40:45, 1] = np.nan
    shaper = [shaper_of([0.5, 0.5], [0, 8])]
    through = [run(ReferenceShaper(AXES, shaper, FREE, RATE), each, raw[0]) for each in (gap, raw)]
    assert (through[0] == through[1]).all()


def test_a_shaper_that_would_end_a_move_elsewhere_is_refused() -> None:
    with pytest.raises(DesignError, match=r"H\(0\) = 0\.03"):
        ReferenceShaper(AXES, [shaper_of([0.3970, -0.0087, -0.3583], [0, 569, 1138])], FREE, RATE)
    with pytest.raises(DesignError, match=r"H\(0\) = 0\.9"):
        ReferenceShaper(AXES, [shaper_of([0.5, 0.5], [0, 8], static_gain=0.9)], FREE, RATE)


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"delays": [0, 5, 5]}, "delays must rise"),
        ({"gains": [[1.0, 2.0]]}, "do not fit"),
        ({"gains": [[0.5, np.nan, 0.5]]}, "finite"),
        ({"positions": [0.0, 1.0], "gains": [[1.0, 0.0, 0.0]] * 2}, "a schedule takes"),
        ({"tail": np.ones((1, 5))}, "second-order sections"),
    ],
)
def test_what_is_no_shaper_is_refused(fields: dict[str, list[float | list[float]] | np.ndarray], message: str) -> None:
    given_fields = {"gains": [[0.5, 0.2, 0.3]], "delays": [0, 5, 9]} | fields
    with pytest.raises(DesignError, match=message):
        shaper_of(given_fields.pop("gains"), given_fields.pop("delays"), **given_fields)


def test_unknown_and_doubled_axes_are_refused() -> None:
    with pytest.raises(DesignError, match="no axis 'yaw'"):
        ReferenceShaper(AXES, [shaper_of([1.0], [0], axis="yaw")], FREE, RATE)
    with pytest.raises(DesignError, match="more than one"):
        ReferenceShaper(AXES, [shaper_of([1.0], [0])] * 2, FREE, RATE)


def test_delays_between_samples_are_refused() -> None:
    with pytest.raises(DesignError, match="no whole samples"):
        axis_shaper("roll", [DelayFilter(np.array([0.0, 0.0101]), np.array([0.5, 0.5]))], RATE)
