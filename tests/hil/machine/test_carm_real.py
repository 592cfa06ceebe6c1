"""The hard sister of the C-arm: the same machine with effects that its file states, some of which scatter from run to run."""

from __future__ import annotations

import tomllib
from pathlib import Path

import numpy as np
import pytest

from hil.bench.open import open_bench
from hil.bench.options import BenchOptions
from hil.errors import MachineFileError
from hil.experiments import Scan
from hil.machine import load_machine, machine_from_text
from hil.machine.effects_file import effects_from_text, effects_text
from virtual_bus.physics import Physics

REAL, PLAIN = load_machine("carm-real"), load_machine("carm")
FRICTION = """
[[effect]]
name = "coulomb_friction"
at = "roll"
Fc_Nm = 12.0
scatter_percent = 2.0
"""


def test_it_is_the_c_arm_with_the_physics_a_real_one_has_besides() -> None:
    real, plain = (tomllib.loads(machine.text) for machine in (REAL, PLAIN))
    for table in ("gravity_m_s2", "timing", "body", "drives", "controller", "limits", "geometry", "budgets"):
        assert real[table] == plain[table]
    stated = {(effect.name, effect.at) for effect in REAL.own_effects}
    for axis in REAL.axes:
        for name in ("presliding_hysteresis", "temperature_dependent_friction", "backlash", "transmission_error", "cable_spring"):
            assert (name, axis) in stated
        assert ("encoder_eccentricity", f"link_position_{axis}") in stated
    assert {"thermal_bending", "creep", "imu_misalignment", "imu_scale_bias"} <= {name for name, _ in stated}


def test_its_friction_holds_the_arm_where_the_plain_one_begins_to_move() -> None:
    moved = []
    for machine in (PLAIN, REAL):
        physics = Physics(machine.plant, noise=False)
        physics.place(np.zeros(2))
        holding = physics.holding_effort(np.zeros(2))
        physics.hold(holding)
        physics.apply(holding + np.array([0.0, 0.5]))  # 24 Nm, where 45 Nm slide
        for _ in range(128):
            physics.advance()
        moved.append(abs(float(physics.truth()["joint_position"][REAL.plant.tree.joint_index("roll")])))
    assert moved[0] > 0.01
    assert moved[1] < 5e-4


def of_seed(text: str, seed: int) -> float:
    machine = machine_from_text(text)
    return Physics(machine.plant, seed).settings.effects[0].parameters["Fc"]


def test_what_scatters_is_drawn_from_the_seed_of_the_run() -> None:
    text = PLAIN.text + FRICTION
    drawn = np.array([of_seed(text, seed) for seed in range(60)])
    assert of_seed(text, 3) == drawn[3]
    assert abs(drawn.mean() - 12.0) < 4.0 * 0.24 / np.sqrt(60)
    assert 0.7 * 0.24 < drawn.std() < 1.4 * 0.24
    stated = Physics(machine_from_text(text).plant, seed=3, noise=False).settings.effects[0]
    assert stated.parameters["Fc"] == 12.0


def test_an_effects_file_adds_to_what_the_file_states_and_may_not_repeat_it() -> None:
    machine = machine_from_text(PLAIN.text + FRICTION)
    more = effects_from_text('[[effect]]\nname = "constant_load"\nat = "roll"\ntau0_Nm = 3.0\n', machine, "more.toml")
    both = machine.with_effects(more)
    assert [effect.name for effect in both.plant.effects] == ["coulomb_friction", "constant_load"]
    assert [effect.name for effect in both.added_effects] == ["constant_load"]
    assert effects_from_text(effects_text(machine.own_effects, machine), PLAIN, "kept.toml") == machine.own_effects
    with pytest.raises(MachineFileError, match=r"more\.toml: coulomb_friction at 'roll' is in the machine file already"):
        effects_from_text(FRICTION, machine, "more.toml")


@pytest.mark.parametrize(
    ("wrong", "says"),
    [
        ("coulomb_frictoin", "no such effect; did you mean coulomb_friction"),
        ("scatter_percent = 200.0", "scatter_percent = 200.0: must be a number from 0 to 100"),
    ],
)
def test_a_wrong_effect_of_a_machine_file_is_told_in_one_line(wrong: str, says: str, tmp_path: Path) -> None:
    path = tmp_path / "arm.toml"
    written = FRICTION.replace("coulomb_friction", wrong) if "=" not in wrong else FRICTION.replace("scatter_percent = 2.0", wrong)
    path.write_text(PLAIN.text + written)
    with pytest.raises(MachineFileError, match=says) as told:
        load_machine(path)
    assert str(path) in str(told.value)
    assert "\n" not in str(told.value)


def test_its_own_judge_believes_its_encoders(tmp_path: Path) -> None:
    """Friction, cables, play and error of the teeth set the encoders apart as far as the file allows."""
    plan = Scan("propeller", -1.5, 1.5, speed=0.5).plans(REAL)[0]
    with open_bench(REAL, BenchOptions("lockstep:", seed=3), plan.start_pose) as bench:
        timing = bench.run(plan, tmp_path / "scan.mf4")
    assert timing.judged == ()
