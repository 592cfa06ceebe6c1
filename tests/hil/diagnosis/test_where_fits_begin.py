"""A fit begins where a matched filter found its start: with the machine's numbers following."""

from __future__ import annotations

import numpy as np
import pytest
from carriage import MACHINE, repeats

from hil.diagnosis.fitting.refit import refit
from hil.diagnosis.recorded.align import aligned
from hil.diagnosis.residuals.mismatch import mismatch
from hil.diagnosis.result import EffectAt
from hil.diagnosis.tuning.free_run import TRAIN, FreeRuns
from hil.diagnosis.tuning.retune import retune

FRICTION = EffectAt("coulomb_friction", "carriage")
HIDDEN_N = 2.0  # part of it was taken for damping
MORE_N = 3.4
FAR_TOO_MUCH_N = 100.0


def tried(strength: float, monkeypatch):
    """Strengths, dampings and costs of a fit's runs, the first of which has so much, and the damping and cost of no effect."""
    found = mismatch(MACHINE, aligned(MACHINE, repeats(3, duration_s=2.0, coulomb_N=HIDDEN_N)))
    with FreeRuns({TRAIN: found}, found.noise) as runs:
        tuning, asked, begin = retune(runs), [], runs.begin
        measured, damping = runs.measured(), [p.quantity for p in tuning.parameters].index("damping")

        def noted(trials, name=TRAIN):
            (answer, *others) = begin(trials, name)()
            asked.append((trials[0].effects[0].parameters["Fc"], trials[0].values[damping], float(np.sum((measured - answer) ** 2))))
            return lambda: [answer, *others]

        monkeypatch.setattr(runs, "begin", noted)
        refit(runs, tuning, measured, [((FRICTION,), (np.array([strength]),))])
    return asked, tuning.values[damping], float(np.sum((measured - tuning.predicted) ** 2))


def test_what_was_taken_for_damping_begins_as_strong_as_the_filter_has_it_with_less_damping(monkeypatch):
    ((first, own, worse), (second, less, cost), *_), damping, base = tried(MORE_N, monkeypatch)
    assert (first, own) == (MORE_N, damping)
    assert worse > base
    assert second == MORE_N
    assert less < damping
    assert cost < base


def test_what_no_number_makes_up_for_is_tried_weaker(monkeypatch):
    asked, _, base = tried(FAR_TOO_MUCH_N, monkeypatch)
    assert [strength for strength, _, _ in asked[:2]] == [FAR_TOO_MUCH_N, pytest.approx(0.3 * FAR_TOO_MUCH_N)]
    assert asked[0][2] > base


class BegunError(Exception):
    """A fit asks for what it does not begin with."""


OWN = object()
"""What it does cost: of the whole start 87 more than no effect, which the filter says that less damping makes up for."""


def begun_with(monkeypatch, cost_of) -> float:
    """Share of its strength a fit begins with, where trials of such shares cost so much more than no effect: `OWN` for what they do, None
    where none can be simulated.
    """
    found = mismatch(MACHINE, aligned(MACHINE, repeats(3, duration_s=2.0, coulomb_N=HIDDEN_N)))
    with FreeRuns({TRAIN: found}, found.noise) as runs:
        tuning, begin, asked = retune(runs), runs.begin, []
        measured = runs.measured()
        left = measured - tuning.predicted
        base = float(left @ left) + float(tuning.offset @ tuning.offset)

        def bent(trials, name=TRAIN):
            asked.append(trials[0].effects[0].parameters["Fc"])
            shares = [share for share in (1.0, 0.3, 0.1, 0.03) if asked[-1] == share * MORE_N]
            if not shares:
                raise BegunError
            cost = cost_of(shares[0], len(asked) == 1)
            if cost is OWN:
                return begin(trials, name)
            return lambda: [None if cost is None else measured - np.sqrt((base + cost) / (left @ left)) * left]

        monkeypatch.setattr(runs, "begin", bent)
        with pytest.raises(BegunError):
            refit(runs, tuning, measured, [((FRICTION,), (np.array([MORE_N]),))])
    return asked[-1] / MORE_N  # moved for the first sensitivity


@pytest.mark.parametrize(
    ("followed", "weaker", "begins"),
    [(30.0, 15.0, 1.0), (30.0, -15.0, 0.3), (70.0, 15.0, 0.3)],
    ids=["nearer", "better than no effect", "what numbers do not make up for"],
)
def test_where_numbers_make_up_for_the_whole_a_weaker_start_must_be_better_than_no_effect(followed, weaker, begins, monkeypatch):
    """A valley that bends: the whole costs less with less damping; a weaker one is always near to none."""

    def cost(share: float, is_first: bool):
        return OWN if is_first else followed if share == 1.0 else weaker

    assert begun_with(monkeypatch, cost) == pytest.approx(begins, rel=0.02)


@pytest.mark.parametrize("whole", [1e6, None], ids=["far too much", "cannot be simulated"])
def test_of_starts_that_numbers_do_not_make_up_for_the_nearest_counts(whole, monkeypatch):
    costs = {1.0: whole, 0.3: 9e4, 0.1: 1e4, 0.03: 1.0}
    assert begun_with(monkeypatch, lambda share, is_first: costs[share]) == pytest.approx(0.03, rel=0.02)
