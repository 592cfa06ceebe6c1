"""A second IMU, at the source: the focal spot that is published moves as the modes move its body."""

from __future__ import annotations

import sys

import numpy as np
from places import BENCHMARKS

from controllers.bound import bound
from controllers.observers.consistency import CorrectionMonitor, InnovationMonitor
from controllers.observers.extended_kalman import next_and_read
from controllers.observers.linear_part import prepare
from controllers.observers.publish import publish
from hil.machine import Machine, load_machine, machine_from_text
from hil.observing.geometry import observed_chain
from hil.observing.over_poses import axis_grid
from hil.observing.own_model import Emulated
from hil.observing.true_scan import nine

sys.path.insert(0, str(BENCHMARKS))
from observer_variances import OWN_MODES, own_design

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
    publish(bound((observer.constants, observer.scheduled, observer.memory, *recent)), np.zeros((1, 3)), design.isocenter_m, estimate)
    first = [name for name, _ in observer.channels].index("estimate_source_x")

    poses = emulated.plant.body_poses(emulated.model, bent)
    detector, tube = (poses[body] for body, _, _ in emulated.bodies)
    rotation = detector[3:].reshape(1, 3, 3)
    true = nine(detector[None, :3], rotation, tube[None, :3], np.zeros(3))[0]
    np.testing.assert_allclose(estimate[first : first + 9], true, rtol=0, atol=5e-8)

    follows_the_links = true[:3].copy()
    links = bent.copy()
    links[[0, 1, 6]] = 0.0  # what no encoder sees
    rigid = emulated.plant.body_poses(emulated.model, links)[emulated.bodies[1][0]][:3]
    follows_the_links[:] = rotation[0].T @ (rigid - detector[:3])
    assert np.abs(follows_the_links - true[:3]).max() > 1e-5  # without the IMU it would be wrong by so much


def test_a_gyro_and_the_published_velocity_know_that_a_bend_before_an_axis_turns_with_it() -> None:
    """The propeller's gear wound up by 1 mrad, and roll turning behind it: the detector's rate is roll's, whatever the bend."""
    machine = weightless()
    emulated, pose, speed = Emulated(machine), np.array([1.2, -0.5]), 0.5
    bent = np.zeros(len(emulated.joints))
    bent[emulated.joints.index("propeller_gear")] = 1e-3

    def coordinates(roll: float) -> np.ndarray:
        at = np.array([pose[0], roll])
        bent[emulated.driven] = at
        _, _, _, shapes = emulated.modes_at(at, OWN_MODES, emulated.modes_at(pose, OWN_MODES)[3])
        return np.linalg.solve(np.column_stack([emulated.rigid, shapes]), bent)

    step = 1e-4
    rates = speed * (coordinates(pose[1] + step) - coordinates(pose[1] - step)) / (2.0 * step)
    now = coordinates(pose[1])
    design = own_design(machine)
    observer = design.observer("ekf")
    motor = emulated.modes_at(pose, OWN_MODES)[3][emulated.driven]
    of_model = observer.model.at(pose)[: OWN_MODES * observer.model.mode_stride].reshape(OWN_MODES, -1)[:, 2:4]
    like = np.sign(np.sum(of_model * motor.T, axis=1))  # which way a mode counts
    read, published = np.zeros((2, 16)), np.zeros((2, 6))
    names = [name for name, _ in observer.channels]
    for which, sign in enumerate((1.0, -1.0)):
        x = observer.memory.x
        x[:] = 0.0
        x[:2], x[2:4] = now[:2], sign * rates[:2]
        x[4 : 4 + OWN_MODES], x[4 + OWN_MODES : 4 + 2 * OWN_MODES] = like * now[2:], sign * like * rates[2:]
        prepare(observer.constants, x, observer.scheduled)
        next_and_read(observer.constants, observer.scheduled, x, np.zeros(2), np.zeros(len(x)), read[which])
        estimate = np.zeros(len(names))
        recent = InnovationMonitor().recent, CorrectionMonitor().recent
        publish(bound((observer.constants, observer.scheduled, observer.memory, *recent)), np.zeros((1, 3)), design.isocenter_m, estimate)
        first = names.index("estimate_detector_vx")
        published[which] = estimate[first : first + 6]
    q, v = bent.copy(), np.zeros(len(bent))
    q[emulated.driven], v[emulated.joints.index("roll")] = pose, speed
    true = emulated.plant.imu_motion(emulated.model, q, v, 0.0 * v)
    odd = 0.5 * (read[0] - read[1])
    for sensor in range(2):
        rows = slice(6 * sensor + 3, 6 * sensor + 6)
        np.testing.assert_allclose(odd[4:][rows], true[rows], rtol=0, atol=2e-5)  # 5e-4 rad/s without

    def displaced(roll: float) -> np.ndarray:
        axes, here = np.zeros(len(bent)), bent.copy()
        axes[emulated.driven] = here[emulated.driven] = pose[0], roll
        (p, R), (there, S) = (emulated.body_at(each, 0) for each in (axes, here))
        turn = R.T @ S
        return np.concatenate(
            (R.T @ (there - p), 0.5 * np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]))
        )

    moves = speed * (displaced(pose[1] + step) - displaced(pose[1] - step)) / (2.0 * step)
    assert np.abs(moves[3:]).max() > 4e-4
    np.testing.assert_allclose(0.5 * (published[0] - published[1]), moves, rtol=0, atol=2e-5)
