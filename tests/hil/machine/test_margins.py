"""Margins of loops that have them in closed form, stable and not: integrators that are late, and loops that a change of gain must cure.

With a gain of K a sample, late by d samples, an integrator's loop gain is L = K z^-d / (z - 1). It is 1 at w T = 2 asin(K / 2), where its
phase lies 90 degrees - (d + 1/2) w T before -180 degrees; it is real and negative at w T = pi / (2 d + 1), where 1 / |L| is
2 sin(w T / 2) / K. Late by any time the same holds of the motion between the samples, to which a period's hold adds half of it.
"""

from __future__ import annotations

import math

import numpy as np
import pytest

from controllers.settings import AxisController
from hil.machine.closed_loop import LinearLoop, Margins
from virtual_bus.linear.sampled import SampledPlant

PERIOD_s = 0.01


def plant(numerator: list[float], denominator: list[float], samples_late: int = 0) -> SampledPlant:
    """Return numerator(z) / denominator(z), strictly proper and monic, late by so many samples."""
    order = len(denominator) - 1
    n = order + samples_late
    a, b, c = np.eye(n, k=-1), np.eye(n, 1), np.zeros((1, n))
    a[0, :order] = -np.array(denominator[1:])
    c[0, n - len(numerator) :] = numerator
    if samples_late:
        a[order, : order + 1] = 0.0
        a[order, order - 1] = 1.0
    return SampledPlant(a, b, c, ("u",), ("y",), PERIOD_s, np.zeros(0), (1 + samples_late) * PERIOD_s)


def loop(gain: float, numerator: list[float], denominator: list[float], samples_late: int = 0) -> LinearLoop:
    sections = np.array([[gain, 0.0, 0.0, 1.0, 0.0, 0.0]])
    return LinearLoop(plant(numerator, denominator, samples_late), [AxisController("turn", sections, None, np.inf, False)])


def late_integrator(gain: float, samples_late: int) -> LinearLoop:
    return loop(gain, [1.0], [1.0, -1.0], samples_late)


def margins(of: LinearLoop) -> Margins:
    (found,) = of.margins()
    return found


@pytest.mark.parametrize("samples_late", [0, 1, 2, 5, 14])
@pytest.mark.parametrize("gain", [0.02, 0.1, 0.3, 0.7])
def test_a_late_integrator_has_the_margins_of_its_closed_form_be_it_stable_or_not(gain: float, samples_late: int) -> None:
    found, at_unit_gain = margins(late_integrator(gain, samples_late)), 2.0 * math.asin(0.5 * gain)
    phase_deg = 90.0 - math.degrees((samples_late + 0.5) * at_unit_gain)
    at_half_turn = math.pi / (2 * samples_late + 1)
    assert (late_integrator(gain, samples_late).pole_radius() < 1.0) is (phase_deg > 0.0)
    assert found.crossover_Hz == pytest.approx(at_unit_gain / (2.0 * math.pi * PERIOD_s), rel=1e-3)
    assert found.gain_at_Hz == pytest.approx(at_half_turn / (2.0 * math.pi * PERIOD_s), rel=2e-3)
    assert found.gain_dB == pytest.approx(20.0 * math.log10(2.0 * math.sin(0.5 * at_half_turn) / gain), abs=0.02)
    if phase_deg > -180.0:
        assert found.phase_deg == pytest.approx(phase_deg, abs=0.1)
        assert found.phase_at_Hz == found.crossover_Hz
    else:  # more than half a turn
        assert found.phase_deg == -math.inf


@pytest.mark.parametrize("samples_late", [2, 5])
def test_a_negative_margin_is_the_delay_and_the_gain_behind_which_the_closed_loop_is_stable(samples_late: int) -> None:
    """At the least gain for which a loop with one sample less is unstable, one sample of delay is all that it is late."""
    edge = 2.0 * math.sin(math.pi / (2.0 * (2 * samples_late - 1)))
    found = margins(late_integrator(edge, samples_late))
    assert found.phase_deg == pytest.approx(-360.0 * found.phase_at_Hz * PERIOD_s, abs=0.1)
    cured = edge * 10.0 ** (found.gain_dB / 20.0)
    assert late_integrator(0.99 * cured, samples_late).pole_radius() < 1.0 < late_integrator(1.01 * cured, samples_late).pole_radius()


