"""Harmonic filters in general: any order, any frequencies, zeros, the shortest delay, quiet bands, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest
from examples import examples
from hypothesis import given, settings
from hypothesis import strategies as st
from refusals import answer_or_refusal
from thesis_plants import DAMPING, NATURAL, example_7_1

from controllers.errors import DesignError
from controllers.shapers.closed_form_htdf import second_order
from controllers.shapers.conditions import equations, residuals
from controllers.shapers.delays import DelayFilter
from controllers.shapers.dynamics import Dynamics
from controllers.shapers.harmonic_time_delay import check_static_gain, harmonic, harmonic_conditions, tap_count
from controllers.shapers.quiet import quiet
from controllers.shapers.shortest_delays import shortest_delays
from controllers.shapers.zero_inversion import tail_of
from hil.shaping.response import shaped_response, sinusoids

H = 1.0 / 256.0


def two_modes() -> Dynamics:
    return Dynamics.from_modes([(2 * np.pi * 8.4, 0.055, 0.9), (2 * np.pi * 14.0, 0.0124, 0.1)])


def step_outputs(plant: Dynamics, shaper: DelayFilter, reference: np.ndarray) -> np.ndarray:
    """A sampled plant behind a sampled shaper from rest, by the difference equations themselves."""
    delays = np.round(shaper.delays_s * 256.0).astype(int)
    force = np.zeros(len(reference))
    for delay, gain in zip(delays, shaper.gains, strict=True):
        force[delay:] += gain * reference[: len(reference) - delay]
    state, output = np.zeros(len(plant.a)), np.zeros(len(reference))
    for k, value in enumerate(force):
        output[k] = plant.c @ state + plant.d * value
        state = plant.a @ state + plant.b * value
    return output


@given(
    frequencies=st.lists(st.floats(1.0, 6.0), min_size=1, max_size=3, unique=True),
    forcing=st.lists(st.sampled_from([0.0, 0.3, 0.55, 0.8]), min_size=1, max_size=3, unique=True),
    damping=st.floats(0.001, 0.1),
    delay=st.floats(0.2, 0.6),
)
@settings(max_examples=examples(40), deadline=None)
def test_the_linear_method_meets_all_conditions_or_says_which_it_cannot(
    frequencies: list[float], forcing: list[float], damping: float, delay: float
) -> None:
    plant = Dynamics.from_modes([(w, damping, 1.0 / (k + 1)) for k, w in enumerate(frequencies)])
    if np.diff(np.sort(frequencies)).min(initial=1.0) < 0.3:
        return  # nearly the same pole twice
    conditions = harmonic_conditions(plant, forcing)
    shaper, refusal = answer_or_refusal(DesignError, harmonic, conditions, delay)
    if shaper is None:
        assert "rad/s" in refusal
        return
    size = max(1.0, shaper.gain_sum)
    assert np.abs(residuals(conditions, shaper)).max() < 1e-8 * size
    for frequency in forcing:
        assert abs(complex(plant.response(1j * frequency) * shaper.response(1j * frequency)) - 1.0) < 1e-7 * size


def test_the_number_of_taps_is_the_thesiss() -> None:
    plant = two_modes()  # N_p = 4
    assert tap_count(harmonic_conditions(plant, [1.0, 2.0])) == 4 + 2 * 2  # L + 1 = N_p + 2 N_w
    poles = plant.poles
    assert tap_count(harmonic_conditions(plant, [1.0], robust_poles=poles, robust_forcing_rad_s=[1.0])) == 2 * 4 + 4 * 1
    assert tap_count(harmonic_conditions(plant, [0.0], robust_forcing_rad_s=[0.0])) == 4 + 2


def test_more_taps_than_equations_make_smaller_gains() -> None:
    conditions = harmonic_conditions(two_modes(), [0.0], robust_forcing_rad_s=[0.0])
    few, many = harmonic(conditions, 0.02), harmonic(conditions, 0.02, extra_taps=6)
    assert np.linalg.norm(many.gains) < np.linalg.norm(few.gains)
    assert np.abs(residuals(conditions, many)).max() < 1e-12


def test_a_sampled_plant_is_tracked_to_the_last_digits_and_settles_after_the_transient() -> None:
    plant = two_modes().sampled(H)
    frequencies = 2 * np.pi * np.array([0.0, 0.5, 1.5, 2.5])
    shaper = harmonic(harmonic_conditions(plant, frequencies), 18 * H)
    times = np.arange(1500) * H
    reference = 0.4 + np.sin(frequencies[1] * times) - 1.2 * np.cos(frequencies[2] * times) + 0.3 * np.sin(frequencies[3] * times + 1.0)
    error = step_outputs(plant, shaper, reference) - reference
    settled = round(shaper.transient_s / H)
    assert np.abs(error[settled:]).max() < 1e-9 * 2.0
    assert np.abs(error[settled - 20 : settled]).max() > 1e-3


def test_a_ramp_is_followed_without_lag_and_a_step_settles_after_the_transient() -> None:
    plant = two_modes().sampled(H)
    shaper = harmonic(harmonic_conditions(plant, [0.0], robust_forcing_rad_s=[0.0]), 6 * H)
    settled = round(shaper.transient_s / H)
    ramp = 0.01 * np.arange(400.0)
    assert np.abs((step_outputs(plant, shaper, ramp) - ramp)[settled:]).max() < 1e-9
    step = np.ones(400)
    assert np.abs((step_outputs(plant, shaper, step) - step)[settled:]).max() < 1e-9


def test_the_shortest_delay_of_a_second_order_plant_is_the_closed_form() -> None:
    found = shortest_delays(harmonic_conditions(example_7_1(), [0.7]), 6.0, gain_sum_limit=10.0)
    closed = second_order(NATURAL, DAMPING, 0.7)
    assert found[0].delays_s == pytest.approx(closed.delays_s, rel=1e-9)
    assert found[0].gains == pytest.approx(closed.gains, abs=1e-9)
    second = second_order(NATURAL, DAMPING, 0.7, half_periods=2)  # its determinant touches zero next to another root
    assert any(np.allclose(each.gains, second.gains, atol=1e-8) for each in found)
    assert len([each for each in found if 4.44 < each.delays_s[1] < 4.45]) == 2


def test_every_delay_found_is_a_solution_and_no_shorter_one_exists() -> None:
    plant = Dynamics.from_modes([(np.sqrt(2.0), 0.02, 0.7), (3.0, 0.03, 0.3)])
    conditions = harmonic_conditions(plant, [0.7, 2.0])
    found = shortest_delays(conditions, 2.5, gain_sum_limit=200.0)
    assert [each.delays_s[1] for each in found] == sorted(each.delays_s[1] for each in found)
    for shaper in found:
        assert len(shaper.gains) == tap_count(conditions) - 1
        assert np.abs(residuals(conditions, shaper)).max() < 1e-9 * shaper.gain_sum
    # brute force: least-squares residual on a fine grid of shorter delays never comes near zero
    taps = tap_count(conditions) - 1
    for delay in np.arange(0.3, found[0].delays_s[1] - 0.01, 2e-3):
        matrix, right = equations(conditions, delay * np.arange(taps), None)
        gains = np.linalg.lstsq(matrix, right, rcond=1e-15)[0]
        assert np.linalg.norm(matrix @ gains - right) > 1e-7 or np.abs(gains).sum() > 200.0


def test_no_delay_in_the_range_is_said() -> None:
    with pytest.raises(DesignError, match=r"no delay up to 0\.5 s"):
        shortest_delays(harmonic_conditions(example_7_1(), [0.7]), 0.5, gain_sum_limit=2.0)


@pytest.mark.parametrize("method", ["dc", "zpetc", "zmetc"])
def test_a_plant_with_a_zero_that_cannot_be_inverted_is_still_tracked(method: str) -> None:
    # zeros at -3 and +2: minimum and non-minimum phase
    plant = Dynamics.from_polynomials(-1.0 * np.polymul([1.0, 3.0], [1.0, -2.0]), np.polymul([1.0, 0.4, 4.0], [1.0, 0.2, 1.5]))
    tail, ahead = tail_of(plant, method)
    assert ahead == 0.0
    assert tail is not None
    assert tail.poles.real.max() < 0.0
    shaper = harmonic(harmonic_conditions(plant, [0.7]), 0.7, tail=tail)
    assert complex(plant.response(0.7j) * shaper.response(0.7j)) == pytest.approx(1.0, abs=1e-9)
    reference = sinusoids([1.0], [0.7])
    late = np.linspace(shaper.transient_s, shaper.transient_s + 5.0, 100)
    error = np.abs(shaped_response(plant, shaper, reference, late) - reference.at(late))
    if method == "zmetc":  # the mirrored zero is not the plant's: its pole decays by itself
        assert error.max() > 1e-6
        far = late + 20.0
        assert np.abs(shaped_response(plant, shaper, reference, far) - reference.at(far)).max() < 1e-9
    else:
        assert error.max() < 1e-9


def test_stand_ins_keep_what_their_names_say() -> None:
    zero = 2.0
    plant = Dynamics.from_polynomials([-1.0, zero], [1.0, 3.0, 5.0, 3.0])
    s = 1j * np.linspace(0.1, 5.0, 20)
    unstable = (zero - s) / zero
    magnitude = tail_of(plant, "zmetc")[0].response(s)
    assert np.abs(magnitude * unstable) == pytest.approx(1.0, abs=1e-12)
    sampled = plant.sampled(0.05)
    late, ahead = tail_of(sampled, "zpetc", zeros=[z for z in sampled.zeros if z.real > 1.0])
    outside = next(z for z in sampled.zeros if z.real > 1.0)
    through = late.response(s) * (1.0 - outside / np.exp(s * 0.05)) * np.exp(s * ahead)
    assert np.angle(through / (1.0 - outside)) == pytest.approx(0.0, abs=1e-9)
    assert tail_of(plant, "dc") == (None, 0.0)


def test_without_zeros_there_is_no_tail() -> None:
    assert tail_of(example_7_1(), "zpetc") == (None, 0.0)


def test_zpetc_that_would_differentiate_is_refused() -> None:
    with pytest.raises(DesignError, match="use zmetc or dc"):
        tail_of(Dynamics.from_polynomials([-1.0, 2.0], [1.0, 3.0, 5.0, 3.0]), "zpetc")


def test_a_quiet_filter_meets_its_conditions_and_passes_little_in_its_band() -> None:
    plant = two_modes().sampled(H)
    conditions = harmonic_conditions(plant, [0.0], robust_poles=plant.poles, robust_forcing_rad_s=[0.0])
    shaper = quiet(conditions, H, 0.6, (4.0, 20.0))
    assert np.abs(residuals(conditions, shaper)).max() < 1e-9
    inside, outside = 2j * np.pi * np.linspace(5.0, 20.0, 200), 2j * np.pi * np.linspace(0.1, 1.0, 20)
    assert np.abs(shaper.response(inside)).max() < 0.03
    assert np.abs(shaper.response(outside)).min() > 0.9


def test_a_transient_too_short_for_a_quiet_filter_is_said() -> None:
    plant = two_modes().sampled(H)
    with pytest.raises(DesignError, match="allow a longer transient"):
        quiet(harmonic_conditions(plant, [0.0]), H, 2 * H, (4.0, 20.0))


def test_an_unstable_plant_is_refused() -> None:
    with pytest.raises(DesignError, match="not stable"):
        harmonic_conditions(Dynamics.from_polynomials([1.0], [1.0, -0.1, 2.0]), [0.7])


@pytest.mark.parametrize("forcing", [np.sqrt(2.0), 1.41])
def test_a_forcing_frequency_on_a_pole_is_refused(forcing: float) -> None:
    with pytest.raises(DesignError, match="lies on the pole"):
        harmonic_conditions(example_7_1(), [forcing])
    with pytest.raises(DesignError, match="lies on the pole"):
        second_order(NATURAL, DAMPING, forcing)


def test_frequencies_must_be_different_and_robust_ones_among_them() -> None:
    with pytest.raises(DesignError, match="different and not negative"):
        harmonic_conditions(example_7_1(), [0.7, 0.7])
    with pytest.raises(DesignError, match="not among"):
        harmonic_conditions(example_7_1(), [0.7], robust_forcing_rad_s=[0.8])


def test_a_harmonic_filter_is_no_prefilter_for_a_sweep() -> None:
    plant = example_7_1()
    with pytest.raises(DesignError, match=r"H\(0\) = 0\.02999"):
        check_static_gain(plant, second_order(NATURAL, DAMPING, 0.7))
    check_static_gain(plant, harmonic(harmonic_conditions(plant, [0.0, 0.7], robust_forcing_rad_s=[0.0]), 1.0))


def test_robust_forcing_makes_the_tracking_error_second_order_in_the_change() -> None:
    plant = example_7_1()
    plain = harmonic(harmonic_conditions(plant, [0.7]), 1.0)
    robust = harmonic(harmonic_conditions(plant, [0.7], robust_forcing_rad_s=[0.7]), 1.0)

    def error(shaper: DelayFilter, share: float) -> float:
        s = 0.7j * (1 + share)
        return abs(complex(plant.response(s) * shaper.response(s)) - 1.0)

    assert error(plain, 0.02) / error(plain, 0.01) == pytest.approx(2.0, rel=0.1)
    assert error(robust, 0.02) / error(robust, 0.01) == pytest.approx(4.0, rel=0.1)


def test_robust_poles_make_the_residual_second_order_in_the_change() -> None:
    plant = example_7_1()
    pole = next(p for p in plant.poles if p.imag > 0)
    plain = harmonic(harmonic_conditions(plant, [0.7]), 1.0)
    robust = harmonic(harmonic_conditions(plant, [0.7], robust_poles=[pole]), 1.0)

    def left(shaper: DelayFilter, share: float) -> float:
        return abs(complex(shaper.response(pole * (1 + share))))

    assert left(plain, 0.02) / left(plain, 0.01) == pytest.approx(2.0, rel=0.1)
    assert left(robust, 0.02) / left(robust, 0.01) == pytest.approx(4.0, rel=0.1)


def test_zeros_and_poles_of_a_state_space_are_the_polynomials() -> None:
    zeros, poles = [-1.0, -2.0 + 1.0j, -2.0 - 1.0j], [-0.5, -3.0, -0.2 + 4.0j, -0.2 - 4.0j]
    system = Dynamics.from_polynomials(np.real(np.poly(zeros)), np.real(np.poly(poles)))
    assert np.sort_complex(system.zeros) == pytest.approx(np.sort_complex(np.array(zeros)), abs=1e-8)
    assert np.sort_complex(system.poles) == pytest.approx(np.sort_complex(np.array(poles)), abs=1e-8)
    s = 0.3 + 0.7j
    step = 1e-6
    by_difference = (complex(system.response(s + step)) - complex(system.response(s - step))) / (2 * step)
    assert complex(system.slope(s)) == pytest.approx(by_difference, rel=1e-6)
    held = system.sampled(0.01)
    by_difference = (complex(held.response(s + step)) - complex(held.response(s - step))) / (2 * step)
    assert complex(held.slope(s)) == pytest.approx(by_difference, rel=1e-5)
