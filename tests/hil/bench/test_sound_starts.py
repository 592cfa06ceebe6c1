"""Machines drawn within the ranges of their file's effects start; with a fault they are refused, with no more motion than before."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from drivers.errors import MotionRefusedError
from hil.bench.bench import Bench
from hil.bench.holding import Loads
from hil.bench.open import open_bench
from hil.bench.options import BenchOptions
from hil.experiments import Static
from hil.machine import Machine, load_machine
from hil.machine.drawn import drawn
from virtual_bus.physics import Physics

REAL = load_machine("carm-real")
POSE = np.array([0.466, 1.137])
STIFF = drawn(REAL, 29, 200)
"""Its cables pull roll by 1.2 A more than the file's there, of which friction holds 0.8 A."""
EFFORT_Nm_A = 0.095 * 500.0


class Seen:
    """How far roll's motor side went, as the plant knows it [rad]."""

    def __init__(self) -> None:
        self.way: list[float] = []

    @property
    def travel(self) -> float:
        return float(np.ptp(self.way))


@contextmanager
def standing(emulated: Machine, seen: Seen) -> Iterator[Bench]:
    with open_bench(REAL, BenchOptions("lockstep:", seed=43, emulated=emulated), POSE) as bench:
        machine = bench.wiring.link.network.can_bus.machine
        roll = REAL.plant.tree.joint_index("roll")
        machine._witness = lambda time_s: seen.way.append(float(machine.physics.truth()["joint_position"][roll]))
        yield bench


def test_cables_that_pull_more_than_friction_holds_are_found_and_held(tmp_path: Path) -> None:
    seen = Seen()
    with standing(STIFF, seen) as bench:
        found = bench.commission()
        load = bench.wiring.link.found_load
        timing = bench.run(Static(0.5, dict(zip(REAL.axes, POSE.tolist(), strict=True))).plans(REAL)[0], tmp_path / "still.mf4")
    model = Physics(REAL.plant, noise=False)
    pulls = Physics(STIFF.plant, noise=False).holding_effort(POSE) - model.holding_effort(POSE)
    least, most = Loads(REAL, model).between(POSE).T
    assert (least <= pulls).all()
    assert (pulls <= most).all()
    assert abs(pulls[1] - load[1]) < 45.0 / EFFORT_Nm_A < pulls[1], "what is left is within the friction, what there was is not"
    assert any("roll: moved +" in line and "what holds it is +" in line for line in found)
    assert timing.judged == (), "an effort that the file allows is no finding"
    assert seen.travel < 3e-3  # 5.4e-3 where it was refused


def test_the_same_machine_with_a_reversed_motor_is_refused_with_no_more_motion_than_by_the_file_alone() -> None:
    drives = list(STIFF.plant.drives)
    drives[1] = dataclasses.replace(drives[1], constant=-drives[1].constant)
    seen = Seen()
    reversed_ = dataclasses.replace(STIFF, plant=dataclasses.replace(STIFF.plant, drives=tuple(drives)))
    words = r"roll: moves by -.*; .* the machine file's sign, or the load is not the 62% .* by -6% to \+46%"
    with standing(reversed_, seen) as bench, pytest.raises(MotionRefusedError, match=words):
        bench.commission()
    assert seen.travel < 15e-3, "what it was when the first motion was refused at once"


@pytest.mark.parametrize("load_Nm", [-150.0, 250.0])
def test_a_load_beyond_the_files_ranges_is_refused(load_Nm: float) -> None:
    number = next(k for k, each in enumerate(REAL.own_effects) if each.name == "cable_spring" and each.at == "roll")
    cable = REAL.own_effects[number]
    pulling = dataclasses.replace(cable, parameters={"kc": abs(load_Nm), "kc3": 0.0, "theta0": float(POSE[1]) - np.sign(load_Nm)})
    own = tuple(pulling if k == number else each for k, each in enumerate(REAL.own_effects))
    emulated = dataclasses.replace(REAL, plant=dataclasses.replace(REAL.plant, effects=own), own_effects=own)
    seen = Seen()
    with (
        standing(emulated, seen) as bench,
        pytest.raises(MotionRefusedError, match=r"roll: moves by .*the load is not the 62% of the rated"),
    ):
        bench.commission()
    assert seen.travel < 15e-3
