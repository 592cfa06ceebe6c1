"""A closest fit that leaves something is asked from its other starts: which of them, beside what, and when not."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from hil.diagnosis.fitting.refit import Fitted
from hil.diagnosis.fitting.screening import Screened
from hil.diagnosis.result import EffectAt
from hil.diagnosis.searching import other_starts
from hil.diagnosis.searching.other_starts import MOST_STARTS, with_other_starts
from hil.diagnosis.starting.candidates import Candidate

HYSTERESIS, FRICTION = EffectAt("bouc_wen_hysteresis", "load"), EffectAt("coulomb_friction", "carriage")
NOISE = 3600.0
STARTS = tuple(np.array([1.0, 1.0, travel, 0.5, 1.0]) for travel in (1e-5, 1e-4, 1e-3, 2e-3, 4e-3, 8e-3))
"""Screening likes them the better the farther they go; the valleys they lead to leave less the nearer they are."""


def fitted(cost: float, *effects: tuple[EffectAt, np.ndarray]) -> Fitted:
    names, values = zip(*effects, strict=True)
    return Fitted(names, values, np.zeros(0), np.zeros(1), cost, (), np.zeros((1, 0)), np.zeros(0))


def asked(monkeypatch, fits, stand=None, starts=STARTS):
    """The starts that were fitted, and the fits that came of it. Both are beside what was found, with the machine's numbers there."""
    begun, there = [], SimpleNamespace(predicted=np.zeros(1))

    def screen(runs, tuning, found, residual, present=()):
        assert tuning is there
        assert present == (() if stand is None else stand.settings)
        (candidate,) = found
        (start,) = candidate.starts
        return [Screened(candidate.effect, start, np.zeros(1), float(start[2]))]

    def refit(runs, tuning, measured, starts):
        assert tuning is there
        begun.extend(starts)
        return [fitted(4000.0 + 1e6 * values[-1][2], *zip(names, values, strict=True)) for names, values in starts]

    monkeypatch.setattr(other_starts, "screen", screen)
    monkeypatch.setattr(other_starts, "refit", refit)
    monkeypatch.setattr(other_starts, "polish", lambda runs, tuning, measured, fits: list(fits))
    effects = () if stand is None else stand.effects
    before = SimpleNamespace(effects=effects, fitted=stand, tuning=there, cost=12000.0)
    found = [Candidate(FRICTION, (np.array([2.0]),)), Candidate(HYSTERESIS, starts)]
    return begun, with_other_starts(None, None, before, np.zeros(1), fits, found, NOISE)


def test_the_closest_of_other_starts_takes_the_place_of_what_leaves_more(monkeypatch):
    first, other = fitted(6000.0, (HYSTERESIS, STARTS[-1])), fitted(7000.0, (FRICTION, np.array([2.0])))
    begun, found = asked(monkeypatch, [first, other])
    assert [values[-1][2] for _, values in begun] == pytest.approx([4e-3, 2e-3, 1e-3, 1e-4])
    assert len(begun) == MOST_STARTS
    assert [fit.cost for fit in found] == pytest.approx([4100.0, 7000.0])


def test_what_was_found_before_stands_beside_every_start(monkeypatch):
    stand = fitted(12000.0, (FRICTION, np.array([2.0])))
    begun, found = asked(monkeypatch, [fitted(6000.0, (FRICTION, np.array([1.8])), (HYSTERESIS, STARTS[-1]))], stand)
    assert {names for names, _ in begun} == {(FRICTION, HYSTERESIS)}
    assert all(values[0] == pytest.approx([1.8]) for _, values in begun)
    assert [fit.cost for fit in found] == pytest.approx([4100.0])


def test_where_nothing_is_left_or_nothing_is_closer_fits_stay(monkeypatch):
    down_to_noise = [fitted(NOISE, (HYSTERESIS, STARTS[0]))]
    assert asked(monkeypatch, down_to_noise) == ([], down_to_noise)
    closest = [fitted(4050.0 + 200.0, (HYSTERESIS, STARTS[0]))]
    assert asked(monkeypatch, closest, starts=STARTS[-3:])[1] == closest
    friction = [fitted(6000.0, (FRICTION, np.array([2.0])))]
    assert asked(monkeypatch, friction) == ([], friction)  # it has one start


def test_what_gains_nearly_as_much_is_asked_from_its_next_best_start(monkeypatch):
    """A stop stands in another valley, and a cogging is the closest meanwhile."""
    closest, rival = fitted(6000.0, (FRICTION, np.array([2.0]))), fitted(6500.0, (HYSTERESIS, STARTS[-1]))
    near = (STARTS[0], 0.75 * STARTS[-1], 0.8 * STARTS[-1], STARTS[-1])
    begun, found = asked(monkeypatch, [closest, rival], starts=near)
    assert [values[-1][2] for _, values in begun] == pytest.approx([0.8 * 8e-3])
    assert [fit.cost for fit in found] == pytest.approx([6000.0, 6500.0])  # that start leads nowhere better
    few = [fitted(NOISE + left, (FRICTION, np.array([2.0]))) for left in (200.0, 400.0)]  # 297 is half of what nobody tells from noise
    assert [len(asked(monkeypatch, [one, rival], starts=near)[0]) for one in few] == [0, 1]
    begun, found = asked(monkeypatch, [closest, fitted(11500.0, (HYSTERESIS, STARTS[-1]))], starts=near)
    assert begun == []  # far behind
    begun, found = asked(monkeypatch, [closest, rival], starts=(0.68 * STARTS[-1], STARTS[-1]))
    assert begun == []  # screening likes the others far less


def test_a_rival_gives_way_to_itself_from_a_start_that_leaves_less(monkeypatch):
    closest, rival = fitted(5000.0, (FRICTION, np.array([2.0]))), fitted(5900.0, (HYSTERESIS, 1.25 * STARTS[2]))
    _, found = asked(monkeypatch, [closest, rival], starts=(STARTS[2], 1.25 * STARTS[2]))
    assert [fit.cost for fit in found] == pytest.approx([5000.0, 5000.0])
    assert found[1].values[0][2] == pytest.approx(1e-3)
