"""How large places and frequencies may be beforehand, against the evidence that they are to stand for."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
import scipy.integrate

from hil.diagnosis.coordinates import Coordinates, Point
from hil.diagnosis.information import information_of
from hil.diagnosis.result import EffectAt
from hil.diagnosis.visited import Visited, Way
from virtual_bus.effects.registry import effects

STOP, CABLE = EffectAt("end_stop", "arm"), EffectAt("cable_spring", "arm")
NONE = SimpleNamespace(at=lambda offset: offset)


def described(effect: EffectAt, visited: Visited, **values: float):
    """The parameters of a fit that stands at these values, by name, and its coordinates."""
    own = np.array([values.get(p.name, 0.0) for p in effects()[effect.effect].parameters])
    fit, at = Coordinates(NONE, (effect,), (own,), visited), Point(np.zeros(0), (own,))
    return {one.parameter.name: one for one in fit.described(at)}, fit, at


def size(effect: EffectAt, parameter: str, visited: Visited, **values: float) -> float:
    return described(effect, visited, **values)[0][parameter].size


@pytest.mark.parametrize("zero", [0.0, 0.3, -4.0])
def test_a_place_costs_what_a_range_around_it_does_wherever_zero_is(zero):
    """The log of the mean likelihood over a range of 2 rad of a place that is known with 0.01 rad, less that of the likeliest place."""
    known = 0.01
    visited = Visited(10.0, {"arm": Way(zero - 1.0, zero + 1.0)})
    place = described(STOP, visited, K=50.0, at_position=zero + 0.2)[0]["at_position"]
    (information,) = information_of(np.array([[1.0, 0.0], [0.0, (place.size / known) ** 2]]), 1, [place])
    whole, _ = scipy.integrate.quad(lambda q: np.exp(-0.5 * ((q - 0.2) / known) ** 2) / 2.0, -1.0, 1.0, points=[0.2])
    assert 0.5 * np.log1p(information) == pytest.approx(-np.log(whole), abs=1e-3)


def test_a_stop_is_where_recordings_go_and_a_cable_slack_where_the_joint_may_go():
    few_degrees = Visited(10.0, {"arm": Way(-0.05, 0.05, 1.0, -1.5, 1.5)})
    stop, cable = size(STOP, "at_position", few_degrees, K=1.0), size(CABLE, "theta0", few_degrees, kc=1.0)
    assert cable / stop == pytest.approx(3.0 / 0.1)
    unlimited, slide = Visited(10.0, {"arm": Way(0.2, 0.3)}), Visited(10.0, {"arm": Way(0.2, 0.3, turns=False)})
    assert size(CABLE, "theta0", unlimited, kc=1.0) == pytest.approx(stop * 2.0 * np.pi / 0.1)
    assert size(CABLE, "theta0", slide, kc=1.0, theta0=0.25) == pytest.approx(stop)


def test_a_cable_is_slack_where_the_joint_may_go_and_else_a_load():
    _, fit, at = described(CABLE, Visited(10.0, {"arm": Way(0.0, 1.0, 1.0, -0.5, 1.5)}), kc=1.0, theta0=0.4)
    for step, end in zip(fit.reach(at, 10.0), (-0.5, 1.5), strict=True):
        assert fit.moved(at, step).values[0][2] == pytest.approx(end)
    assert fit.point(np.zeros(0), (np.array([1.0, 0.0, -7.0]),)).values[0] == pytest.approx([1.0, 0.0, -0.5])
    largest = size(CABLE, "theta0", Visited(10.0, {"arm": Way(-50.0, 50.0)}), kc=1.0)
    assert largest == pytest.approx(20.0 / np.sqrt(2.0 * np.pi))  # the catalogue's bounds


def test_a_fit_moves_a_place_that_starts_at_zero():
    _, fit, at = described(CABLE, Visited(10.0, {"arm": Way(-1.0, 1.0, turns=False)}), kc=1.0)
    low, high = (fit.moved(at, step).values[0][2] for step in fit.reach(at, 1.0))
    assert low == pytest.approx(-1.0) and high == pytest.approx(1.0)


def test_the_search_of_a_mode_s_frequency_is_paid_once():
    """Modes a bandwidth of 6 % apart are counted; the frequency is what it is within one of them: a range of 0.06 of itself."""
    mode = described(EffectAt("structural_mode", "arm"), Visited(10.0, {"arm": Way(-1.0, 1.0)}), J=1.0, f=8.0, zeta=0.03)[0]["f"]
    (information,) = information_of(np.diag([1.0, 1e6]), 1, [mode])  # known to a thousandth
    assert 0.5 * np.log(information) == pytest.approx(np.log(0.06 / (np.sqrt(2.0 * np.pi) * 1e-3)))
