"""The linear loop along a motion that turns the IMU: against free runs, and the poses that stand for a motion."""

from __future__ import annotations

import numpy as np
import pytest
from places import CONCEALED_MACHINES

from hil.diagnosis.recorded.align import aligned
from hil.diagnosis.residuals.mismatch import mismatch
from hil.diagnosis.result import EffectAt
from hil.diagnosis.starting import through_the_loop
from hil.diagnosis.starting.candidates import setting_of
from hil.diagnosis.starting.through_the_loop import MOST_POSES, REACH, ThroughTheLoop, from_rest, poses_along
from hil.diagnosis.tuning.free_run import TRAIN, FreeRuns, Trial
from hil.diagnosis.tuning.retune import retune
from hil.machine import load_machine
from hil.recording import Channel, Recording, recording_metadata
from hil.simulation import simulate
from virtual_bus.effects.places import joint_at

PAN_TILT = load_machine(CONCEALED_MACHINES / "pan_tilt.toml")
ROWS = 1600
WAVE_Hz = 5.2


@pytest.fixture(scope="module")
def head():
    """Three repeats: pan and tilt turn by 2.4 and 1.6 rad."""
    time_s = np.arange(ROWS) / PAN_TILT.sample_rate_Hz
    begin = np.minimum(time_s, 1.0) ** 2
    ways = {"pan": 1.2 * np.sin(2.0 * np.pi * 0.3 * time_s), "tilt": 0.8 * np.sin(2.0 * np.pi * 0.45 * time_s + 1.0)}
    inputs = {f"reference_{axis}": Channel("rad", begin * way) for axis, way in ways.items()}
    inputs |= {f"excitation_{axis}": Channel("A", np.zeros(ROWS)) for axis in ways}
    channels = {"time": Channel("s", time_s), **inputs}
    answer = simulate(PAN_TILT, Recording(channels, recording_metadata(PAN_TILT))).channels
    random = np.random.default_rng(6)

    def repeat() -> Recording:
        measured = {name: own for name, own in answer.items() if name not in channels and not name.startswith(("command_", "feedforward_"))}
        noise = {name: 1e-2 if name.startswith(("imu", "current")) else 1e-3 if name.startswith("gyro") else 1e-5 for name in measured}
        noisy = {n: Channel(own.unit, own.values + noise[n] * random.standard_normal(ROWS)) for n, own in measured.items()}
        return Recording(channels | noisy, recording_metadata(PAN_TILT))

    found = mismatch(PAN_TILT, aligned(PAN_TILT, {f"repeat {k}": repeat() for k in range(3)}))
    with FreeRuns({TRAIN: found}, found.noise) as runs:
        yield runs, retune(runs)


def likeness(head, axis: str) -> float:
    """Cosine of what a vibrating floor does to an axis by the loop and by the free run."""
    runs, tuning = head
    plant = PAN_TILT.plant
    wave = setting_of(EffectAt("base_motion", axis), np.array([0.01, WAVE_Hz, 0.4]))
    shown = runs.run_one(Trial(tuning.values, (wave,))) - tuning.predicted
    time_s = runs.sets[TRAIN].groups[0].time_s
    effort = from_rest(0.01 * np.sin(2.0 * np.pi * WAVE_Hz * (time_s - time_s[0]) + 0.4))
    joint = [joint.name for joint in plant.tree.joints].index(joint_at(axis, plant))
    (answer,) = ThroughTheLoop(runs, TRAIN, tuning).responses([[(joint, effort)]])
    return float(answer @ shown / np.sqrt((answer @ answer) * (shown @ shown)))


@pytest.mark.nightly
@pytest.mark.parametrize("axis", ["pan", "tilt"])
def test_the_loop_answers_to_an_effort_as_the_free_run_does_along_a_motion_that_turns_the_imu(head, axis):
    assert likeness(head, axis) > 0.97


@pytest.mark.nightly
def test_the_loop_at_the_mean_pose_alone_does_not(head, monkeypatch):
    monkeypatch.setattr(through_the_loop, "poses_along", lambda position, turns: (position.mean(axis=0)[None], np.ones((1, len(position)))))
    assert likeness(head, "pan") < 0.95


@pytest.mark.nightly
def test_efforts_behind_a_record_have_its_products_with_their_responses_along_a_motion(head):
    runs, tuning = head
    loop, random = ThroughTheLoop(runs, TRAIN, tuning), np.random.default_rng(7)
    joints = range(len(PAN_TILT.plant.tree.joints) + len(PAN_TILT.axes))
    efforts = [[(joint, np.cumsum(random.standard_normal(len(group.time_s)))) for joint in joints] for group in runs.sets[TRAIN].groups]
    responses, record = loop.responses(efforts), random.standard_normal(len(tuning.predicted))
    behind = loop.efforts_behind(record)
    products = [sum(own[k][1] @ back[:, joint] for own, back in zip(efforts, behind, strict=True)) for k, joint in enumerate(joints)]
    assert products == pytest.approx(responses @ record, rel=1e-6, abs=1e-6 * np.linalg.norm(responses, axis=1).max())


WAY = np.column_stack([np.sin(np.linspace(0.0, 9.0, 500)), 3.0 * np.linspace(-1.0, 1.0, 500)])


def test_poses_share_every_time_and_each_stands_for_itself():
    poses, near = poses_along(WAY, np.array([True, False]))
    assert near.shape == (len(poses), len(WAY)) and 1 < len(poses) <= MOST_POSES
    assert near.sum(axis=0) == pytest.approx(1.0)
    for pose, share in zip(poses, near, strict=True):
        assert share[np.argmin(np.linalg.norm(WAY - pose, axis=1))] > 0.7


def test_no_turn_is_farther_from_all_poses_than_one_loop_holds():
    poses, _ = poses_along(WAY, np.array([True, False]))
    assert np.abs(WAY[:, :1] - poses[:, 0]).min(axis=1).max() <= REACH


@pytest.mark.parametrize(("way", "turns"), [(0.3 * WAY[:, :1], True), (WAY[:, 1:], False)], ids=["a small turn", "a slide"])
def test_a_small_turn_and_a_slide_have_one_pose_the_mean(way, turns):
    poses, near = poses_along(way, np.array([turns]))
    assert poses == pytest.approx(way.mean(axis=0)[None])
    assert np.all(near == 1.0)


def test_a_turn_on_is_the_same_pose():
    turning = np.linspace(0.0, 20.0 * np.pi, 1001)[:, None]
    _, near = poses_along(turning, np.array([True]))
    assert near.shape[0] == MOST_POSES
    assert near[:, 100:] == pytest.approx(near[:, :-100], abs=1e-9)
