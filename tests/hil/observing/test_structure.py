"""Springs and what turning couples are found from the modes of all poses together: against the emulated C-arm's numbers and equations."""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np
import pytest
from places import BENCHMARKS
from scipy.spatial.transform import Rotation

from controllers.models.modal import ModalModel, basis_values
from hil.errors import BadAnswerError
from hil.machine import Machine, load_machine
from hil.observing.gravity_at_rest import Standing, with_gravity, with_gravity_at_places
from hil.observing.last_mode import with_last_mode
from hil.observing.noise import effort_gain
from hil.observing.over_poses import axis_grid
from hil.observing.own_model import Emulated, own_model
from hil.observing.sag import with_sag
from hil.observing.structure import Structure, found_structure, with_coupling, with_inertia, with_places
from virtual_bus.physics import Physics

sys.path.insert(0, str(BENCHMARKS))

COUNTS = (5, 11)
GRAVITY_POSES = [np.array([propeller, roll]) for propeller in (-1.5, -0.7, 0.0, 0.7, 1.5) for roll in (-1.0, 0.0, 1.0)]


@pytest.fixture(scope="module")
def machine() -> Machine:
    return load_machine("carm")


@pytest.fixture(scope="module")
def exact(machine: Machine) -> ModalModel:
    """Modes and shapes of the emulator's equations, which the springs stand in."""
    return own_model(machine, 4, COUNTS, ("propeller_gear", "roll_gear", "detector_mount", "mount_sway", "arm_yaw"))


@pytest.fixture(scope="module")
def poses(machine: Machine) -> list[np.ndarray]:
    return [np.array([p, r]) for p in axis_grid(machine, 0, COUNTS[0]) for r in axis_grid(machine, 1, COUNTS[1])]


@pytest.fixture(scope="module")
def structure(machine: Machine, exact: ModalModel, poses: list[np.ndarray]) -> Structure:
    gain = effort_gain(machine)
    _, mount = with_sag(exact, poses, GRAVITY_POSES, gain)
    found = found_structure(exact, poses, gain, mount)
    assert found is not None
    return found


def at(table: np.ndarray, model: ModalModel, pose: np.ndarray) -> np.ndarray:
    basis = np.zeros(table.shape[-1])
    basis_values(np.array(model.harmonics, dtype=np.int64), pose, basis)
    return table @ basis


def test_springs_and_the_mounts_axis_are_the_machines(machine: Machine, structure: Structure) -> None:
    joints = {joint.name: joint for joint in machine.plant.tree.joints}
    names = ("propeller_gear", "roll_gear", "detector_mount", "mount_sway", "arm_yaw")
    assert structure.springs == pytest.approx([joints[name].stiffness for name in names], rel=0.06)
    assert structure.springs[:3] == pytest.approx([joints[name].stiffness for name in names[:3]], rel=0.01)
    assert structure.mount.lever == pytest.approx(1.5, abs=0.08)  # the machine file: the sway's axis above the propeller's


def test_deviations_of_springs_are_those_of_the_fit_without_some_poses_each_time(
    machine: Machine, exact: ModalModel, poses: list[np.ndarray], structure: Structure
) -> None:
    """Delete-a-group jackknife, eleven groups of five poses."""
    order, found = np.random.default_rng(0).permutation(len(poses)), []
    for group in np.split(order, 11):
        fitted = found_structure(exact, [poses[i] for i in np.setdiff1d(order, group)], effort_gain(machine), structure.mount)
        assert fitted is not None
        found.append([*fitted.springs, fitted.mount.lever])
    jackknife = np.sqrt(10.0) * np.std(found, axis=0)
    ratio = np.append(structure.deviations, structure.lever_deviation) / jackknife
    assert (ratio > 0.5).all(), ratio
    assert (ratio < 2.0).all(), ratio


def test_modal_masses_are_found_also_where_a_drive_hardly_moves(structure: Structure) -> None:
    assert structure.inverse_masses == pytest.approx(1.0, rel=0.05)  # the exact model's modes have unit mass


def test_disturbances_at_the_mount_push_the_modes_as_its_joints_do(exact: ModalModel, structure: Structure) -> None:
    placed = with_places(exact, structure)
    for pose in (np.array([0.4, 0.5]), np.array([-1.1, -0.9])):
        found, true = (at(model.directions, model, pose)[2:, 5] for model in (placed, exact))
        assert found @ true / (np.linalg.norm(found) * np.linalg.norm(true)) > 0.99
        assert np.linalg.norm(found) == pytest.approx(np.linalg.norm(true), rel=0.1)


