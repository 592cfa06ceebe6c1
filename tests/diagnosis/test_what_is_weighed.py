"""What a search leaves beside the sets that compete for the name is weighed with them before the verdict is given."""

from __future__ import annotations

from dataclasses import replace

import pytest
from carriage import MACHINE

from hil.diagnosis import diagnose as diagnosing
from hil.diagnosis.diagnose import diagnose
from hil.diagnosis.result import EffectAt

MODE, DELAY = (EffectAt(name, "carriage") for name in ("structural_mode", "delay"))
NO_NAME = "it hardly slides"


@pytest.fixture(scope="module")
def answer(friction, with_friction):
    """The verdict where a search of these came to more than the sets that compete; what it came to is done once."""

    def answered(formless=(), unsure=()):
        found = friction.selection
        own = next(one for one in found.contenders if one.fitted is found.chosen)

        def like(effect: EffectAt, gained: float, form: str):
            gates = (*own.gates[:-1], replace(own.gate, lost_form=form))
            return replace(own, fitted=replace(own.fitted, effects=(effect,)), gained=own.gained + gained, gates=gates)

        beside = {
            "formless": tuple(like(effect, gained, NO_NAME) for effect, gained in formless),
            "unsure": tuple(like(effect, gained, "") for effect, gained in unsure),
        }
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(diagnosing, "select", lambda *_: replace(found, contenders=(own,), **beside))
            patch.setattr(diagnosing, "without_effects", lambda runs, tuning, selection: tuning)
            patch.setattr(diagnosing, "with_both_motions", lambda runs, tuning, judged, sets, tempers: sets)
            return diagnose(MACHINE, *with_friction, look_further=False).diagnosis

    return answered


def test_a_set_that_is_no_name_and_likelier_than_all_makes_the_verdict_ambiguous(answer):
    assert answer().verdict == "explained"
    likelier = answer(formless=[(MODE, 1e5)])
    assert likelier.verdict == "ambiguous" and NO_NAME in likelier.reason
    assert answer(formless=[(MODE, -1e5)]).verdict == "explained"


def test_an_ambiguous_answer_says_what_may_act_too(answer):
    said = answer(formless=[(MODE, 1e5)], unsure=[(DELAY, 0.0)])
    assert said.verdict == "ambiguous" and str(DELAY) in said.reason
    assert str(DELAY) not in answer(formless=[(MODE, 1e5)], unsure=[(DELAY, -1e5)]).reason
    assert str(DELAY) not in answer(unsure=[(DELAY, 0.0)]).reason  # nor where the name is certain
