"""Effects of several strengths that add up, against the least squares that they are; which candidates are worth a fit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import scipy.optimize

from hil.diagnosis.fitting.screening import Screened, screen, shortlist
from hil.diagnosis.result import EffectAt
from hil.diagnosis.starting.candidates import Candidate, places_to_try
from hil.diagnosis.tuning.retune import Tuning
from hil.machine import load_machine
from virtual_bus.effects.registry import effects

ENTRIES = 300
MISALIGNED = EffectAt("imu_misalignment", "imu")


class Linear:
    """Free runs of a machine whose whitened answer is in proportion to each of an effect's strengths."""

    def __init__(self, name: str) -> None:
        self._names = [p.name for p in effects()[name].parameters]
        self.columns = np.random.default_rng(2).standard_normal((ENTRIES, len(self._names)))

    def begin(self, trials):
        return lambda: [sum(self.columns @ [one.parameters[name] for name in self._names] for one in trial.effects) for trial in trials]


def test_strengths_that_act_against_each_other_are_found_together():
    runs = Linear("imu_misalignment")
    hidden = np.array([0.02, -0.03, 0.01])
    noise = np.random.default_rng(3).standard_normal(ENTRIES) * 1e-3
    tuning = Tuning((), np.zeros(0, dtype=int), np.ones(1), np.zeros(1), np.zeros(0), np.zeros(ENTRIES), np.zeros((ENTRIES, 1)), np.eye(1))
    guess = Candidate(MISALIGNED, (np.array([0.01, 0.01, 0.0]), np.array([0.01, 0.01, 0.01])))
    (found,) = screen(runs, tuning, [guess], runs.columns @ hidden + noise)
    assert found.values == pytest.approx(hidden, abs=5e-4)


def test_a_friction_of_either_way_is_mixed_of_what_it_may_be():
    """A guess with a viscous part that nothing wants; the level and the viscous part of one way are nearly one response."""
    runs = Linear("asymmetric_friction")
    runs.columns[:, 2] = 0.9 * runs.columns[:, 0] + 0.4 * runs.columns[:, 2]
    wanted = runs.columns @ np.array([0.03, 0.05, -0.01, 0.0])
    tuning = Tuning((), np.zeros(0, dtype=int), np.ones(1), np.zeros(1), np.zeros(0), np.zeros(ENTRIES), np.zeros((ENTRIES, 1)), np.eye(1))
    guess = Candidate(EffectAt("asymmetric_friction", "carriage"), (np.array([0.01, 0.02, 3.0, 0.01]),))
    (found,) = screen(runs, tuning, [guess], wanted)
    values, left = scipy.optimize.nnls(runs.columns, wanted)
    assert found.values == pytest.approx(values, abs=1e-5)
    assert found.score == pytest.approx(wanted @ wanted - left**2)


def test_a_stop_softer_than_its_start_is_found():
    """A start pushes as hard as all that is missing, over a part of the travel; a soft stop does a tenth or a two-hundredth of that."""
    runs = Linear("end_stop")
    runs.columns[:, 1:] = 0.0  # in proportion to its stiffness, and at one place
    hidden = 0.5 * runs.columns[:, 0]
    noise = np.random.default_rng(3).standard_normal(ENTRIES) * 1e-3
    tuning = Tuning((), np.zeros(0, dtype=int), np.ones(1), np.zeros(1), np.zeros(0), np.zeros(ENTRIES), np.zeros((ENTRIES, 1)), np.eye(1))
    stops = [Candidate(EffectAt("end_stop", at), (np.array([K, 0.0, 0.5, 1.0]),)) for at, K in (("arm", 5.0), ("boom", 100.0))]
    found = {one.effect.at: one for one in screen(runs, tuning, stops, hidden + noise)}
    assert found["arm"].values == pytest.approx([0.5, 0.0, 0.5, 1.0], rel=1e-2)
    assert found["boom"].score == pytest.approx(hidden @ hidden, rel=1e-2)