def test_what_turning_couples_is_that_of_the_equations_of_motion(machine: Machine, exact: ModalModel, structure: Structure) -> None:
    gain = effort_gain(machine)
    alone = replace(exact, coupling=None, turning=None)
    coupled = with_coupling(alone, structure, gain)
    wanted, found, wanted_alone, found_alone = [], [], [], []
    for pose in structure.poses[12:43]:
        wanted.append(at(exact.coupling, exact, pose))
        found.append(at(coupled.coupling, coupled, pose))
        wanted_alone.append(at(exact.turning, exact, pose)[:2])
        found_alone.append(at(coupled.turning, coupled, pose)[:2])
    assert np.linalg.norm(np.subtract(found, wanted)) < 0.25 * np.linalg.norm(wanted)
    assert np.linalg.norm(np.subtract(found_alone, wanted_alone)) < 0.02 * np.linalg.norm(wanted_alone)


def detector_by(model: ModalModel, pose: np.ndarray) -> np.ndarray:
    """(places behind the drives, 3) how far a unit at each shifts the detector, slowly."""
    assert model.directions is not None
    n, modes, stride = len(model.axes), model.modes, model.mode_stride
    shapes = model.at(pose)[: modes * stride].reshape(modes, stride)[:, 2 + 2 * n : 5 + 2 * n]
    return at(model.directions, model, pose)[n:, n:].T @ shapes


def test_the_mode_that_no_line_excited_is_what_the_springs_leave_for_it(machine: Machine, exact: ModalModel, structure: Structure) -> None:
    joints = ("propeller_gear", "roll_gear", "detector_mount", "mount_sway", "arm_yaw")
    true = own_model(machine, 5, COUNTS, joints)
    placed = with_coupling(with_places(exact, structure), structure, effort_gain(machine))
    whole, note = with_last_mode(placed, structure, 40.0)
    assert whole.modes == 5
    assert note.startswith("mode 5, above the lines")
    assert "72 Hz" in note
    wrong = {4: 0.0, 5: 0.0}
    for pose in (np.array([0.3, -0.8]), np.array([-1.2, 0.5]), np.array([0.9, 1.2])):
        wanted = detector_by(true, pose)
        wanted *= np.sign(np.sum(wanted * detector_by(placed, pose), axis=1))[:, None]  # which way a turn counts
        for model in (placed, whole):
            wrong[model.modes] += float(np.linalg.norm(detector_by(model, pose)[[0, 1, 4]] - wanted[[0, 1, 4]]) ** 2)
    assert wrong[5] < 0.25**2 * wrong[4]  # the mount's springs are told to 6 %
    assert with_last_mode(whole, structure, 40.0) == (whole, "")


def test_the_last_mode_moves_a_second_sensor_on_the_detector_likewise_and_is_left_out_where_another_body_has_one(
    machine: Machine, exact: ModalModel, structure: Structure
) -> None:
    placed, n, modes = with_places(exact, structure), 2, exact.modes
    pose, twist = np.array([0.3, -0.8]), slice(2 + 2 * n, 8 + 2 * n)
    alone, _ = with_last_mode(placed, structure, 40.0)
    wanted = alone.at(pose)[modes * alone.mode_stride :][twist]

    shapes = placed.coefficients[: modes * placed.mode_stride].reshape(modes, placed.mode_stride, -1)
    rows = np.concatenate((shapes[:, : twist.stop], shapes[:, twist.start :]), axis=1).reshape(-1, shapes.shape[2])
    rows = np.vstack((rows, placed.coefficients[modes * placed.mode_stride :]))
    on_detector = replace(placed.sensors[0], channels=tuple(f"second_{name}" for name in placed.sensors[0].channels))
    elsewhere = replace(on_detector, body_end_m=np.array([0.0, 0.0, 1.0]))
    two, other = (replace(placed, sensors=(placed.sensors[0], second), coefficients=rows) for second in (on_detector, elsewhere))
    model, _ = with_last_mode(two, structure, 40.0)
    shape = model.at(pose)[modes * model.mode_stride :][twist.start :][:12].reshape(2, 6)
    assert np.abs(wanted).max() > 0.0
    assert shape == pytest.approx(np.tile(wanted, (2, 1)), rel=1e-12)
    left, note = with_last_mode(other, structure, 40.0)
    assert left is other
    assert note.startswith("mode 5, above the lines, is left out")
    assert elsewhere.channels[0] in note


