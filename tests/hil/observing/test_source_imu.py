"""A second IMU, at the source: the focal spot that is published moves as the modes move its body."""

from __future__ import annotations

import sys

import numpy as np
from places import BENCHMARKS

from controllers.observers.consistency import CorrectionMonitor, InnovationMonitor
from controllers.observers.linear_part import prepare
from controllers.observers.publish import publish
from hil.machine import Machine, load_machine, machine_from_text
from hil.observing.geometry import observed_chain
from hil.observing.observer_design import axis_grid

sys.path.insert(0, str(BENCHMARKS))
from observer_truth import Emulated
from observer_variances import OWN_MODES, nine, own_design

BENT_rad = np.array([3e-5, 2e-5, 0.0, 4e-5, 0.0, -3e-5, 5e-5])  # mount, arm, propeller, its gear, roll, its gear, detector


def weightless() -> Machine:
    text = load_machine("carm-real").text.split("# ---- what makes it hard")[0]
    return machine_from_text(text.replace("gravity_m_s2 = [0.0, 0.0, -9.81]", "gravity_m_s2 = [0.0, 0.0, 0.0]"))


def test_the_observer_looks_at_both_imus() -> None:
    machine = load_machine("carm-real")
    _, sensors, source, _ = observed_chain(machine)
    assert [sensor.channels[0] for sensor in sensors] == ["imu_x", "imu_source_x"]
    np.testing.assert_allclose(sensors[1].body_end_m, source)


def test_focal_spot_and_isocentre_are_those_of_the_bent_machine() -> None:
    machine = weightless()
    pose = np.array([axis_grid(machine, axis, 1)[0] for axis in range(2)])
    emulated = Emulated(machine)
    bent = BENT_rad.copy()
    bent[emulated.driven] = pose
    _, _, _, shapes = emulated.modes_at(pose, OWN_MODES)
    coordinates = np.linalg.solve(np.column_stack([emulated.rigid, shapes]), bent)  # axes and modes: as many as joints

    design = own_design(machine, counts=(1, 1))
    observer = design.observer("ekf")
    x = observer.memory.x
    x[:2], x[4 : 4 + OWN_MODES] = coordinates[:2], coordinates[2:]
    prepare(observer.constants, x, observer.scheduled)
    estimate = np.zeros(len(observer.channels))
    recent = InnovationMonitor().recent, CorrectionMonitor().recent
    publish(observer.constants, observer.scheduled.values, observer.memory, *recent, np.zeros((1, 3)), design.isocenter_m, estimate)
    first = [name for name, _ in observer.channels].index("estimate_source_x")

    poses = emulated.plant.body_poses(emulated.model, bent)
    detector, tube = (poses[body] for body in emulated.sensed)
    rotation = detector[3:].reshape(1, 3, 3)
    true = nine(detector[None, :3], rotation, tube[None, :3], np.zeros(3))[0]
    np.testing.assert_allclose(estimate[first : first + 9], true, rtol=0, atol=5e-8)

    follows_the_links = true[:3].copy()
    links = bent.copy()
    links[[0, 1, 6]] = 0.0  # what no encoder sees
    rigid = emulated.plant.body_poses(emulated.model, links)[emulated.sensed[1]][:3]
    follows_the_links[:] = rotation[0].T @ (rigid - detector[:3])
    assert np.abs(follows_the_links - true[:3]).max() > 1e-5  # without the IMU it would be wrong by so much