def test_what_swings_along_is_found_though_it_starts_a_thousand_times_too_heavy():
    """An inertia over pose moves the recordings another way than the residual's until it is small."""

    class Rotating(Linear):
        def begin(self, trials):
            def answer(J: float) -> np.ndarray:
                return 100.0 * J * (np.cos(50.0 * J) * self.columns[:, 0] + np.sin(50.0 * J) * self.columns[:, 1])

            return lambda: [sum(answer(one.parameters["dJ"]) for one in trial.effects) for trial in trials]

    runs, hidden = Rotating("pose_dependent_dynamics"), 1e-4
    wanted = 100.0 * hidden * runs.columns[:, 0]
    noise = np.random.default_rng(3).standard_normal(ENTRIES) * 1e-6
    tuning = Tuning((), np.zeros(0, dtype=int), np.ones(1), np.zeros(1), np.zeros(0), np.zeros(ENTRIES), np.zeros((ENTRIES, 1)), np.eye(1))
    guess = Candidate(EffectAt("pose_dependent_dynamics", "pan"), (np.array([0.06, 0.0]),))
    assert np.cos(50.0 * 0.06) < 0.0
    (found,) = screen(runs, tuning, [guess], wanted + noise)
    assert found.values[0] == pytest.approx(hidden, rel=0.1)


def test_many_alike_leave_a_fit_to_what_is_unlike_them():
    """Nine of one response and one across it: the best three are fitted, and the tenth."""
    friction, wave = np.eye(ENTRIES)[:2].astype(np.float32)
    alike = [Screened(EffectAt("coulomb_friction", f"axis_{k}"), np.zeros(1), friction + 0.01 * k * wave, 100.0 - k) for k in range(9)]
    unlike = Screened(EffectAt("cogging", "axis_0"), np.zeros(5), wave, 50.0)
    assert shortlist([*alike, unlike], 3, 0.02) == [*alike[:3], unlike]
    assert shortlist([*alike, unlike], 3, 0.6) == alike[:3]


def test_what_is_mixed_of_several_strengths_takes_no_other_ones_place():
    responses = np.eye(ENTRIES)[:4].astype(np.float32)
    names = ("asymmetric_friction", "coulomb_friction", "load_dependent_friction", "viscous_friction")
    screened = [Screened(EffectAt(name, "axis"), np.zeros(1), responses[0], 100.0 - k) for k, name in enumerate(names)]
    assert shortlist(screened, 2, 0.02) == screened[:3]
    assert shortlist([*screened[1:], screened[0]], 2, 0.02) == [*screened[1:3], screened[0]]  # the loudest
    last = Screened(screened[0].effect, np.zeros(1), responses[0], 90.0)
    assert shortlist([screened[1], screened[3], last], 8, 0.02) == [screened[1], screened[3], last]  # there is room
    unlike = [Screened(EffectAt(f"unlike_{k}", "axis"), np.zeros(1), responses[k], 50.0 - k) for k in (1, 2)]
    assert shortlist([*screened, *unlike], 2, 0.02) == [*screened[:3], *unlike]


def test_the_loudest_candidate_is_fitted_wherever_its_scatter_puts_it():
    quiet = [Screened(EffectAt(f"quiet_{n}", "mass"), np.ones(1), np.array([1.0, 0.0]), 10.0 - n) for n in range(4)]
    loud = Screened(EffectAt("loud", "mass"), np.ones(1), np.array([1.0, 0.0]), 50.0)
    assert shortlist([*quiet, loud], 3, 0.02) == [*quiet[:3], loud]
    assert shortlist([loud, *quiet], 3, 0.02) == [loud, *quiet[:2]]


def test_gravity_is_no_candidate_where_the_machine_file_has_none():
    """An electronic oscillator carries no weight; the C-arm's propeller may."""
    circuit, carm = load_machine("silverbox"), load_machine("carm")
    assert "gravity_imbalance" not in {place.effect for place in places_to_try(circuit.plant, ["position_mass"])}
    assert EffectAt("gravity_imbalance", "propeller") in places_to_try(carm.plant, ["position_propeller"])


def test_gravity_over_position_is_no_candidate_where_a_joint_slides():
    """Its weight is the same everywhere: a constant load."""
    emps = load_machine("emps").plant
    held = replace(emps, tree=replace(emps.tree, gravity_m_s2=np.array([0.0, 0.0, -9.81])))
    tried = {place.effect for place in places_to_try(held, ["position_carriage"])}
    assert "constant_load" in tried and "gravity_imbalance" not in tried


def test_a_clock_may_be_one_channels_or_that_of_a_whole_imu():
    tried = places_to_try(load_machine("carm").plant, ["imu_x", "gyro_y", "current_roll"])
    assert {place.at for place in tried if place.effect == "clock_offset"} == {"imu", "imu_x", "gyro_y", "current_roll"}
    alone = places_to_try(load_machine("carm").plant, ["gyro_y", "current_roll"])
    assert {place.at for place in alone if place.effect == "clock_offset"} == {"gyro_y", "current_roll"}  # not one law twice
