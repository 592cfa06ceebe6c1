"""Motion over ten seconds: our plant and MuJoCo on the exported model, both at steps at which they have converged."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from mujoco import rollout
from small_plants import gantry

from hil.machine.load import load_machine
from hil.machine.mjcf import to_mjcf
from virtual_bus.physics import Physics
from virtual_bus.plant.compiled import compile_plant
from virtual_bus.plant.statics import holding_effort, resting_state
from virtual_bus.settings import PlantSettings

SECONDS = 10.0
POSES = [(0.0, 0.0), (1.2, -0.8), (-0.9, 1.3)]


@pytest.fixture(scope="module")
def carm() -> PlantSettings:
    return load_machine("carm").plant


def mujoco_positions(settings: PlantSettings, start: np.ndarray, efforts: np.ndarray, steps: int) -> np.ndarray:
    """Joint positions (N, n) of MuJoCo's fourth-order Runge-Kutta at `steps` a sample."""
    model = mujoco.MjModel.from_xml_string(to_mjcf(settings, "plant"))
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_RK4
    model.opt.timestep = settings.sample_period_s / steps
    model.actuator_ctrllimited[:] = 0
    data = mujoco.MjData(model)
    data.qpos[:] = start
    size = mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS)
    initial = np.zeros(size)
    mujoco.mj_getState(model, data, initial, mujoco.mjtState.mjSTATE_FULLPHYSICS)
    states, _ = rollout.rollout(model, data, initial, np.repeat(efforts, steps, axis=0)[None])
    return states[0, steps - 1 :: steps, 1 : 1 + model.nq]


def our_positions(settings: PlantSettings, start: np.ndarray, efforts: np.ndarray, steps: int) -> np.ndarray:
    plant = compile_plant(settings)
    model, work = compile_plant(replace(settings, substeps=steps)).model(), plant.new_work()
    state = plant.new_state(start)
    positions = np.zeros((len(efforts), plant.joints))
    for k, effort in enumerate(efforts):
        plant.advance(state, effort, np.zeros(len(effort)), model, work)
        positions[k] = state[: plant.joints]
    return positions


def assert_same_motion(ours: np.ndarray, theirs: np.ndarray) -> None:
    """Within 1e-5 of every joint's own largest position, elastic ones too."""
    assert np.isfinite(ours).all()
    difference = np.abs(ours - theirs).max(axis=0) / np.abs(theirs).max(axis=0)
    assert difference.max() < 1e-5, difference


@pytest.mark.slow
@pytest.mark.parametrize("pose", POSES)
@pytest.mark.parametrize("driven", [False, True], ids=["free", "driven"])
def test_ten_seconds_of_the_c_arm_are_those_of_mujoco(carm: PlantSettings, pose: tuple[float, float], driven: bool) -> None:
    plant = compile_plant(carm)
    start = resting_state(plant, plant.model(), np.array(pose), held_by_brakes=False)[: plant.joints]
    time_s = np.arange(round(SECONDS / carm.sample_period_s))[:, None] * carm.sample_period_s
    efforts = np.zeros((len(time_s), 2))
    if driven:
        slow = 2.0 * np.sin(2.0 * np.pi * time_s * [0.7, 0.5])
        efforts = holding_effort(plant, plant.model(), np.array(pose)) + slow + np.sin(2.0 * np.pi * time_s * [8.0, 14.0])
    ours = our_positions(carm, start, efforts, steps=64)
    theirs = mujoco_positions(carm, start, efforts, steps=8)
    assert np.ptp(ours[:, plant.joint_of_axis()["roll"]]) > 0.05, "the arm hardly moved: nothing was compared"
    assert_same_motion(ours, theirs)


def test_ten_seconds_of_a_tree_with_slides_are_those_of_mujoco() -> None:
    settings = gantry()
    time_s = np.arange(round(SECONDS / settings.sample_period_s))[:, None] * settings.sample_period_s
    efforts = 3.0 * np.sin(2.0 * np.pi * 0.8 * time_s) + np.sign(np.sin(2.0 * np.pi * 0.3 * time_s))
    start = np.array([0.2, -0.1, 0.05, 1.0])
    assert_same_motion(our_positions(settings, start, efforts, steps=64), mujoco_positions(settings, start, efforts, steps=8))


def test_the_error_falls_with_the_square_of_the_step(carm: PlantSettings) -> None:
    plant = compile_plant(carm)
    start = resting_state(plant, plant.model(), np.array(POSES[1]), held_by_brakes=False)[: plant.joints]
    efforts = np.zeros((512, 2))
    converged = our_positions(carm, start, efforts, steps=128)
    coarse, fine = (np.abs(our_positions(carm, start, efforts, steps) - converged).max() for steps in (4, 8))
    assert coarse / fine == pytest.approx(4.0, rel=0.1)


@pytest.mark.parametrize("roll", [-1.5, -0.7, 0.0, 0.8, 1.5])
def test_natural_frequencies_are_those_of_mujoco(carm: PlantSettings, roll: float) -> None:
    physics = Physics(carm, noise=False)
    pose = np.array([0.4, roll])
    system = physics.linearise(pose)
    ours = np.linalg.eigvals(system.A[: 2 * physics.plant.joints, : 2 * physics.plant.joints])
    q = resting_state(physics.plant, physics.model, pose, held_by_brakes=False)[: physics.plant.joints]
    theirs = np.linalg.eigvals(mujoco_gradients(carm, q, physics.holding_effort(pose))[0])
    flexible = 2.0 * np.pi * 1.0  # rad/s: slower are the two axes swinging under gravity
    np.testing.assert_allclose(np.sort_complex(ours[ours.imag > flexible]), np.sort_complex(theirs[theirs.imag > flexible]), rtol=1e-6)
    assert (ours.imag > flexible).sum() == 5