def test_gravity_at_its_places_is_told_through_noise_that_bends_told_pose_by_pose_let_through(
    machine: Machine, exact: ModalModel, structure: Structure
) -> None:
    """The detector's tilt at rest between the poses, of 1.7 mrad, against the emulator."""
    physics, emulated, generator = Physics(machine.plant, noise=False), Emulated(machine), np.random.default_rng(3)
    standing = []
    for pose in (np.array([p, r]) for p in axis_grid(machine, 0, 9) for r in axis_grid(machine, 1, 11)):
        physics.place(pose)
        seen = physics.latch_exactly()
        noise = 1.6e-4 * generator.standard_normal(6) * np.array([1.0, 1.0, 1.0, 0.1, 0.1, 0.1])
        standing.append(Standing(seen.position.copy(), seen.link_position.copy(), physics.holding_effort(pose), seen.imu[:6] + noise))
    alone, *_ = with_gravity(replace(exact, turning=None, coupling=None), standing)
    together, bias, deviation = with_gravity_at_places(with_places(alone, structure), standing, effort_gain(machine))
    assert (np.abs(bias[:3] - machine.plant.imus[0].accelerometer_bias_m_s2) < 4.0 * deviation[:3]).all()
    errors: dict[str, list[float]] = {"alone": [], "together": []}
    for pose in (np.array([-0.9, 1.3]), np.array([0.9, -1.3]), np.array([0.2, 0.45]), np.array([-0.5, -0.6])):
        q, *_ = emulated.modes_at(pose, 4)
        rigid = np.zeros(len(q))
        rigid[emulated.driven] = pose
        (_, bent), (_, straight) = emulated.body_at(q, 0), emulated.body_at(rigid, 0)
        true = Rotation.from_matrix(straight.T @ bent).as_rotvec()
        for name, model in (("alone", alone), ("together", together)):
            n, modes, stride = len(pose), model.modes, model.mode_stride
            values = model.at(pose)
            table = values[: modes * stride].reshape(modes, stride)
            push = table[:, -n:] @ physics.holding_effort(pose) + values[modes * stride + n * (n + 1) + n :][:modes]
            bend = push / table[:, 0]
            chain = pose - bend @ table[:, 2 : 2 + n]  # where the axes stand when the motor sides stand at the pose
            at_chain = np.zeros(len(q))
            at_chain[emulated.driven] = chain
            _, turned = emulated.body_at(at_chain, 0)
            found = Rotation.from_matrix(straight.T @ turned @ Rotation.from_rotvec(bend @ table[:, 5 + 2 * n : 8 + 2 * n]).as_matrix())
            errors[name].append(float(np.linalg.norm(found.as_rotvec() - true)))
    rms = {name: np.sqrt(np.mean(np.square(each))) for name, each in errors.items()}
    assert rms["together"] < 2e-5, rms
    assert rms["together"] < 0.5 * rms["alone"], rms


def test_inertias_told_wrong_with_the_sign_of_the_first_axis_come_out_right(
    machine: Machine, exact: ModalModel, poses: list[np.ndarray]
) -> None:
    first = exact.modes * exact.mode_stride
    wrong = exact.coefficients.copy()
    place = 2 * (2 * exact.harmonics[1] + 1)  # sin of the first axis
    wrong[first : first + 4, place] += 0.02 * wrong[first : first + 4, 0]
    mended = with_inertia(replace(exact, coefficients=wrong), poses, effort_gain(machine))
    emulated = Emulated(machine)
    pose = np.array([0.9, -0.6])
    _, inertia, _, _ = emulated.modes_at(pose, 4)
    true = np.linalg.inv(emulated.rigid.T @ inertia @ emulated.rigid) * effort_gain(machine)
    assert mended.at(pose)[first : first + 4].reshape(2, 2) == pytest.approx(true, rel=2e-3, abs=2e-3 * true.max())


def test_without_a_mount_there_is_no_structure(machine: Machine, exact: ModalModel, poses: list[np.ndarray]) -> None:
    assert found_structure(exact, poses, effort_gain(machine), None) is None


def test_poses_that_do_not_tell_inertias_give_no_structure(machine: Machine, exact: ModalModel) -> None:
    gain = effort_gain(machine)
    few = [np.array([p, r]) for p in axis_grid(machine, 0, COUNTS[0]) for r in (-0.8, 0.0, 0.8)]
    _, mount = with_sag(exact, few, GRAVITY_POSES, gain)
    assert mount is not None
    assert found_structure(exact, few, gain, replace(mount, deviation=0.0)) is None


@pytest.mark.parametrize("column", [np.zeros(2), np.array([0.0, -0.2])])
def test_a_command_that_moves_nothing_or_backwards_is_refused(machine: Machine, exact: ModalModel, column: np.ndarray) -> None:
    first = exact.modes * exact.mode_stride
    wrong = exact.coefficients.copy()
    wrong[[first + 1, first + 3]] = 0.0
    wrong[[first + 1, first + 3], 0] = column
    with pytest.raises(BadAnswerError, match=r"at \[.*\] \(rad or m\) the command does not move roll"):
        with_inertia(replace(exact, coefficients=wrong), [np.zeros(2)], effort_gain(machine))
