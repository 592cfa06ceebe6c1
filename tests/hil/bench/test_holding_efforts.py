"""The greatest effort of a hold, from the machine file: a lever whose load has a closed form, and machines that are shipped."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from bench_machines import CARM
from falling_arm import EFFORT_Nm_A, falling_arm

from hil.bench.holding import Loads, with_holding_efforts
from hil.machine import Machine, load_machine
from virtual_bus.physics import Physics
from virtual_bus.settings import EffectSetting


def limits_of(machine: Machine) -> list[float]:
    told = with_holding_efforts(machine, Physics(machine.plant, noise=False))
    assert told.bus is not None
    return [limits.holding_effort for limits in told.bus.motions]


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
    arm = falling_arm()
    open_ = dataclasses.replace(arm, plant=dataclasses.replace(arm.plant, effects=(pushes,)), own_effects=(pushes,))
    assert open_.bus is not None
    model = Physics(open_.plant, noise=False)
    for pose in (-0.4, 0.7):
        np.testing.assert_allclose(Loads(open_, model).between(np.array([pose])), [[-5.0 / EFFORT_Nm_A, 4.0 / EFFORT_Nm_A]])
    stated = dataclasses.replace(pushes, between={})
    known = dataclasses.replace(arm, plant=dataclasses.replace(arm.plant, effects=(stated,)), own_effects=(stated,))
    assert not Loads(known, model).between(np.zeros(1)).any()
    assert limits_of(open_)[0] - limits_of(known)[0] == pytest.approx(1.25 * 5.0 / EFFORT_Nm_A), "the arm is held by negative efforts"
