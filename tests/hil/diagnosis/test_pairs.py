"""Two effects at once, and fits that left their own equation."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from hil.diagnosis.fitting.information import Form
from hil.diagnosis.fitting.refit import Fitted
from hil.diagnosis.fitting.screening import Screened
from hil.diagnosis.judging.form import BENDS_BY, lost_form
from hil.diagnosis.judging.judgement import Contender, Stand
from hil.diagnosis.judging.tried import Tried
from hil.diagnosis.result import EffectAt
from hil.diagnosis.searching import step
from hil.diagnosis.searching.pairs import beside_rivals, pairs, without_what_stood
from hil.diagnosis.searching.selection import Selection, parts_not_fitted
from hil.diagnosis.searching.step import Steps
from hil.diagnosis.searching.surplus import has_no_surplus, parts_that_passed
from hil.diagnosis.searching.ways import Way
from hil.diagnosis.starting.candidates import Candidate
from hil.diagnosis.tuning.retune import Tuning
from virtual_bus.effects import presliding_hysteresis
from virtual_bus.effects.motion import ReactionState

ENTRIES = 400


def fitted(name: str, values: list[float], response: np.ndarray | None = None) -> Fitted:
    predicted = np.zeros(0) if response is None else response
    return Fitted((EffectAt(name, "carriage"),), (np.array(values),), np.zeros(1), predicted, 0.0, ((0, 0),), np.zeros((0, 1)), np.ones(1))


def screened(name: str, value: float, response: np.ndarray, tuning: Tuning) -> Screened:
    assert tuning.jacobian.shape[1] == 1
    return Screened(EffectAt(name, "carriage"), np.array([value]), np.append(response, 0.0).astype(np.float32), 0.0)


@pytest.fixture
def bench():
    """A tuning that nothing imitates, and three responses: the third is nearly the sum of the two others."""
    random = np.random.default_rng(4)
    one, other, further = np.linalg.qr(random.standard_normal((ENTRIES, 3)))[0].T
    nothing = np.zeros(ENTRIES)
    tuning = Tuning((), np.zeros(0, dtype=int), np.ones(1), np.zeros(1), np.zeros(0), nothing, np.zeros((ENTRIES, 1)), np.eye(1))
    return tuning, one, other, one + other + 0.3 * further


def test_a_pair_of_which_neither_comes_first_alone_is_seen_without_a_run(bench):
    tuning, one, other, both = bench
    residual = 20.0 * one + 20.0 * other
    singles = [fitted("cogging", [0.0], 19.0 * both), fitted("coulomb_friction", [2.0], 2.0 * one)]
    best, *_ = pairs(tuning, residual, singles, [screened("viscous_friction", 5.0, 4.0 * other, tuning)])
    names = {str(effect) for effect in best.start[0]}
    assert names == {"coulomb_friction at carriage", "viscous_friction at carriage"}
    assert best.gain == pytest.approx(800.0, rel=1e-4)
    assert best.added == pytest.approx(400.0, rel=1e-4)
    strengths = {effect.effect: values[0] for effect, values in zip(*best.start, strict=True)}
    assert strengths == pytest.approx({"coulomb_friction": 20.0, "viscous_friction": 25.0}, rel=1e-4)


def test_a_pair_that_would_need_friction_to_push_is_none(bench):
    tuning, one, other, _ = bench
    singles = [fitted("coulomb_friction", [2.0], 2.0 * one)]
    beside = [screened("viscous_friction", 5.0, 4.0 * other, tuning), screened("constant_load", 5.0, 4.0 * other, tuning)]
    found = pairs(tuning, 20.0 * one - 8.0 * other, singles, beside)
    assert [{effect.effect for effect in pair.start[0]} for pair in found] == [{"coulomb_friction", "constant_load"}]
    assert found[0].start[1][1][0] == pytest.approx(-10.0, rel=1e-4)


def test_a_wave_of_the_other_sign_is_half_a_cycle_on(bench):
    tuning, one, other, _ = bench
    singles = [fitted("coulomb_friction", [2.0], 2.0 * one)]
    wave = Screened(
        EffectAt("cogging", "carriage"), np.array([3.0, 4.0, 1.0, 0.5, -2.0]), np.append(4.0 * other, 0.0).astype(np.float32), 0.0
    )
    (found,) = pairs(tuning, 20.0 * one - 8.0 * other, singles, [wave])
    order, A1, phi1, A2, phi2 = found.start[1][1]
    along = np.linspace(0.0, 7.0, 50)
    torque = A1 * np.cos(order * along + phi1) + A2 * np.cos(2.0 * order * along + phi2)
    wanted = -2.0 * (4.0 * np.cos(3.0 * along + 1.0) + 0.5 * np.cos(6.0 * along - 2.0))
    assert torque == pytest.approx(wanted, rel=1e-6, abs=1e-9)


@pytest.mark.parametrize(
    ("name", "values", "lost"),
    [
        ("structural_mode", [1.0, 16.0, 1.0], True),  # J, f, zeta: it no longer swings
        ("structural_mode", [1.0, 16.0, 0.5], True),  # a cycle later 3 % are left
        ("structural_mode", [1.0, 16.0, 0.12], True),  # 47 %
        ("structural_mode", [1.0, 16.0, 0.1], False),  # 53 %
        ("structural_mode", [1.0, 16.0, 0.0], False),
        ("bouc_wen_hysteresis", [1.0, 0.8, 0.03, 0.5, 1.0], True),  # k, A, z_max, beta_share, n: slides at 0.0375, 0.025 is shown
        ("bouc_wen_hysteresis", [1.0, 1.0, 0.02, 0.5, 1.0], False),
        ("presliding_hysteresis", [0.06, 0.0, 0.1, 2.0, 0.0], True),  # Fc, Fs - Fc, vs, sigma0, sigma1
        ("presliding_hysteresis", [0.06, 0.0, 0.1, 3.0, 0.0], False),
        ("presliding_hysteresis", [0.06, 0.0, 0.1, 50.0, 0.0], False),
        ("presliding_hysteresis", [0.06, 0.0, 0.1, 70.0, 0.0], True),  # bends by 0.00086, the encoder shows 0.001
        ("presliding_hysteresis", [0.06, 0.03, 0.1, 70.0, 0.0], False),  # by 0.0013 while it creeps, slides at 0.00086
        ("presliding_hysteresis", [0.06, 0.11, 0.1, 50.0, 0.0], False),
        ("presliding_hysteresis", [0.06, 0.13, 0.1, 50.0, 0.0], True),  # sticks three times as hard as it slides
        ("presliding_hysteresis", [0.0, 0.06, 0.1, 50.0, 0.0], True),
        ("presliding_hysteresis", [0.06, 0.06, 0.1, 3.0, 0.0], False),  # slides at 0.02, although it bends by 0.04
        ("stribeck_friction", [5.0, 1.0, 1.4], True),  # Fs - Fc, vs, delta
        ("stribeck_friction", [5.0, 0.1, 2.0], False),
        ("cogging", [0.9, 1.0, 0.0, 0.0, 0.0], True),  # Np, A1, phi1, A2, phi2: half a cycle is 1 per turn
        ("cogging", [1.1, 1.0, 0.0, 0.0, 0.0], False),
        ("base_motion", [0.1, 0.9, 0.0], True),  # A, f, phi
        ("base_motion", [0.1, 1.1, 0.0], False),
        ("viscous_friction", [0.0], False),
        ("gear_ratio", [0.1], True),  # no machine's ratio is off by a tenth
        ("rectified_sensor", [1.0, 1.0], False),  # share, sign
        ("rectified_sensor", [0.74, 1.0], False),
        ("rectified_sensor", [0.0, -1.0], False),
        ("rectified_sensor", [2e-5, 1.0], True),
        ("backlash", [1e-5, 9e-5], False),  # b, flank: fits keep it within that (`coordinates.AT_MOST`)
        ("backlash", [1e-5, 0.0], False),
        ("end_stop", [50.0, 0.0, 0.3, 1.0], False),  # K, D, at_position, side: the travel's middle is at 0.2
        ("end_stop", [50.0, 0.0, 0.1, 1.0], True),
        ("end_stop", [50.0, 0.0, 0.1, -1.0], False),
        ("end_stop", [50.0, 0.0, 0.3, -1.0], True),
        ("cable_spring", [1.0, 3.9, 0.0], False),  # kc, kc3, theta0: the travel's ends are at -1 and 0.5
        ("cable_spring", [1.0, 4.1, 0.0], True),
        ("cable_spring", [1.0, 1.9, 0.5], True),
        ("cable_spring", [0.0, 1e-3, 0.0], True),
        ("cable_spring", [1e-3, 0.0, 0.0], False),
    ],
)
def test_a_shape_at_the_end_of_its_law_is_no_name(name, values, lost):
    limits = {
        "cogging": (1.0, np.inf),
        "base_motion": (1.0, np.inf),
        "bouc_wen_hysteresis": (0.001, 0.025),
        "presliding_hysteresis": (0.001, 0.025),
        "end_stop": (0.2, 0.2),
        "cable_spring": (-1.0, 0.5),
    }
    limits_at = {EffectAt(effect, "carriage"): ends for effect, ends in limits.items()}
    assert bool(lost_form(fitted(name, values), limits_at, np.zeros(0))) == lost


@pytest.mark.parametrize(("places", "lost"), [(("carriage", "carriage"), True), (("carriage", "load"), False)])
def test_two_hystereses_at_one_place_are_no_names_of_one(places, lost):
    """What one law leaves of another a second one takes up."""
    bristles, spring = [0.06, 0.0, 0.1, 50.0, 0.0], [1.0, 1.0, 0.02, 0.5, 1.0]
    names = tuple(EffectAt(name, at) for name, at in zip(("presliding_hysteresis", "bouc_wen_hysteresis"), places, strict=True))
    both = replace(fitted("presliding_hysteresis", bristles), effects=names, values=(np.array(bristles), np.array(spring)))
    assert ("one hysteresis" in lost_form(both, {}, np.zeros(0))) == lost


@pytest.mark.parametrize("parameters", [(10.0, 10.0, 1e-3, 7e3, 0.0), (0.0, 20.0, 1e-3, 7e3, 0.0), (10.0, 0.0, 1e-3, 7e3, 0.0)])
def test_bristles_bend_as_far_as_their_law_says_that_creeps(parameters):
    bend = 0.0
    for _ in range(4000):  # 0.04 rad
        _, bend, _ = presliding_hysteresis.react(ReactionState(bend, 0.0, 0.0, 1e-5, 1e-5, 1.0), *parameters)
    assert BENDS_BY["presliding_hysteresis"](*parameters) == pytest.approx(bend, rel=1e-3)


@pytest.mark.parametrize(
    ("one_way", "other_way", "lost"), [(8.0, 0.0, True), (0.0, 8.0, True), (0.5, 0.0, False), (8.0, 0.1, False), (0.0, 0.0, False)]
)
def test_no_oil_is_viscous_one_way_only(one_way, other_way, lost):
    rows = np.random.default_rng(8).normal(size=(400, 4))
    rubbing = replace(fitted("asymmetric_friction", [10.0, 10.0, one_way, other_way]), free=tuple((0, p) for p in range(4)), jacobian=rows)
    assert bool(lost_form(rubbing, {}, np.zeros(400))) == lost


@pytest.mark.parametrize(("loss", "lost"), [(3.0, False), (30.0, True)])
def test_viscosity_one_way_that_recordings_do_not_want_is_the_joint_s_damping(loss, lost):
    """What both directions have in common the joint's own number may have, and then the smaller one of the two is zero."""
    rows = np.random.default_rng(8).normal(size=(400, 4))
    levels = fitted("asymmetric_friction", [10.0, 10.0, 8.0, 0.0])
    forms = tuple(Form(loss if absent == (2, 3) else 1e6, np.ones(2), absent) for absent in ((0, 1), (2, 3)))
    rubbing = replace(levels, free=tuple((0, p) for p in range(4)), jacobian=rows, simpler=forms)
    assert bool(lost_form(rubbing, {}, np.zeros(400))) == lost


