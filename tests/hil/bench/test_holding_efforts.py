"""The greatest effort of a hold, from the machine file: a lever whose load has a closed form, and machines that are shipped."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from bench_machines import CARM
from falling_arm import EFFORT_Nm_A, falling_arm

from hil.bench import holding
from hil.bench.holding import Loads, with_holding_efforts
from hil.machine import Machine, load_machine
from hil.machine.drawn import drawn
from virtual_bus.effects.motion import JointMotion
from virtual_bus.effects.registry import module_of
from virtual_bus.effects.table import values_of
from virtual_bus.physics import Physics
from virtual_bus.plant.statics import effort_at
from virtual_bus.settings import EffectSetting


def limits_of(machine: Machine) -> list[float]:
    told = with_holding_efforts(machine, Physics(machine.plant, noise=False))
    assert told.bus is not None
    return [limits.holding_effort for limits in told.bus.motions]


def arm_with(*own: EffectSetting) -> Machine:
    arm = falling_arm()
    return dataclasses.replace(arm, plant=dataclasses.replace(arm.plant, effects=own), own_effects=own)


def test_it_is_the_greatest_load_and_a_quarter_the_push_of_the_first_move_and_what_the_drive_measures_amiss() -> None:
    arm = falling_arm()
    assert arm.bus is not None
    load_A = 30.0 * 9.81 * 0.1 / EFFORT_Nm_A  # level: the middle of its range, a position that is looked at
    expected = 1.25 * load_A + 0.3 + arm.judging.drives[0].tolerance
    assert limits_of(arm) == [pytest.approx(expected, rel=1e-3)]
    assert expected < arm.bus.scalings[0].limit


def test_the_first_moves_push_decides_how_much_friction_is_borne() -> None:
    assert CARM.bus is not None
    stiffer = tuple(dataclasses.replace(homing, direction_check_effort=homing.direction_check_effort + 1.0) for homing in CARM.bus.homings)
    changed = dataclasses.replace(CARM, bus=dataclasses.replace(CARM.bus, homings=stiffer))
    assert limits_of(changed) == [pytest.approx(limit + 1.0) for limit in limits_of(CARM)]


def test_more_than_a_drive_can_give_is_no_limit() -> None:
    assert CARM.bus is not None
    weak = tuple(dataclasses.replace(scaling, limit=4.5) for scaling in CARM.bus.scalings)
    changed = dataclasses.replace(CARM, bus=dataclasses.replace(CARM.bus, scalings=weak))
    propeller, roll = limits_of(CARM)
    assert propeller < 4.5 < roll
    assert limits_of(changed) == [propeller, math.inf]


@pytest.mark.parametrize("name", ["carm", "carm-real"])
def test_a_shipped_machine_is_held_with_less_at_every_pose_between_those_that_are_looked_at(name: str) -> None:
    machine = load_machine(name)
    assert machine.bus is not None
    model, most = Physics(machine.plant, noise=False), limits_of(machine)
    first, second = machine.limits
    for share in (0.03, 0.19, 0.44, 0.57, 0.81, 0.95):
        for other in (0.06, 0.31, 0.69, 0.94):
            pose = [first.lower + share * (first.upper - first.lower), second.lower + other * (second.upper - second.lower)]
            for load, limit, homing in zip(model.holding_effort(pose), most, machine.bus.homings, strict=True):
                assert abs(load) + homing.direction_check_effort < 0.97 * limit


def test_an_axis_that_turns_further_than_a_turn_is_looked_at_as_closely() -> None:
    arm = falling_arm()
    assert arm.bus is not None
    wide = dataclasses.replace(arm.bus.motions[0], lower=-5.5, upper=7.07)
    changed = dataclasses.replace(arm, bus=dataclasses.replace(arm.bus, motions=(wide,)))
    load_A = 30.0 * 9.81 * 0.1 / EFFORT_Nm_A
    assert limits_of(changed)[0] > load_A + 0.3 + arm.judging.drives[0].tolerance, "what a sound axis may take at its heaviest pose"


def test_a_load_that_the_file_leaves_open_is_the_effects_own_range_and_is_held_at_most() -> None:
    pushes = EffectSetting("constant_load", "turn", {"tau0": 1.0}, between={"tau0": (-3.0, 6.0)})
    open_ = arm_with(pushes)
    assert open_.bus is not None
    model = Physics(open_.plant, noise=False)
    for pose in (-0.4, 0.7):
        np.testing.assert_allclose(Loads(open_, model).between(np.array([pose])), [[-5.0 / EFFORT_Nm_A, 4.0 / EFFORT_Nm_A]])
    known = arm_with(dataclasses.replace(pushes, between={}))
    assert not Loads(known, model).between(np.zeros(1)).any()
    assert limits_of(open_)[0] - limits_of(known)[0] == pytest.approx(1.25 * 5.0 / EFFORT_Nm_A), "the arm is held by negative efforts"


OPEN = [
    EffectSetting("gravity_imbalance", "turn", {"mgr": 20.0, "phi": 0.3}, between={"mgr": (5.0, 60.0), "phi": (-math.pi, math.pi)}),
    EffectSetting("gravity_imbalance", "turn", {"mgr": 20.0, "phi": 0.3}, between={"mgr": (5.0, 60.0), "phi": (0.2, 1.4)}),
    EffectSetting(
        "cogging",
        "turn",
        {"Np": 3.0, "A1": 2.0, "phi1": 0.0, "A2": 1.0, "phi2": 0.5},
        between={"A1": (0.0, 20.0), "phi1": (-math.pi, math.pi), "A2": (0.0, 3.0), "phi2": (-1.0, 2.0)},
    ),
]
"""Phases of a whole turn, of either sign, and of two orders."""


@pytest.mark.parametrize("effect", OPEN, ids=["turn", "signed", "orders"])
def test_a_phase_that_is_open_lets_the_load_be_what_it_is_at_any_of_them(effect: EffectSetting) -> None:
    machine = arm_with(effect)
    model = Physics(machine.plant, noise=False)
    drawn_at = [drawn(machine, number, 2000, seed=1).own_effects[0].parameters for number in range(2000)]
    for position in (-0.4, 0.13, 0.7):
        motion = JointMotion(position, 0.0, -1.0, float(model.model["effort_ratio"][0, 0]), 0.0, 0.0)
        pull = module_of(effect.name).effort
        beside = (pull(motion, *values_of(effect)) - np.array([pull(motion, *each.values()) for each in drawn_at])) / EFFORT_Nm_A
        ((least, most),) = Loads(machine, model).between(np.array([position]))
        assert least <= beside.min()
        assert beside.max() <= most
        assert most - least < 1.35 * np.ptp(beside), "no more than drawn machines come near to"


def test_an_order_that_is_open_leaves_the_phase_open() -> None:
    machine = arm_with(dataclasses.replace(OPEN[2], parameters=OPEN[2].parameters | {"A2": 0.0}, between={"Np": (2.0, 4.0)}))
    model = Physics(machine.plant, noise=False)
    (between,) = Loads(machine, model).between(np.array([0.7]))
    assert np.ptp(between) == pytest.approx(2.0 * 2.0 / EFFORT_Nm_A)


def test_loads_of_effects_are_found_without_the_plant_so_that_a_tick_bears_many(monkeypatch: pytest.MonkeyPatch) -> None:
    looked = []
    monkeypatch.setattr(holding, "effort_at", lambda *given: looked.append(1) or effort_at(*given))
    ranges = {"D1": (-5.0, 5.0), "D2": (-1.0, 1.0), "A": (0.0, 4.0)}
    damps = EffectSetting("position_dependent_damping", "turn", {"D1": 1.0}, between=ranges)
    weak = EffectSetting("torque_constant", "turn", {"eps": 0.0}, between={"eps": (-0.1, 0.1)})
    machine = arm_with(*OPEN[1:], damps, weak)
    loads = Loads(machine, Physics(machine.plant, noise=False))
    looked.clear()
    loads.between_at(np.zeros(1))
    assert len(looked) == 5, "as stated, with the least and the greatest pull, and with either end of what changes the drive"
