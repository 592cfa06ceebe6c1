"""What a search leaves beside the sets that compete for the name is weighed with them before the verdict is given."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType, SimpleNamespace

import numpy as np
import pytest
from carriage import MACHINE

from hil.diagnosis import diagnose as diagnosing
from hil.diagnosis.diagnose import diagnose
from hil.diagnosis.fitting.refit import Fitted
from hil.diagnosis.judging.gate import IN_SAMPLE, PRIOR_FREEDOM, PRIOR_VARIANCE, Gate
from hil.diagnosis.judging.judgement import Contender
from hil.diagnosis.ranking.naming import Weighed
from hil.diagnosis.ranking.weighing import evidence_of
from hil.diagnosis.result import EffectAt
from hil.diagnosis.tuning.retune import Tuning

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


ENTRIES = 500


def gate(gain: float, beyond: float, needed: float, scatter: float = 1.0, held_out: tuple[float, float] = (0.0, 0.0)) -> Gate:
    return Gate(
        gain=gain, needed=needed, scatter=scatter, trained=1e-9, over_simulator=10.0, asked=1, held_out_deviations=0.0,
        held_out_gain=held_out[0], held_out_beyond=held_out[1], followed=1e-3, placebo_gain=0.0, share=1.0, is_first=False, beyond=beyond,
    )  # fmt: skip


def weighed_together(
    *sets: tuple[tuple[Gate, ...], int | tuple[EffectAt, ...]],
    by_moving: tuple[float, float] = (0.0, 0.0),
    values: Mapping[EffectAt, np.ndarray] = MappingProxyType({}),
) -> list[Weighed]:
    """Sets with their gates, each along a direction of its own, the last one moved. Repeats scatter by 5 along the first difference."""
    directions = np.linalg.qr(np.random.default_rng(1).standard_normal((ENTRIES, len(sets))))[0].T
    along = (directions[0] - directions[1]) / np.sqrt(2.0)
    repeats = np.stack([np.sqrt(5.0) * sign * along for sign in (1.0, -1.0, 1.0, -1.0)])
    runs = SimpleNamespace(
        repeats=lambda name: [repeats],
        machine=MACHINE,
        noise=SimpleNamespace(kind="repeats", rate_Hz=10.0),
        sets={"train": SimpleNamespace(channels=("a",))},
    )
    nothing = np.zeros(0)
    tuning = Tuning((), nothing.astype(int), nothing, nothing, nothing, np.zeros(ENTRIES), np.zeros((ENTRIES, 0)), np.zeros((0, 0)))
    contenders = []
    for number, (gates, effects) in enumerate(sets):
        names = effects if isinstance(effects, tuple) else tuple(EffectAt("cogging", "carriage", k) for k in range(effects))
        fitted = Fitted(
            names,
            tuple(values.get(name, nothing) for name in names),
            nothing,
            directions[number],
            1000.0,
            (),
            np.zeros((ENTRIES, 0)),
            nothing,
        )
        moved = by_moving if number == len(sets) - 1 else (0.0, 0.0)
        steps = {id(one): one for one in gates}.values()
        gains = sum(one.certain_gain for one in steps) + moved[0], sum(one.held_out_gain for one in steps) + moved[1]
        contenders.append(Contender(fitted, gains[0], gains[1], 1000.0 - gains[1], gates, by_moving=moved, known=(7.0, 8.0)))
    return list(evidence_of(runs, tuning, None, contenders, tried=50, found=True).sets)


def test_sets_of_one_step_stand_apart_by_what_they_leave_beside_errors_of_what_both_have():
    first = gate(1000.0, 1000.0, 10.0, held_out=(300.0, 300.0))
    chosen, rival = gate(500.0, 60.0, 10.0, held_out=(50.0, 40.0)), gate(460.0, 300.0, 20.0, scatter=3.0, held_out=(20.0, 90.0))
    one, other = weighed_together(((first, chosen), 2), ((first, rival), 2), by_moving=(-30.0, 70.0))
    assert one.compared is None
    assert other.compared.reference == pytest.approx((one.train, one.held_out))
    assert other.compared.apart == pytest.approx((500.0 - 460.0, 50.0 - 20.0))
    assert other.compared.beyond == pytest.approx((60.0 - 300.0, 40.0 - 90.0))
    assert other.compared.by_moving == pytest.approx((30.0, -70.0))
    assert other.compared.known == (7.0, 8.0)
    expected = (PRIOR_FREEDOM * PRIOR_VARIANCE + 4.0 * 5.0 / IN_SAMPLE) / (PRIOR_FREEDOM + 3.0 - 2.0)
    assert other.compared.scatter == pytest.approx(expected)
    assert other.train - one.train == pytest.approx(500.0 - (460.0 - 2.0 * 20.0) + 30.0)  # as misfits they are what they were


def test_sets_of_as_many_effects_stand_apart_by_what_they_leave_whichever_effect_was_added_first():
    """What a step is charged for chance depends on what it was added to: a pair that one step added is charged once, and little."""
    steps, at_once = (gate(1000.0, 1000.0, 20.0, scatter=2.0), gate(500.0, 60.0, 10.0, scatter=3.0)), gate(1502.0, 1502.0, 10.0)
    other, one = weighed_together((steps, 2), ((at_once, at_once), 2))
    assert one.compared is None and one.train < other.train - 40.0
    assert other.compared.apart == other.compared.beyond == pytest.approx((1502.0 - 1500.0, 0.0))
    assert other.compared.known == (0.0, 0.0)


def test_what_a_number_removes_by_itself_counts_where_it_came_in_one_step_with_another_effect():
    """A compliance was found alone, and a pair that holds it at once."""
    compliance, ripple = EffectAt("joint_compliance", "carriage"), EffectAt("cogging", "carriage")
    alone, later, at_once = (
        gate(1000.0, 1000.0, 10.0, held_out=(300.0, 290.0)),
        gate(50.0, 50.0, 10.0),
        gate(1060.0, 1060.0, 10.0, held_out=(310.0, 305.0)),
    )
    sets = [((compliance, ripple), (alone, later)), ((ripple, compliance), (at_once, at_once)), ((ripple,), (at_once,))]
    one, other, without = weighed_together(*((gates, effects) for effects, gates in sets))
    assert one.by_numbers == other.by_numbers == (1000.0, 300.0)
    assert without.by_numbers == (0.0, 0.0)
    assert one.by_signs == other.by_signs == (0.0, 0.0)
    # of two that were found alone the one that gained less, and no more than its step
    beside = gate(900.0, 900.0, 10.0, held_out=(320.0, 290.0))
    sets = [*sets, ((EffectAt("backlash", "carriage"), compliance), (later, beside))]
    assert weighed_together(*((gates, effects) for effects, gates in sets))[1].by_numbers == (900.0, 310.0)
    # nothing of one that loses held out, or did not pass
    lost = gate(1000.0, 1000.0, 10.0, held_out=(-300.0, -290.0))
    sets[0] = ((compliance, ripple), (lost, later))
    assert weighed_together(*((gates, effects) for effects, gates in sets[:3]))[1].by_numbers == (1000.0, 0.0)
    sets[0] = ((compliance,), (replace(alone, placebo_gain=2000.0),))
    assert weighed_together(*((gates, effects) for effects, gates in sets[:3]))[1].by_numbers == (0.0, 0.0)


def test_a_number_that_stands_for_a_law_counts_without_its_share_however_it_came():
    viscous, ripple = EffectAt("viscous_friction", "carriage"), EffectAt("cogging", "carriage")
    alone, at_once = gate(1000.0, 1000.0, 10.0, held_out=(300.0, 290.0)), gate(1060.0, 1060.0, 10.0, held_out=(310.0, 305.0))
    for set_ in weighed_together(((alone,), (viscous,)), ((at_once, at_once), (ripple, viscous))):
        assert set_.by_numbers == pytest.approx((980.0, 294.0))


def test_a_sign_counts_where_it_came_in_one_step_with_another_effect():
    sign, ripple = EffectAt("rectified_sensor", "carriage"), EffectAt("cogging", "carriage")
    alone, at_once = gate(1000.0, 1000.0, 10.0, held_out=(300.0, 290.0)), gate(1060.0, 1060.0, 10.0, held_out=(310.0, 305.0))
    values = {sign: np.array([0.0, 1.0])}
    _, other = weighed_together(((alone,), (sign,)), ((at_once, at_once), (ripple, sign)), values=values)
    assert other.by_signs == other.by_numbers == (1000.0, 300.0)


def test_sets_of_more_or_fewer_effects_are_not_compared():
    chosen, rival = (gate(1000.0, 1000.0, 10.0), gate(500.0, 60.0, 10.0)), gate(990.0, 990.0, 10.0)
    _, other = weighed_together((chosen, 2), ((rival,), 1))
    assert other.compared is None
