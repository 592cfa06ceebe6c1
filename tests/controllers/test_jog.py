"""A jog is on the grid, grows from standstill, repeats exactly, and says what an even line costs."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from controllers.errors import DesignError
from controllers.jog import jog, jog_line, odd_even_split

RATE_HZ, PERIOD = 256.0, 5120


def test_the_default_jog_is_on_line_one_of_twenty_seconds() -> None:
    assert jog_line(0.05, PERIOD, RATE_HZ) == 1


def test_the_theses_half_jog_is_refused_with_the_nearest_frequency() -> None:
    with pytest.raises(DesignError, match=r"0\.05 Hz is off the grid of 0\.1 Hz.*holds 0\.5 jogs.*0\.1 Hz"):
        jog_line(0.05, 2560, RATE_HZ)


@given(st.floats(1e-3, 127.0))
def test_a_jog_is_on_the_grid_or_refused_with_a_frequency_that_is_on_it(frequency_Hz: float) -> None:
    try:
        line = jog_line(frequency_Hz, PERIOD, RATE_HZ)
        assert line * RATE_HZ / PERIOD == pytest.approx(frequency_Hz, abs=1e-6)
    except DesignError as error:
        named = float(str(error).rsplit(" is ", 1)[1].split()[0])
        assert abs(named - frequency_Hz) <= max(0.5 * RATE_HZ / PERIOD, abs(0.05 - frequency_Hz)) + 1e-9
        assert jog_line(named, PERIOD, RATE_HZ) >= 1


@pytest.mark.parametrize("frequency_Hz", [np.nan, np.inf, -0.05, 0.0, 200.0])
def test_no_frequency_at_all_is_refused(frequency_Hz: float) -> None:
    with pytest.raises(DesignError):
        jog_line(frequency_Hz, PERIOD, RATE_HZ)


def test_kept_periods_are_one_line_and_equal_to_the_bit() -> None:
    reference = jog(0.035, 3, PERIOD, settle_periods=1, periods=2)
    assert len(reference) == 3 * PERIOD
    assert np.array_equal(reference[PERIOD : 2 * PERIOD], reference[2 * PERIOD :])
    spectrum = np.abs(np.fft.rfft(reference[-PERIOD:])) * 2.0 / PERIOD
    assert spectrum[3] == pytest.approx(0.035)
    assert np.delete(spectrum, 3).max() < 1e-15


def test_a_jog_that_may_settle_grows_from_standstill_without_jerks() -> None:
    grown, hard = jog(0.035, 1, PERIOD, 1, 1), jog(0.035, 1, PERIOD, 0, 2)
    assert grown[0] == 0.0
    top_speed = 0.035 * 2 * np.pi * 0.05
    assert abs(np.diff(hard)[0]) * RATE_HZ == pytest.approx(top_speed, rel=1e-5)
    assert abs(np.diff(grown)[0]) * RATE_HZ < 1e-6 * top_speed
    from_rest = np.concatenate([np.zeros(3), grown])
    assert np.abs(np.diff(from_rest, 2)).max() * RATE_HZ**2 < 0.035
    assert np.abs(np.diff(from_rest, 3)).max() * RATE_HZ**3 < 0.1


def test_short_turns_leave_a_constant_speed_between_them() -> None:
    reference = jog(0.1, 2, PERIOD, 0, 2, turn_share=0.1)
    assert np.array_equal(reference[:PERIOD], reference[PERIOD:])
    assert np.abs(reference).max() == pytest.approx(0.1, rel=1e-4)
    speed = np.diff(reference) * RATE_HZ
    top = np.abs(speed).max()
    assert np.mean(np.abs(speed) > 0.999 * top) == pytest.approx(0.9, abs=0.02)
    assert top == pytest.approx(0.1 / (10.0 * (0.25 - 0.025 + 0.05 / np.pi)), rel=1e-4)  # a period of 10 s
    acceleration = np.diff(speed) * RATE_HZ
    assert np.abs(acceleration).max() == pytest.approx(top * np.pi / 0.5, rel=1e-2)  # a cosine in half a second
    nearly = jog(0.1, 2, PERIOD, 0, 1, turn_share=1.0 - 1e-9)
    assert nearly == pytest.approx(jog(0.1, 2, PERIOD, 0, 1), abs=1e-8)


@pytest.mark.parametrize("share", [0.0, -0.1, 1.5, float("nan")])
def test_a_turn_of_no_share_is_refused(share: float) -> None:
    with pytest.raises(DesignError, match="turn_share"):
        jog(0.1, 1, PERIOD, 1, 1, turn_share=share)


@pytest.mark.parametrize("line", [0, -1, 2560])
def test_a_line_outside_the_period_is_refused(line: int) -> None:
    with pytest.raises(DesignError, match="1 to 2559"):
        jog(0.035, line, PERIOD, 1, 1)


def test_odd_lines_split_and_even_ones_say_why_not() -> None:
    assert odd_even_split([3, 5, 7], 1) == (True, "")
    assert odd_even_split([3, 5, 7], None) == (True, "")
    split, why = odd_even_split([3, 5, 7], 2)
    assert not split
    assert "even line 2" in why
    assert "odd jog line keeps it" in why
    split, why = odd_even_split([3, 4, 6], 1)
    assert not split
    assert "2 even lines" in why