def mujoco_gradients(settings: PlantSettings, q: np.ndarray, effort: np.ndarray) -> tuple[np.ndarray, ...]:
    """System matrices A, B, C, D by central differences of MuJoCo's forward dynamics; outputs are all sensors in MuJoCo's order."""
    model = mujoco.MjModel.from_xml_string(to_mjcf(settings, "plant"))
    data = mujoco.MjData(model)
    n, step = model.nv, 1e-6

    def evaluate(point: np.ndarray) -> np.ndarray:
        data.qpos[:], data.qvel[:], data.ctrl[:] = point[:n], point[n : 2 * n], point[2 * n :]
        mujoco.mj_forward(model, data)
        return np.concatenate([data.qvel, data.qacc, data.sensordata])

    center = np.concatenate([q, np.zeros(n), effort])
    columns = [(evaluate(center + step * e) - evaluate(center - step * e)) / (2 * step) for e in np.eye(len(center))]
    gradient = np.array(columns).T
    return gradient[: 2 * n, : 2 * n], gradient[: 2 * n, 2 * n :], gradient[2 * n :, : 2 * n], gradient[2 * n :, 2 * n :]


def test_the_linearisation_answers_like_mujoco_at_every_sensor(carm: PlantSettings) -> None:
    physics = Physics(carm, noise=False)
    pose = np.array([-0.5, 0.6])
    system = physics.linearise(pose)
    q = resting_state(physics.plant, physics.model, pose, held_by_brakes=False)[: physics.plant.joints]
    a, b, c, d = mujoco_gradients(carm, q, physics.holding_effort(pose))
    reference = mujoco.MjModel.from_xml_string(to_mjcf(carm, "plant"))

    def address(name: str) -> int:
        return int(reference.sensor(name).adr[0])

    rows = {encoder.channel: (address(encoder.channel), 0.0) for encoder in carm.encoders}
    for k, letter in enumerate("xyz"):
        rows[f"imu_{letter}"] = (address("imu") + k, carm.imus[0].accelerometer_bandwidth_Hz)
        rows[f"gyro_{letter}"] = (address("gyro") + k, carm.imus[0].gyro_bandwidth_Hz)
    assert sorted(system.output_labels) == sorted(rows)
    assert system.input_labels == ["command_propeller", "command_roll"]
    for frequency_Hz in (0.5, 4.0, 8.0, 14.0, 50.0):
        s = 2j * np.pi * frequency_Hz
        theirs = c @ np.linalg.solve(s * np.eye(len(a)) - a, b) + d
        ours = system(s)
        for name, (row, bandwidth_Hz) in rows.items():
            low_pass = 1.0 / (1.0 + 1j * frequency_Hz / bandwidth_Hz) if bandwidth_Hz else 1.0
            expected, largest = low_pass * theirs[row], np.abs(theirs[row]).max()
            np.testing.assert_allclose(ours[system.output_labels.index(name)], expected, rtol=1e-5, atol=1e-6 * largest, err_msg=name)


def test_energy_stays_without_damping(carm: PlantSettings) -> None:
    plant = compile_plant(carm)
    undamped = {p.name: 0.0 for p in plant.parameters if p.quantity == "damping"}
    model = compile_plant(replace(carm, substeps=32)).model(plant.with_values(undamped))
    state, work = plant.new_state(np.array([0.0] * plant.joints)), plant.new_work()
    axes = plant.joint_of_axis()
    state[axes["propeller"]], state[axes["roll"]] = 0.8, -1.1

    witness = mujoco.MjModel.from_xml_string(to_mjcf(carm, "carm"))
    witness.opt.enableflags |= mujoco.mjtEnableBit.mjENBL_ENERGY
    data = mujoco.MjData(witness)

    def energies() -> tuple[float, float]:
        data.qpos[:], data.qvel[:] = state[: plant.joints], state[plant.joints : 2 * plant.joints]
        mujoco.mj_forward(witness, data)
        return float(data.energy[0]), float(data.energy[1])

    potential, kinetic = energies()
    moved = []
    for _ in range(round(SECONDS / carm.sample_period_s)):
        plant.advance(state, np.zeros(2), np.zeros(2), model, work)
        moved.append(energies())
    totals = np.sum(moved, axis=1)
    exchanged = np.ptp([motion for _, motion in moved])
    assert exchanged > 10.0  # J between gravity, springs and motion
    assert np.abs(totals - (potential + kinetic)).max() < 1e-7 * exchanged


def test_accelerometers_err_by_the_square_of_the_plant_step(carm: PlantSettings) -> None:
    """Behind their low passes, while both axes swing freely."""

    def accelerations(substeps: int) -> np.ndarray:
        plant = compile_plant(replace(carm, substeps=substeps))
        model, state, work = plant.model(), plant.new_state(np.zeros(plant.joints)), plant.new_work()
        axes = plant.joint_of_axis()
        state[axes["propeller"]], state[axes["roll"]] = 0.8, -1.1
        rows = []
        for _ in range(round(2.0 / carm.sample_period_s)):
            plant.advance(state, np.zeros(2), np.zeros(2), model, work)
            rows.append(state[4 * plant.joints : 4 * plant.joints + 3].copy())
        return np.array(rows)[round(0.5 / carm.sample_period_s) :]

    coarse, fine, converged = (accelerations(substeps) for substeps in (4, 8, 64))
    assert np.abs(coarse - converged).max() > 3.0 * np.abs(fine - converged).max()
