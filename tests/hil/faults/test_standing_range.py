"""The range in which an axis swings that stands, by which a drive that holds is judged too: bounded by the machine file's numbers."""

from __future__ import annotations

import math

import pytest
from bench_machines import CARM
from falling_arm import falling_arm

from hil.faults.budget import standing
from hil.machine import Machine
from hil.machine.check import examine
from hil.machine.check_budgets import axis_facts
from virtual_bus.faults.condition import MOVING_SPEED
from virtual_bus.faults.machine import REST_S

POSES = 9
PLAIN = 10.0  # times over: what is to be told apart
SLOWEST_STRUCTURE_Hz = 1.0  # slower ones are swings of a load on its bearing


@pytest.mark.parametrize("machine", [CARM, falling_arm()], ids=lambda machine: machine.name)
def test_an_axis_that_nothing_holds_leaves_it_ten_times_over_in_the_time_it_must_stay(machine: Machine) -> None:
    """At every pose whose load is twice the first move's push, of which friction may take one."""
    assert machine.bus is not None
    falls = []
    for number, axis in enumerate(machine.axes):
        drive, push = machine.plant.drives[number], machine.bus.homings[number].direction_check_effort
        for result in examine(machine, POSES):
            if abs(load := result.holding[number]) > 2.0 * push:
                fall = 0.5 * (abs(load) - push) * drive.constant * drive.ratio / result.inertia[number] * REST_S**2
                falls.append(fall / standing(machine, axis))
    assert falls
    assert min(falls) > PLAIN


@pytest.mark.parametrize("axis", CARM.axes)
def test_an_axis_that_stays_in_it_is_slower_by_far_than_what_counts_as_a_motion(axis: str) -> None:
    assert standing(CARM, axis) / REST_S < MOVING_SPEED / 5.0


def test_the_swing_of_a_sound_structure_behind_its_brake_fits_into_it_and_not_by_much() -> None:
    """By the fastest deceleration of a stop, the brake's or the drive's, over the square of the slowest mode's angular frequency."""
    results = examine(CARM, POSES)
    slowest_Hz = min(each for result in results for each, _ in result.modes if each > SLOWEST_STRUCTURE_Hz)
    every = [facts for number in range(len(CARM.axes)) for facts, _ in axis_facts(CARM, number, results)]
    swing = max(max(facts.brakes, facts.quick_stop) for facts in every) / (2.0 * math.pi * slowest_Hz) ** 2
    for axis in CARM.axes:
        assert swing < standing(CARM, axis) < 1.5 * swing
