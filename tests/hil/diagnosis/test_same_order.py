"""Waves over one axis' position are tried at one order: in whose coordinate, beside what, and where."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from hil.diagnosis.fitting.refit import Fitted
from hil.diagnosis.fitting.screening import Screened
from hil.diagnosis.result import EffectAt
from hil.diagnosis.searching import same_order
from hil.diagnosis.searching.same_order import with_others_of_its_order
from hil.diagnosis.starting.candidates import Candidate
from hil.diagnosis.tuning.free_run import TRAIN
from hil.machine import load_machine

CARM = load_machine("carm")
RATIO = next(drive.ratio for drive in CARM.plant.drives if drive.axis == "roll")
TRAVEL_rad = 0.5
ORDER = 80.0  # radians per radian of the joint
LINES = EffectAt("encoder_eccentricity", "position_roll"), np.array([0.0, 0.0, 1e-5, ORDER])
FRICTION = EffectAt("coulomb_friction", "roll"), np.array([10.0])
OTHERS = {
    "cogging": np.array([3.0, 1.0, 0.2, 0.0, 0.0]),
    "transmission_error": np.array([3.0, 1e-4, 0.2, 0.0, 0.0]),
    "position_dependent_friction": np.array([1.0, 3.0, 0.0]),
}


def fitted(cost: float, *effects: tuple[EffectAt, np.ndarray]) -> Fitted:
    names, values = zip(*effects, strict=True)
    return Fitted(names, values, np.zeros(0), np.zeros(1), cost, (), np.zeros((1, 0)), np.zeros(0))


def runs():
    position = np.zeros((50, len(CARM.axes)))
    position[:, list(CARM.axes).index("roll")] = np.linspace(-0.2, TRAVEL_rad - 0.2, 50)
    return SimpleNamespace(machine=CARM, sets={TRAIN: SimpleNamespace(groups=[SimpleNamespace(position=position)])})


def asked(monkeypatch, fits, stand=None, places=("roll",), comes_to=10.0):
    """Which starts were screened, beside what, and the fits that came of it."""
    seen = {"present": None, "starts": {}}

    def screen(runs, tuning, found, residual, present=()):
        seen["present"] = present
        seen["starts"] = {candidate.effect: list(candidate.starts) for candidate in found}
        return [Screened(candidate.effect, candidate.starts[0], np.zeros(1), 1.0) for candidate in found]

    monkeypatch.setattr(same_order, "screen", screen)
    monkeypatch.setattr(
        same_order, "refit", lambda runs, tuning, measured, starts: [fitted(comes_to, *zip(*start, strict=True)) for start in starts]
    )
    monkeypatch.setattr(same_order, "polish", lambda runs, tuning, measured, fits: list(fits))
    effects = () if stand is None else stand.effects
    before = SimpleNamespace(effects=effects, fitted=stand, tuning=SimpleNamespace(predicted=np.zeros(1)), cost=100.0)
    found = [Candidate(EffectAt(name, at), (values,)) for name, values in OTHERS.items() for at in places]
    return seen, with_others_of_its_order(runs(), None, before, np.zeros(1), fits, found)


def test_an_order_is_counted_in_each_laws_own_coordinate(monkeypatch):
    seen, found = asked(monkeypatch, [fitted(50.0, LINES)])
    around = [ORDER + share * 2.0 * np.pi / TRAVEL_rad for share in (-0.25, 0.0, 0.25)]
    assert [start[0] for start in seen["starts"][EffectAt("cogging", "roll")]] == pytest.approx([order / RATIO for order in around])
    errors = seen["starts"][EffectAt("transmission_error", "roll")]
    assert [start[0] for start in errors] == pytest.approx([order / RATIO for order in around])
    assert [start[1] for start in seen["starts"][EffectAt("position_dependent_friction", "roll")]] == pytest.approx(around)
    assert len(found) == 1 + len(OTHERS)


def test_what_was_found_before_stands_as_it_was_found(monkeypatch):
    """The best fit has moved its numbers; the residual is that of the stand."""
    moved = (FRICTION[0], np.array([8.0]))
    seen, found = asked(monkeypatch, [fitted(50.0, moved, LINES)], fitted(90.0, FRICTION))
    assert [dict(one.parameters) for one in seen["present"]] == [{"Fc": 10.0}]
    assert all(fit.effects[0] == FRICTION[0] for fit in found)


def test_nothing_is_tried_at_another_axis_nor_what_is_at_that_order_already(monkeypatch):
    seen, _ = asked(monkeypatch, [fitted(50.0, LINES)], places=("propeller",))
    assert seen["starts"] == {}
    there = (EffectAt("cogging", "roll"), np.array([ORDER / RATIO, 1.0, 0.0, 0.0, 0.0]))
    seen, _ = asked(monkeypatch, [fitted(50.0, LINES), fitted(60.0, there)])
    assert EffectAt("cogging", "roll") not in seen["starts"]
    seen, _ = asked(monkeypatch, [fitted(50.0, there, LINES)], fitted(90.0, there))
    assert not any(effect.effect == "cogging" for effect in seen["starts"])


def test_what_gains_less_than_half_as_much_is_not_kept(monkeypatch):
    fits = [fitted(50.0, LINES)]
    _, found = asked(monkeypatch, fits, comes_to=80.0)
    assert found == fits
    _, found = asked(monkeypatch, [fitted(50.0, FRICTION)])  # no wave
    assert len(found) == 1