@pytest.mark.parametrize(
    ("flank", "wanted", "lost"), [(9e-5, 4.0, True), (8.98e-5, 4.0, True), (9e-5, 3.0, False), (9e-5, -4.0, False), (5e-5, 4.0, False)]
)
def test_a_gap_that_wants_wider_flanks_than_it_may_have_is_a_spring_that_hardens(flank, wanted, lost):
    """By the root of the energy that they would remove: 16 or 9."""
    column = np.random.default_rng(9).normal(size=400)
    gap = replace(
        fitted("backlash", [1e-5, flank]), free=((0, 0), (0, 1)), jacobian=np.column_stack([np.zeros(400), column]), predicted=np.zeros(400)
    )
    assert bool(lost_form(gap, {}, wanted * column / np.linalg.norm(column))) == lost


def test_an_effect_that_stood_for_another_one_is_surplus_beside_it(bench):
    """A spring was found beside a friction; without it, friction and an eccentricity leave 5 more than all three, which chance does."""
    tuning, *_ = bench
    names = [EffectAt(name, "carriage") for name in ("quadratic_friction", "cable_spring", "encoder_eccentricity")]
    friction, spring, wave = names
    tried = Tried([Candidate(effect, ()) for effect in names])

    def left(cost: float, *effects: EffectAt) -> Fitted:
        nothing = np.zeros(1), np.zeros(ENTRIES), cost, tuple((k, 0) for k in range(len(effects))), np.zeros((ENTRIES, 0)), np.zeros(0)
        return Fitted(effects, (np.ones(1),) * len(effects), *nothing)

    found, rival, all_three = left(86.0, friction, spring), left(39.0, friction, wave), left(34.0, friction, spring, wave)
    stand = Stand(found, tuning, found.cost, np.zeros(ENTRIES), None, ())
    assert not has_no_surplus(all_three, stand, [rival], tried, ENTRIES)
    assert has_no_surplus(all_three, stand, [replace(rival, cost=80.0)], tried, ENTRIES)
    assert has_no_surplus(all_three, stand, [found], tried, ENTRIES)  # which the gate asks about


