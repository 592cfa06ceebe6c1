"""The flexible chain of a machine file against MuJoCo's statics with the same springs, a closed form, and its own differences."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from flexible_machine import Statics, soft_machine

from hil.calibration.kinematic.flexible import beam_of
from hil.calibration.kinematic.nominal_chain import nominal_chain
from hil.errors import UnusableInputError
from hil.imaging import ConeBeam
from hil.imaging.nominal import nominal_beam
from hil.machine import Machine, load_machine

POSITIONS = np.random.default_rng(1).uniform([-2.1, -1.6], [2.1, 1.6], (12, 2))


def in_mujoco(machine: Machine, held: tuple[str, ...]) -> ConeBeam:
    statics = Statics(machine, held)
    frames = [statics(row) for row in POSITIONS]
    panel, tube = (np.array([pair[k] for pair in frames]) for k in (0, 1))
    return ConeBeam.from_frames(tube[:, :3, 3], panel[:, :3, 3], panel[:, :3, :3])


def test_without_gravity_it_is_the_nominal_geometry() -> None:
    for machine in (load_machine("carm"), soft_machine()):
        chain = nominal_chain(machine)
        rigid = beam_of(replace(chain, compliance=0.0 * chain.compliance), POSITIONS)
        np.testing.assert_allclose(rigid.deviation_from(nominal_beam(machine, POSITIONS)), 0.0, atol=1e-12)


def test_what_gives_way_gives_way_as_in_mujoco() -> None:
    machine = soft_machine()
    chain = nominal_chain(machine)
    assert [joint.name for joint in chain.elastic] == ["detector_mount", "arm_yaw", "mount_sway", "tube_mount"]
    error = beam_of(chain, POSITIONS).deviation_from(in_mujoco(machine, held=("propeller_gear", "roll_gear")))
    sag = np.abs(beam_of(chain, POSITIONS).deviation_from(nominal_beam(machine, POSITIONS))).max(axis=0)
    assert (sag > 5e-5).all()
    assert np.median(sag) > 1e-3
    np.testing.assert_allclose(error, 0.0, atol=1e-8)


def test_gears_that_no_link_encoder_sees_are_in_the_chain() -> None:
    machine = soft_machine()
    machine = replace(machine, plant=replace(machine.plant, encoders=tuple(e for e in machine.plant.encoders if len(e.joints) == 1)))
    chain = nominal_chain(machine)
    assert [joint.name for joint in chain.elastic][:3] == ["detector_mount", "roll_gear", "propeller_gear"]
    np.testing.assert_allclose(beam_of(chain, POSITIONS).deviation_from(in_mujoco(machine, held=())), 0.0, atol=1e-7)


def test_one_sagging_mount_is_its_weight_s_arm_over_its_stiffness() -> None:
    machine = load_machine("carm")
    chain = nominal_chain(machine)
    bent, effort = chain.deflections(np.zeros((1, 2)))
    # 40 kg at (0.05, 0.02) beside the axis (0.4, 0.9165): a x r . z = 0.4 * 0.02 - 0.9165 * 0.05, times -m g
    by_hand = 40.0 * 9.81 * (0.916515138991168 * 0.05 - 0.4 * 0.02)
    assert effort[0, 0] == pytest.approx(by_hand, rel=0.02)  # the mount's own sag shifts the mass by 0.1 mm of 37
    assert bent[0, 0] == pytest.approx(by_hand / 1.015e4, rel=0.02)


def test_derivatives_are_those_of_the_poses() -> None:
    chain = nominal_chain(soft_machine())
    jacobian = chain.jacobian(POSITIONS)
    jacobian[:, 6:] *= -1.0
    for k, name in enumerate(chain.names):
        step = 1e-6 if k < len(chain.names) - 4 else 1e-3 * chain.values[k]
        there, back = chain.values, chain.values
        there[k] += step
        back[k] -= step
        ahead, behind = beam_of(chain.with_values(there), POSITIONS), beam_of(chain.with_values(back), POSITIONS)
        slope = ahead.deviation_from(behind) / (2.0 * step)
        np.testing.assert_allclose(jacobian[:, :, k], slope, atol=1e-7 + 1e-4 * np.abs(slope).max(), err_msg=name)


def test_what_the_model_cannot_hold_is_named() -> None:
    machine = load_machine("carm")
    bodies = list(machine.plant.tree.bodies)
    for axis in ("roll", "propeller"):
        k = next(k for k, each in enumerate(bodies) if each.name == f"{axis}_rotor")
        slide = replace(bodies[k], joint=replace(bodies[k].joint, kind="prismatic"))
        tree = replace(machine.plant.tree, bodies=(*bodies[:k], slide, *bodies[k + 1 :]))
        with pytest.raises(UnusableInputError, match=f"carm: {axis} slides"):
            nominal_chain(replace(machine, plant=replace(machine.plant, tree=tree)))
