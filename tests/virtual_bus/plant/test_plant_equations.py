"""The generated equations of any tree are those of MuJoCo."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import replace

import mujoco
import numba
import numpy as np
import pytest
from examples import examples
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from hil.machine.mjcf import to_mjcf
from virtual_bus.effects.dispatch import compiled_effects
from virtual_bus.plant.compiled import compile_plant
from virtual_bus.settings import Body, Drive, Encoder, Imu, Joint, PlantSettings, Tree


def random_tree(seed: int, count: int) -> PlantSettings:
    """Bodies hung anywhere on those before them, on hinges, slides or welds, along coordinate axes or askew."""
    generator = np.random.default_rng(seed)
    bodies: list[Body] = []
    for number in range(count):
        askew = generator.random() < 0.5
        orientation = Rotation.random(rng=generator).as_matrix() if askew else np.eye(3)[generator.permutation(3)]
        orientation *= np.sign(np.linalg.det(orientation))
        axis = generator.normal(size=3) if askew else np.eye(3)[generator.integers(3)] * generator.choice([-1.0, 1.0])
        kind = generator.choice(["revolute", "prismatic", "weld"]) if number else generator.choice(["revolute", "prismatic"])
        joint = Joint(
            f"joint{number}", kind, axis / np.linalg.norm(axis), stiffness=generator.uniform(0, 50), damping=generator.uniform(0, 5),
            rest_position=generator.uniform(-1, 1), armature=generator.uniform(0, 1),
        )  # fmt: skip
        principal = generator.uniform(0.1, 1.0, 3)
        turn = Rotation.random(rng=generator).as_matrix() if askew else np.eye(3)
        bodies.append(
            Body(
                f"body{number}",
                "world" if number == 0 else f"body{generator.integers(number)}",
                generator.normal(size=3) * (generator.random(3) < 0.6),
                orientation,
                generator.uniform(0.1, 5.0),
                generator.normal(size=3) * (generator.random(3) < 0.6),
                turn @ np.diag(principal.sum() - principal) @ turn.T,
                None if kind == "weld" else joint,
            )
        )
    names = [body.joint.name for body in bodies if body.joint]
    imu = Imu(
        "imu", f"body{count - 1}", generator.normal(size=3), Rotation.random(rng=generator).as_matrix(), np.zeros(3), np.zeros(3), 0.0, 0.0,
        np.zeros(3), np.zeros(3), 0.0, 0.0,
    )  # fmt: skip
    return PlantSettings(
        tree=Tree(tuple(bodies), generator.normal(size=3) * 5.0),
        drives=(Drive("axis", names[-1], "A", 0.3, 7.0, 100.0, 0.0, 1.0),),
        encoders=(Encoder("link_position_axis", tuple(names), 0.0, True),),
        currents=(), imus=(imu,), thermometers=(), sample_period_s=0.004, substeps=1,
        watched_bodies=tuple(body.name for body in bodies),
    )  # fmt: skip


@pytest.fixture(scope="module")
def interpreted(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """The generated modules run as plain Python: a hundred trees are looked at, and none is worth a compilation."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("ISOCENTER_CACHE", str(tmp_path_factory.mktemp("generated")))
        patch.setattr(numba.config, "DISABLE_JIT", True)
        before = set(sys.modules)
        yield
        for name in set(sys.modules) - before:  # a plant of another test may have the same equations
            if name.startswith("isocenter_"):
                del sys.modules[name]
        compiled_effects.cache_clear()


@pytest.mark.slow
@pytest.mark.usefixtures("interpreted")
@settings(max_examples=examples(60), deadline=None, derandomize=True)
@given(seed=st.integers(0, 2**32 - 1), count=st.integers(1, 5))
def test_accelerations_imu_and_poses_of_any_tree_are_those_of_mujoco(seed: int, count: int) -> None:
    machine = random_tree(seed, count)
    reference = mujoco.MjModel.from_xml_string(to_mjcf(machine, "tree"))
    data = mujoco.MjData(reference)
    generator = np.random.default_rng(seed)
    joints = len(machine.tree.joints)
    q, v, u = generator.uniform(-2, 2, joints), generator.uniform(-3, 3, joints), generator.uniform(-5, 5, 1)
    order = [reference.joint(joint.name).qposadr[0] for joint in machine.tree.joints]  # MuJoCo lists a tree depth first
    data.qpos[order], data.qvel[order], data.ctrl[:] = q, v, u
    mujoco.mj_forward(reference, data)

    plant = compile_plant(machine)
    model = plant.model()
    inertia, bias = plant.inertia_and_bias(model, q, v)
    effort = np.zeros(joints)
    effort[-1] = 0.3 * 7.0 * u[0]
    springs = model[0].stiffness * (q - model[0].rest_position) + model[0].damping * v
    acceleration = np.linalg.solve(inertia, effort - bias - springs)

    scale = np.abs(data.qacc).max() + 1.0
    np.testing.assert_allclose(acceleration, data.qacc[order], rtol=0, atol=1e-9 * scale)
    motion = plant.imu_motion(model, q, v, acceleration)
    expected = np.concatenate([data.sensor("imu").data, data.sensor("gyro").data])
    np.testing.assert_allclose(motion, expected, rtol=0, atol=1e-8 * scale)
    others = plant.imu_motions(model, *(np.stack([0.5 * part, part]) for part in (q, v, acceleration)))
    np.testing.assert_allclose(others[1], motion, rtol=1e-12, atol=1e-12 * scale)
    for body, pose in zip(machine.tree.bodies, plant.body_poses(model, q), strict=True):
        np.testing.assert_allclose(pose[:3], data.body(body.name).xpos, rtol=0, atol=1e-10)
        np.testing.assert_allclose(pose[3:], data.body(body.name).xmat, rtol=0, atol=1e-10)
    np.testing.assert_allclose(q.sum(), data.sensor("link_position_axis").data[0], rtol=0, atol=1e-12)


@pytest.mark.usefixtures("interpreted")
def test_a_retuned_parameter_does_what_a_new_tree_with_that_number_does() -> None:
    machine = random_tree(3, 4)
    plant = compile_plant(machine)
    heavier = [replace(body, mass_kg=3.0 * body.mass_kg) if body.name == "body2" else body for body in machine.tree.bodies]
    other = compile_plant(replace(machine, tree=Tree(tuple(heavier), machine.tree.gravity_m_s2)))
    q, v = np.linspace(-1, 1, plant.joints), np.linspace(2, 1, plant.joints)
    values = plant.with_values({"body2.mass_kg": 3.0 * machine.tree.bodies[2].mass_kg})
    for got, expected in zip(plant.inertia_and_bias(plant.model(values), q, v), other.inertia_and_bias(other.model(), q, v), strict=True):
        np.testing.assert_allclose(got, expected, rtol=1e-14)
    assert plant.module is other.module, "another number is no other equation"