def test_what_was_found_beside_an_effect_is_tried_beside_its_rivals_too():
    friction, warming, mode = (
        EffectAt(name, "carriage") for name in ("viscous_friction", "temperature_dependent_friction", "structural_mode")
    )

    def fitted(*effects: EffectAt) -> Fitted:
        values = tuple(np.array([float(len(effect.effect))]) for effect in effects)
        return Fitted(effects, values, np.zeros(1), np.zeros(ENTRIES), 0.0, (), np.zeros((ENTRIES, 0)), np.zeros(0))

    both = fitted(friction, mode)
    rivals = [fitted(friction), fitted(warming), fitted(mode)]
    (start,) = beside_rivals(rivals, fitted(friction), both)
    assert start == ((warming, mode), (*fitted(warming).values, both.values[1]))
    assert beside_rivals(rivals, None, both) == []
    assert beside_rivals(rivals, fitted(warming), both) == []
    assert beside_rivals(rivals, fitted(friction), both, [{warming}]) == [start]
    assert beside_rivals(rivals, fitted(friction), both, [{mode, warming}]) == []
    assert beside_rivals([fitted(mode, warming)], fitted(warming, mode), fitted(warming, mode, friction)) == []  # itself, in another order


def test_a_pair_is_asked_about_beside_those_of_its_parts_that_are_there():
    def contender(names: str, passed: bool) -> SimpleNamespace:
        return SimpleNamespace(fitted=SimpleNamespace(effects=tuple(EffectAt(name, "arm") for name in names.split())), passed=passed)

    there, refused, another = contender("cogging", True), contender("delay", False), contender("payload", True)
    pair = contender("cogging delay", True)
    assert parts_that_passed(pair, [there, refused, another, pair]) == [there]


