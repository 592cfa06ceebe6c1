"""Replay a recording in MuJoCo from the exported model, the machine file and the recording alone.

    python replay_in_mujoco.py MODEL.xml MACHINE.toml RECORDING.csv OUT.csv

Of the recording only the references, the excitations and the metadata's start pose and controller states are read. The loop is written from
docs/explanation/notation.md; this file imports none of the project's packages.
"""

import csv
import math
import sys
import tomllib
from pathlib import Path

import mujoco
import numpy as np

STEPS_PER_SAMPLE = 16


def rounded(value: np.ndarray, resolution: float | np.ndarray) -> np.ndarray:
    return np.floor(value / resolution + 0.5) * resolution


class Filter:
    """Second-order sections, direct form II transposed."""

    def __init__(self, sections: list[list[float]], state: list[list[float]]) -> None:
        self.sections, self.state = sections, [list(row) for row in state]

    def step(self, x: float) -> float:
        for (b0, b1, b2, _, a1, a2), s in zip(self.sections, self.state, strict=True):
            y = b0 * x + s[0]
            s[0], s[1] = b1 * x - a1 * y + s[1], b2 * x - a2 * y
            x = y
        return x


class LowPass:
    """First order, exact for an input that is linear in time over a step."""

    def __init__(self, bandwidth_Hz: float, step_s: float, value: np.ndarray) -> None:
        phase = 2.0 * math.pi * bandwidth_Hz * step_s
        self.decay, mean = math.exp(-phase), (1.0 - math.exp(-phase)) / phase
        self.old, self.new, self.value = mean - self.decay, 1.0 - mean, np.array(value)

    def step(self, start: np.ndarray, end: np.ndarray) -> None:
        self.value = self.decay * self.value + self.old * start + self.new * end


def stand_still(model: mujoco.MjModel, data: mujoco.MjData, driven: list[int], pose: list[float]) -> np.ndarray:
    """Elastic equilibrium with the driven joints at `pose`; returns their holding efforts as controls."""

    def load(q: np.ndarray) -> np.ndarray:
        data.qpos[:], data.qvel[:], data.qacc[:] = q, 0.0, 0.0
        mujoco.mj_inverse(model, data)
        return data.qfrc_inverse.copy()

    free = [joint for joint in range(model.nq) if joint not in driven]
    q = np.zeros(model.nq)
    q[driven] = pose
    for _ in range(10):
        gradient = np.array([(load(q + 1e-6 * unit) - load(q - 1e-6 * unit)) / 2e-6 for unit in np.eye(model.nq)]).T
        q[free] -= np.linalg.solve(gradient[np.ix_(free, free)], load(q)[free])
    holding = load(q)[driven] / model.actuator_gear[:, 0]
    data.qpos[:], data.qvel[:] = q, 0.0
    return holding


def main(model_path: str, machine_path: str, recording_path: str, out_path: str) -> None:
    machine = tomllib.loads(Path(machine_path).read_text(encoding="utf-8"))
    metadata = tomllib.loads(Path(recording_path).with_suffix(".toml").read_text(encoding="utf-8"))
    with open(recording_path, newline="", encoding="utf-8") as stream:
        header, *rows = list(csv.reader(stream))
    columns = {cell.split(" [")[0]: number for number, cell in enumerate(header)}
    axes = list(machine["drives"])
    drives = [machine["drives"][axis] for axis in axes]

    def given(group: str) -> np.ndarray:
        return np.array([[float(row[columns[f"{group}_{axis}"]]) for axis in axes] for row in rows])

    reference, excitation = given("reference"), given("excitation")
    rate_Hz = machine["timing"]["sample_rate_Hz"]
    model = mujoco.MjModel.from_xml_path(str(model_path))
    model.opt.timestep, model.opt.integrator = 1.0 / (rate_Hz * STEPS_PER_SAMPLE), mujoco.mjtIntegrator.mjINT_RK4
    data = mujoco.MjData(model)
    driven = [model.joint(drive["joint"]).qposadr[0] for drive in drives]
    holding = stand_still(model, data, driven, metadata["experiment"]["start_pose"])

    counts = [2.0 * math.pi / (drive["encoder_counts_per_motor_turn"] * drive["ratio"]) for drive in drives]
    targets = np.array([drive["target_resolution_permille"] / 1000.0 * drive["rated_current_A"] for drive in drives])
    limits = np.array([drive["limit_A"] for drive in drives])
    states = metadata["initial"]["controller_states"]
    filters = [Filter(machine["controller"][axis]["position_sections"], states[axis]["position"]) for axis in axes]
    imu = machine["sensors"]["imu"]
    data.ctrl[:] = holding
    mujoco.mj_forward(model, data)
    force, rate = data.sensor("imu").data, data.sensor("gyro").data
    passes = [
        LowPass(imu["accelerometer_bandwidth_Hz"], model.opt.timestep, force),
        LowPass(imu["gyro_bandwidth_Hz"], model.opt.timestep, rate),
    ]
    bias = np.array(imu["accelerometer_bias_m_s2"] + imu["gyro_bias_rad_s"])

    answer = []
    command = holding.copy()
    for k in range(len(rows)):
        effort = rounded(command, targets)
        position = rounded(data.qpos[driven], np.array(counts))
        for axis, loop in enumerate(filters):
            wanted = loop.step(reference[k, axis] - position[axis]) + excitation[k, axis]
            command[axis] = min(max(wanted, -limits[axis]), limits[axis])
        answer.append([k / rate_Hz, *command, *effort, *position, *(np.concatenate([passes[0].value, passes[1].value]) + bias)])
        data.ctrl[:] = effort
        for step in range(STEPS_PER_SAMPLE):
            if step == 0:
                mujoco.mj_forward(model, data)  # the effort has just changed
            start = force.copy(), rate.copy()
            mujoco.mj_step(model, data)
            mujoco.mj_forward(model, data)
            for low_pass, old, new in zip(passes, start, (force, rate), strict=True):
                low_pass.step(old, new)

    names = ["time [s]"]
    for group, unit in (("command", "A"), ("current", "A"), ("position", "rad")):
        names += [f"{group}_{axis} [{unit}]" for axis in axes]
    names += [f"imu_{axis} [m/s^2]" for axis in "xyz"] + [f"gyro_{axis} [rad/s]" for axis in "xyz"]
    with open(out_path, "w", newline="", encoding="utf-8") as stream:
        csv.writer(stream, lineterminator="\n").writerows([names, *answer])


if __name__ == "__main__":
    main(*sys.argv[1:])
