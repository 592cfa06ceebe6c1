"""What the machine file makes of a motion obeys statics, mass matrix and kinematics; a load that it does not know is told."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from bench_machines import CARM

from drivers.judging.drive import UNSURE
from drivers.judging.motion_means import Means
from hil.bench.expected_motion import expectation_of
from hil.faults.check import run_trial
from hil.faults.motion import motion_of
from hil.faults.trials import trials
from virtual_bus.physics import Physics
from virtual_bus.plant.linearise import inertia_matrix
from virtual_bus.settings import EffectSetting

MODEL = Physics(CARM.plant, noise=False)
EXPECTS = expectation_of(CARM, MODEL)
ROLL = CARM.axis_index("roll")
SCALE = np.array([drive.constant * drive.ratio for drive in CARM.plant.drives])
GRAVITY = float(np.linalg.norm(CARM.plant.tree.gravity_m_s2))


def moving(pose: list[float], speed: float = 0.0, acceleration: float = 0.0) -> Means:
    """Roll as the arguments say, its link with its motor side; the drives give what holds the pose."""
    still = np.zeros((2, 2))
    speeds, accelerations = still.copy(), still.copy()
    speeds[:, ROLL], accelerations[:, ROLL] = speed, acceleration
    return Means(np.vstack((pose, pose, speeds, accelerations, np.zeros(2), MODEL.holding_effort(np.array(pose)))))


@pytest.mark.parametrize("pose", [[0.0, 0.0], [0.5, -0.8], [-1.2, 1.0]])
def test_at_rest_the_drives_hold_the_load_and_the_imu_shows_gravity(pose: list[float]) -> None:
    expected = EXPECTS(moving(pose))
    np.testing.assert_allclose(expected.effort, MODEL.holding_effort(np.array(pose)), atol=0.02)  # the structure bends, which is left out
    assert np.linalg.norm(expected.imu[:3]) == pytest.approx(GRAVITY, rel=1e-9)
    np.testing.assert_allclose(expected.imu[3:], 0.0, atol=1e-12)


def test_a_load_that_is_open_is_allowed_as_far_as_its_range_reaches_on_either_side() -> None:
    load = EffectSetting("constant_load", "roll", {"tau0": 1.0})
    known, open_ = (
        dataclasses.replace(CARM, plant=dataclasses.replace(CARM.plant, effects=(each,)), own_effects=(each,))
        for each in (load, dataclasses.replace(load, between={"tau0": (-2.0, 20.0)}))
    )
    at = moving([0.5, -0.8])
    stated, expected = (expectation_of(each, Physics(each.plant, noise=False))(at) for each in (known, open_))
    beside, more = expected.effort[ROLL] - stated.effort[ROLL], UNSURE * (expected.unsure[ROLL] - stated.unsure[ROLL])
    assert np.array([beside - more, beside + more]) * SCALE[ROLL] == pytest.approx([-19.0, 3.0])


def test_an_acceleration_takes_inertia_and_a_speed_is_what_the_gyroscope_turns_by() -> None:
    joint = [each.name for each in CARM.plant.tree.joints].index(CARM.plant.drives[ROLL].joint)
    inertia = inertia_matrix(MODEL.plant, MODEL.model, np.zeros(MODEL.plant.joints))[joint, joint]
    more = EXPECTS(moving([0.0, 0.0], acceleration=2.0)).effort[ROLL] - EXPECTS(moving([0.0, 0.0])).effort[ROLL]
    assert more * SCALE[ROLL] == pytest.approx(2.0 * inertia, rel=1e-9)
    assert np.linalg.norm(EXPECTS(moving([0.3, 0.7], speed=0.4)).imu[3:]) == pytest.approx(0.4, rel=1e-9)


def test_nothing_is_compared_where_no_tolerance_is_stated() -> None:
    judging = CARM.judging
    assert judging.imu is not None
    imu = dataclasses.replace(judging.imu, force_tolerance=np.inf, turn_tolerance=np.inf)
    drives = tuple(dataclasses.replace(each, load_tolerance=np.inf) for each in judging.drives)
    bare = dataclasses.replace(CARM, judging=dataclasses.replace(judging, imu=imu, drives=drives))
    assert expectation_of(bare, MODEL) is None


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "verdict", "says"),
    [
        ("brake_drags/roll/sweep", "noted", "drive_roll: its mean effort over 0.5 s is -"),
        ("torque_offset/roll_drive/sweep", "stopped", "its drive measures "),
        ("io_inputs_frozen/io/sweep", "stopped", "the I/O has given no valid state for 0.50 s"),
    ],
)
def test_what_the_file_does_not_know_is_told_on_the_emulated_arm(name: str, verdict: str, says: str) -> None:
    (row,) = trials(CARM, "roll", [name])
    outcome = run_trial(CARM, "roll", row, motion_of(CARM, "roll"))
    assert outcome.verdict == verdict
    assert says in outcome.said