def test_what_was_added_is_fitted_without_each_of_what_it_was_added_to():
    """From where it is beside them; what stands is not fitted without what was added: that it was before."""
    names = ("coulomb_friction", "cogging", "structural_mode")
    friction, wave, mode = (fitted(name, [float(k + 1)]) for k, name in enumerate(names))

    def together(*fits: Fitted) -> Fitted:
        return replace(fits[0], effects=tuple(fit.effects[0] for fit in fits), values=tuple(fit.values[0] for fit in fits))

    def sets(starts: list) -> list[dict[str, float]]:
        return [{effect.effect: float(own[0]) for effect, own in zip(*start, strict=True)} for start in starts]

    assert sets(without_what_stood(friction, together(friction, mode))) == [{"structural_mode": 3.0}]
    assert sets(without_what_stood(together(friction, wave), together(friction, mode, wave))) == [
        {"structural_mode": 3.0, "cogging": 2.0},
        {"coulomb_friction": 1.0, "structural_mode": 3.0},
    ]
    assert without_what_stood(None, mode) == []
    assert without_what_stood(friction, mode) == []  # no larger set: it stands in its place


@pytest.mark.parametrize(("costs", "gained"), [((), 1000.0), ((1900.0, 1040.0), 40.0), ((1900.0, 990.0), 0.0)])
def test_a_set_shows_by_that_effect_which_it_loses_least_without(costs, gained):
    """A pair that was found at once gained 1000 over nothing; a part that was fitted closer than the set leaves nothing to gain."""
    names = ("coulomb_friction", "cogging")
    friction, wave = (fitted(name, [1.0]) for name in names)
    pair = replace(friction, effects=(*friction.effects, *wave.effects), values=(*friction.values, *wave.values), cost=1000.0)
    parts = tuple(replace(part, cost=cost) for part, cost in zip((friction, wave), costs, strict=False))
    found = Selection(pair, (), (Contender(pair, 0.0, 0.0, 0.0, (SimpleNamespace(gain=1000.0),) * 2),), (), None, smaller=(pair, *parts))
    assert found.gained_by_least(pair) == gained
    assert found.gained_by_least(None) == np.inf


