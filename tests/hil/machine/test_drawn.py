"""A file may say where its effects lie on one machine or another of its kind; machines are drawn there."""

from __future__ import annotations

import numpy as np
import pytest

from hil.errors import MachineFileError
from hil.machine import Machine, load_machine, machine_from_text
from hil.machine.drawn import drawn, typical
from hil.machine.effects_file import effects_from_text, effects_text

CARM = load_machine("carm").text
LOAD = """
[[effect]]
name = "constant_load"
at = "roll"
tau0_Nm = 3.0
tau0_Nm_between = [2, 20.0]

[[effect]]
name = "coulomb_friction"
at = "roll"
Fc_Nm = 12.0
Fc_Nm_between = [0.0, 30.0]
"""


@pytest.fixture(scope="module")
def machine() -> Machine:
    return machine_from_text(CARM + LOAD)


def strengths(machine: Machine) -> tuple[float, float]:
    load, friction = machine.plant.effects
    assert machine.own_effects == machine.plant.effects
    return load.parameters["tau0"], friction.parameters["Fc"]


def test_ranges_are_read_and_written_and_change_nothing_of_the_machine_itself(machine: Machine) -> None:
    assert strengths(machine) == (3.0, 12.0)
    assert [effect.between for effect in machine.own_effects] == [{"tau0": (2.0, 20.0)}, {"Fc": (0.0, 30.0)}]
    plain = machine_from_text(CARM)
    assert effects_from_text(effects_text(machine.own_effects, machine), plain, "kept.toml") == machine.own_effects


def test_machines_of_a_set_fill_the_range_as_their_root_mean_square_says(machine: Machine) -> None:
    load, friction = np.array([strengths(drawn(machine, number, 40)) for number in range(40)]).T
    assert np.all((np.abs(load) >= 2.0) & (np.abs(load) <= 20.0))
    assert 10 < np.sum(load < 0.0) < 30, "a load pushes either way"
    assert np.all((friction >= 0.0) & (friction <= 30.0))
    stated = strengths(typical(machine))
    assert stated == pytest.approx((np.sqrt(396.0 / (2.0 * np.log(10.0))), 30.0 / np.sqrt(3.0)))
    assert np.sqrt(np.mean(load**2)) == pytest.approx(stated[0], rel=0.02)
    assert np.sqrt(np.mean(friction**2)) == pytest.approx(stated[1], rel=0.02)


def test_without_ranges_nothing_is_drawn() -> None:
    carm = load_machine("carm")
    assert drawn(carm, 1, 3).plant == carm.plant == typical(carm).plant


@pytest.mark.parametrize("wrong", ["[20.0, 2.0]", "[2.0]", "3.0", '["a", "b"]', "[-1e9, 3.0]"])
def test_a_wrong_range_is_told_in_one_line(wrong: str) -> None:
    with pytest.raises(MachineFileError, match=r"tau0_Nm_between = .*must be|effect") as told:
        machine_from_text(CARM + LOAD.replace("[2, 20.0]", wrong))
    assert "\n" not in str(told.value)
