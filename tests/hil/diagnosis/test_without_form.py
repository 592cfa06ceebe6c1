"""Where the closest set would pass but for its form, another effect is fitted in place of each of its own: when, and in which order."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from hil.diagnosis.fitting.refit import Fitted
from hil.diagnosis.result import EffectAt
from hil.diagnosis.searching import step
from hil.diagnosis.searching.step import Steps, _AtTheGate

GEAR, CONSTANT, LATE, RIPPLE = (
    EffectAt(name, at)
    for name, at in (
        ("gear_ratio", "carriage"),
        ("torque_constant", "carriage"),
        ("clock_offset", "effort_carriage"),
        ("torque_ripple", "carriage"),
    )
)


def fitted(cost: float, *effects: EffectAt) -> Fitted:
    return Fitted(effects, (np.ones(1),) * len(effects), np.zeros(0), np.zeros(1), cost, (), np.zeros((1, 0)), np.zeros(0))


def judged(fit: Fitted, lost_form: str = "", there: bool = True):
    return SimpleNamespace(fitted=fit, gate=SimpleNamespace(lost_form=lost_form, something_is_there=there))


def asked(monkeypatch, *sets):
    """What was judged in the end, and which starts were fitted on the way."""
    begun = []

    def fits_from(starts):
        begun.extend(starts)
        return [fitted(3505.0, *names) for names, _ in starts]

    monkeypatch.setattr(step, "another_for_each", lambda tuning, found, *rest: [((CONSTANT, LATE), (np.ones(1), np.ones(1)))])
    monkeypatch.setattr(step, "in_order", lambda fits, *rest: sorted(fits, key=lambda fit: fit.cost))
    steps = SimpleNamespace(
        tuning=None,
        runs=SimpleNamespace(machine=SimpleNamespace(plant=None)),
        judgement=SimpleNamespace(nothing=SimpleNamespace(cost=2.6e6)),
        noise_energy=3588.0,
        fits_from=fits_from,
        polished=lambda fits: fits,
        _that_need_all=lambda begun, fits, leaner, singles: (list(fits), []),
    )
    way = SimpleNamespace(way=SimpleNamespace(smaller=()), screened=(), tried=None)
    judgement = SimpleNamespace(contenders=lambda stand, fits, *rest: [judged(fit) for fit in fits])
    stand = SimpleNamespace(effects=(GEAR,))
    gate = _AtTheGate(judgement, SimpleNamespace(**vars(way), limits={}), stand, (0.0, 0.0), list(sets))
    after, fits = Steps._with_others_of_formless(steps, gate, [one.fitted for one in sets], (), ())
    assert [one.fitted for one in after.judged] == list(fits)
    return [one.fitted.effects for one in after.judged], begun


def test_what_does_the_same_with_a_form_of_its_own_is_judged_in_the_order_of_its_evidence(monkeypatch):
    """The gear's error is at its bound; without others in its place the search would go on beside the ripple, which leaves 300 more."""
    sets = judged(fitted(3506.0, GEAR, LATE), "at its bound"), judged(fitted(3826.0, GEAR, RIPPLE))
    assert asked(monkeypatch, *sets)[0] == [(CONSTANT, LATE), (GEAR, LATE), (GEAR, RIPPLE)]


@pytest.mark.parametrize(
    "closest",
    [
        judged(fitted(3506.0, GEAR, LATE)),
        judged(fitted(3506.0, GEAR, LATE), "at its bound", there=False),
        judged(fitted(3506.0, GEAR), "at its bound"),
    ],
    ids=["it has its form", "it is not there", "it is one effect, whose rivals were all fitted"],
)
def test_nothing_else_is_fitted_where_the_closest_set_asks_for_nothing(monkeypatch, closest):
    others = judged(fitted(3826.0, GEAR, RIPPLE), "at its bound")
    assert asked(monkeypatch, closest, others)[1] == []