def test_what_a_set_shows_is_known_of_the_closer_fit_of_another_way_as_well():
    friction = fitted("coulomb_friction", [1.0])
    closer = replace(friction, cost=900.0)
    found = Selection(friction, (), (Contender(closer, 0.0, 0.0, 0.0, (SimpleNamespace(gain=1000.0),)),), (), None)
    assert found.contender_of(friction).fitted is closer
    assert found.gained_by_least(friction) == 1000.0


def test_every_effect_of_what_is_named_is_left_out_once(monkeypatch):
    """What the search ended with, and the set that gains most, where a part of them was never fitted; none twice."""
    friction, wave, mode = (fitted(name, [1.0]) for name in ("coulomb_friction", "cogging", "structural_mode"))

    def both(one: Fitted, other: Fitted, gained: float) -> Contender:
        pair = replace(one, effects=(*one.effects, *other.effects), values=(*one.values, *other.values))
        return Contender(pair, gained, 0.0, 0.0, (SimpleNamespace(gain=gained),) * 2)

    asked = []
    monkeypatch.setattr(step, "refit", lambda runs, tuning, measured, starts: asked.extend(starts) or [None for _ in starts])
    monkeypatch.setattr(step, "polish", lambda runs, tuning, measured, fits: fits)
    ended, most, other = both(friction, wave, 900.0), both(friction, mode, 1000.0), both(wave, mode, 800.0)
    runs = SimpleNamespace(measured=lambda: None)
    steps = Steps(runs, None, None, 0.0, None, None)
    way = Way(SimpleNamespace(fitted=ended.fitted), contenders=(other, ended, most), smaller=(friction,))
    assert parts_not_fitted(steps, way) == []
    assert [names for names, _ in asked] == [wave.effects, mode.effects]
    assert parts_not_fitted(steps, Way(SimpleNamespace(fitted=None))) == []