def test_a_loop_that_more_gain_makes_stable_lacks_that_gain_and_one_that_has_too_much_lacks_less() -> None:
    """1 + k (z - 0.9)^2 / (z - 1)^3 late by nothing: the double zero catches the triple integrator from a gain on, and up to another."""
    numerator, denominator = [1.0, -1.8, 0.81], [1.0, -3.0, 3.0, -1.0]
    radii = {gain: loop(gain, numerator, denominator).pole_radius() for gain in (0.01, 0.5, 2.5)}
    assert radii[0.01] > 1.0 > radii[0.5]
    assert radii[2.5] > 1.0
    # on the unit circle: z = -1 at k = 8 / 3.61, and a pair where the cubic's Jury determinant is nothing
    highest = 8.0 / 3.61
    lowest = next(root.real for root in np.roots(jury()) if 0.01 < root.real < 0.5 and root.imag == 0.0)
    for gain in (0.01, 2.5):
        found = margins(loop(gain, numerator, denominator))
        nearest = lowest if gain < lowest else highest
        assert found.gain_dB == pytest.approx(-abs(20.0 * math.log10(nearest / gain)), abs=0.02)
        assert found.phase_deg < 0.0
    found = margins(loop(0.5, numerator, denominator))
    assert found.gain_dB == pytest.approx(min(20.0 * math.log10(highest / 0.5), 20.0 * math.log10(0.5 / lowest)), abs=0.02)


def jury() -> np.ndarray:
    """Return the polynomial in k of 1 - c^2 - b + a c for z^3 + a z^2 + b z + c = (z - 1)^3 + k (z - 0.9)^2."""
    a, b, c = np.poly1d([1.0, -3.0]), np.poly1d([-1.8, 3.0]), np.poly1d([0.81, -1.0])
    return (np.poly1d([1.0]) - c * c - b + a * c).coeffs


@pytest.mark.parametrize(("numerator", "denominator"), [([-1.0], [1.0, -1.0]), ([1.0], [1.0, -2.0, 1.0])])
def test_a_loop_that_no_change_of_gain_makes_stable_has_no_margin(numerator: list[float], denominator: list[float]) -> None:
    """An integrator with the sign turned, and a double integrator, whose two poles leave the circle at any gain."""
    found = margins(loop(0.1, numerator, denominator))
    assert found.gain_dB == -math.inf
    if denominator[1] == -1.0:
        assert found.phase_deg == -math.inf
    else:  # |L| = 0.1 / |z - 1|^2 is 1 at w T = 2 asin(sqrt(0.1) / 2), where its phase is -180 degrees - w T
        assert found.phase_deg == pytest.approx(-math.degrees(2.0 * math.asin(0.5 * math.sqrt(0.1))), abs=0.1)


def test_of_two_loops_the_one_that_is_stable_can_do_nothing_for_the_other() -> None:
    late = plant([1.0], [1.0, -1.0], 5)
    n = len(late.a)
    two = np.kron(np.eye(2), late.a), np.kron(np.eye(2), late.b), np.kron(np.eye(2), late.c)
    both = SampledPlant(*two, ("u", "v"), ("y", "z"), PERIOD_s, np.zeros(0), 6 * PERIOD_s)
    assert both.a.shape == (2 * n, 2 * n)
    controllers = [AxisController("turn", np.array([[gain, 0.0, 0.0, 1.0, 0.0, 0.0]]), None, np.inf, False) for gain in (0.05, 0.35)]
    sound, failing = LinearLoop(both, controllers).margins()
    assert sound.phase_deg == sound.gain_dB == -math.inf
    alone = margins(late_integrator(0.35, 5))
    assert (failing.phase_deg, failing.gain_dB) == pytest.approx((alone.phase_deg, alone.gain_dB), abs=0.02)
