"""The greatest effort of a hold, from the machine file: a lever whose load has a closed form, and machines that are shipped."""

from __future__ import annotations

import dataclasses
import math

import pytest
from bench_machines import CARM
from falling_arm import EFFORT_Nm_A, falling_arm

from hil.bench.holding import with_holding_efforts
from hil.machine import Machine, load_machine
from virtual_bus.physics import Physics


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
