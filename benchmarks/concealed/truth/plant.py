"""A plant from its MJCF and machine file, with other numbers and added physics, run in the loop."""

from __future__ import annotations

import math
import re
import tomllib
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import mujoco
import numpy as np

from concealed.truth import joint_physics as physics
from concealed.truth.loop import DRIVE, ENCODER, run
from concealed.truth.memory import forward_address

STEP_S = 0.0003
"""Longest plant step. What a step a third as long changes then stays under 1.5 in the oracle's units (tests/benchmarks/concealed)."""

COARSE = 3
"""Times as long steps of what is not recorded: imitators, derivatives, refits and the search for a strength. Every one of them is a
difference of two simulations in the same steps, and what these leave out is alike in both."""

IMU_SENSORS, CORNER = ("accelerometer", "gyro"), "corner"
"""Whose low passes are numbers of the machine file, and what their keys begin with."""

IMU_CHANNELS = ("imu_x", "imu_y", "imu_z", "gyro_x", "gyro_y", "gyro_z")


@dataclass
class Setup:
    """What differs from the machine file: factors on its numbers, and physics it does not have."""

    factors: dict[str, float] = field(default_factory=dict)
    """Of `mass:BODY`, `inertia:BODY`, `com_x:BODY`, `stiffness:JOINT`, `damping:JOINT`, `armature:JOINT`, `constant:AXIS`."""
    joints: list[tuple[int, str, str, list[float]]] = field(default_factory=list)  # kind, joint, other joint, parameters
    drives: dict[tuple[str, str], float] = field(default_factory=dict)  # (axis, column) -> value
    encoders: dict[tuple[str, str], float] = field(default_factory=dict)
    masses: list[tuple[str, float, float]] = field(default_factory=list)  # body, added mass, its distance from the centre of mass
    springs: dict[str, tuple[float, float]] = field(default_factory=dict)  # joint -> added compliance, added damping
    imu_pole_Hz: float = 0.0
    readings: list[tuple[str, tuple[str, ...], dict[str, float]]] = field(default_factory=list)  # kind, channels, parameters


@dataclass
class Drive:
    """What a run is driven by, arrays (N, n_axes)."""

    reference: np.ndarray
    excitation: np.ndarray
    start: np.ndarray
    disturbance: np.ndarray | None = None
    calm_speed: float = 0.0


class Machine:
    """What the machine file says, as far as the truth needs it."""

    def __init__(self, path: Path, mjcf: Path, gain: float = 1.0) -> None:
        self.path, self.mjcf = path, mjcf
        self.text = _with_gain(path.read_text(encoding="utf-8"), gain)
        table = self.table = tomllib.loads(self.text)
        self.name = table["name"]
        self.axes = list(table["drives"])
        self.rate_Hz = float(table["timing"]["sample_rate_Hz"])
        self.closed = "controller" in table
        self.units = [drive["effort_unit"] for drive in table["drives"].values()]
        self.joint_of = {axis: drive["joint"] for axis, drive in table["drives"].items()}
        self.body_of = {body["joint"]["name"]: body["name"] for body in table["body"] if "joint" in body}
        self.joints = list(self.body_of)
        self.kinds = {body["joint"]["name"]: body["joint"]["type"] for body in table["body"] if "joint" in body}
        self.length = [self.kinds[self.joint_of[axis]] == "prismatic" for axis in self.axes]
        self.sprung = [j for j in self.joints if any(key.startswith("stiffness") for key in self._joint(j))]
        self.limits = np.array([drive[f"limit_{unit}"] for drive, unit in zip(table["drives"].values(), self.units, strict=True)])
        self.gear = np.array([float(drive["constant"]) * float(drive.get("ratio", 1.0)) for drive in table["drives"].values()])
        self.imu = table["sensors"].get("imu")
        self.currents = ["current" if unit == "A" else "effort" for unit in self.units]
        self.counts = np.array([self._count(axis) for axis in self.axes])
        self.link_counts = np.array([self._link_count(axis) for axis in self.axes])

    def _joint(self, name: str) -> dict[str, object]:
        return next(body["joint"] for body in self.table["body"] if body.get("joint", {}).get("name") == name)

    def _lattice(self, sensor: dict[str, float]) -> float:
        if "resolution_um" in sensor:
            return 1e-6 * sensor["resolution_um"]
        return 2.0 * math.pi / sensor["counts_per_turn"] if "counts_per_turn" in sensor else 0.0

    def _count(self, axis: str) -> float:
        drive = self.table["drives"][axis]
        given = self._lattice(self.table["sensors"][f"position_{axis}"])
        return given or 2.0 * math.pi / (drive["encoder_counts_per_motor_turn"] * drive["ratio"])

    def _link_count(self, axis: str) -> float:
        sensor = self.table["sensors"].get(f"link_position_{axis}")
        return 0.0 if sensor is None else self._lattice(sensor)

    def target_steps(self) -> np.ndarray:
        """Resolution of the drives' targets, in their units."""
        steps = []
        for drive, unit in zip(self.table["drives"].values(), self.units, strict=True):
            rated = drive.get("rated_current_A", drive.get(f"rated_effort_{unit}", 0.0))
            steps.append(drive.get("target_resolution_permille", 0.0) / 1000.0 * rated)
        return np.array(steps)

    def noise(self, channel: str) -> tuple[float, float]:
        """Noise rms and resolution that the machine file gives a channel."""
        if channel in IMU_CHANNELS:
            which, unit = ("accelerometer", "m_s2") if channel.startswith("imu") else ("gyro", "rad_s")
            index = "xyz".index(channel[-1])
            rms = self.imu.get(f"{which}_noise_rms_{unit}", [0.0] * 3)[index]
            return float(rms), float(self.imu.get(f"{which}_resolution_{unit}", 0.0))
        sensor = self.table["sensors"][channel]
        unit = sensor_unit = self.units[self.axes.index(sensor["axis"])]
        return float(sensor.get(f"noise_rms_{unit}", 0.0)), float(sensor.get(f"resolution_{sensor_unit}", 0.0))

    def with_gain(self, gain: float) -> Machine:
        """The same machine under a controller of another gain."""
        return self if gain == 1.0 or not self.closed else Machine(self.path, self.mjcf, gain)

    def spring_behind(self, axis: str) -> str:
        """The sprung joint between an axis's motor side and its load; "" for none."""
        carried = [b["joint"]["name"] for b in self.table["body"] if b["parent"] == self.body_of[self.joint_of[axis]] and "joint" in b]
        return next((joint for joint in carried if joint in self.sprung), "")

    @cached_property
    def inertias(self) -> dict[str, float]:
        """What each joint alone accelerates while every other is free [kg m^2 or kg], at position zero."""
        model = mujoco.MjModel.from_xml_path(str(self.mjcf))
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        full = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, data, full)
        seen = 1.0 / np.diag(np.linalg.inv(full))
        return {joint: float(seen[model.joint(joint).dofadr[0]]) for joint in self.joints}

    def current_of(self, axis: str) -> str:
        """The channel of an axis's current or effort."""
        return f"{self.currents[self.axes.index(axis)]}_{axis}"

    def stiffness(self, joint: str) -> float:
        """Of the machine file's spring [Nm/rad or N/m]."""
        return float(next(value for key, value in self._joint(joint).items() if key.startswith("stiffness")))  # type: ignore[arg-type]

    def effort_scale(self, axis: str) -> float:
        """A tenth of what the drive can give, at the joint [Nm or N]."""
        i = self.axes.index(axis)
        return 0.1 * float(self.limits[i] * self.gear[i])

    def reach(self, axis: str) -> float:
        """Half the range that experiments use [rad or m]."""
        if "limits" not in self.table:
            return 0.03
        low, high = next(value for key, value in self.table["limits"][axis].items() if key.startswith("range"))
        return 0.5 * (high - low) * (1.0 if self.length[self.axes.index(axis)] else math.pi / 180.0)

    def channels(self) -> list[str]:
        """Measured channels, in the recording's order."""
        names = [f"{kind}_{axis}" for kind, axis in zip(self.currents, self.axes, strict=True)]
        names += [f"position_{axis}" for axis in self.axes]
        names += [f"link_position_{axis}" for axis, count in zip(self.axes, self.link_counts, strict=True) if count > 0.0]
        return names + (list(IMU_CHANNELS) if self.imu else [])


def _with_gain(text: str, gain: float) -> str:
    """A machine file whose controllers' first sections are `gain` times as strong."""
    if gain == 1.0:
        return text

    def stronger(match: re.Match[str]) -> str:
        row = [float(cell) for cell in match[2].split(",")]
        return f"{match[1]}{[*(gain * b for b in row[:3]), *row[3:]]}"

    return re.sub(r"(position_sections = \[\s*)\[([^\]]*)\]", stronger, text)


@dataclass(frozen=True)
class Answer:
    """What a run gave: channels by name (N,), commands (N, n_axes), and the joints' true motion (N, joints)."""

    channels: dict[str, np.ndarray]
    command: np.ndarray
    q: np.ndarray
    v: np.ndarray
    controller_states: dict[str, dict[str, list[list[float]]]]
    failed: bool


class Plant:
    """One machine with a setup; runs as often as wanted."""

    def __init__(self, machine: Machine, setup: Setup) -> None:
        self.machine, self.setup = machine, setup
        self.model = mujoco.MjModel.from_xml_path(str(machine.mjcf))
        self.data = mujoco.MjData(self.model)
        self._change_model()
        self.axes = np.array([self.model.joint(machine.joint_of[axis]).dofadr[0] for axis in machine.axes])
        self.gear = self.model.actuator_gear[:, 0].copy()
        self._tables()

    def dof(self, joint: str) -> int:
        """Index of a joint's degree of freedom; 0 for no joint."""
        return int(self.model.joint(joint).dofadr[0]) if joint else 0

    def _change_model(self) -> None:
        model, machine = self.model, self.machine
        for key, factor in self.setup.factors.items():
            kind, name = key.split(":")
            if kind == CORNER:
                continue
            if kind == "mass":
                model.body(name).mass *= factor
            elif kind == "inertia":
                model.body(name).inertia *= factor
            elif kind.startswith("com_"):
                model.body(name).ipos["xyz".index(kind[-1])] *= factor
            elif kind == "armature":
                model.dof_armature[model.joint(name).dofadr[0]] *= factor
            elif kind == "stiffness":
                model.joint(name).stiffness *= factor
            elif kind == "damping":
                model.joint(name).damping *= factor
            else:
                model.actuator(name).gear[0] *= factor
        for body, mass, distance in self.setup.masses:
            model.body(body).mass += mass
            model.body(body).inertia += mass * distance**2
        for joint, (compliance, damping) in self.setup.springs.items():
            spring = model.joint(joint)
            stiffness = float(spring.stiffness[0])
            spring.stiffness = stiffness / (1.0 + compliance * stiffness)
            spring.damping += damping
        for (axis, column), value in self.setup.encoders.items():
            if column == "beta":
                model.actuator(axis).gear[0] *= 1.0 + value
                model.dof_armature[model.joint(machine.joint_of[axis]).dofadr[0]] *= (1.0 + value) ** 2
        mujoco.mj_setConst(model, self.data)

    def _tables(self) -> None:
        rows, n = self.setup.joints, len(self.machine.axes)
        self.kinds = np.array([row[0] for row in rows], dtype=np.int64)
        self.dofs = np.array([self.dof(row[1]) for row in rows], dtype=np.int64)
        self.others = np.array([self.dof(row[2]) for row in rows], dtype=np.int64)
        self.parameters = np.zeros((len(rows), physics.PARAMETERS))
        for e, row in enumerate(rows):
            self.parameters[e, : len(row[3])] = row[3]
        self.drives, self.encoders = np.zeros((n, len(DRIVE))), np.zeros((n, len(ENCODER)))
        self.drives[:, DRIVE.index("gain")] = 1.0
        self.drives[:, DRIVE.index("knee")] = 12.0
        self.encoders[:, ENCODER.index("mark")] = 1e9
        for table, names, given in ((self.drives, DRIVE, self.setup.drives), (self.encoders, ENCODER, self.setup.encoders)):
            for (axis, column), value in given.items():
                table[self.machine.axes.index(axis), names.index(column)] = value

    def _standstill(self, start: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Positions in elastic equilibrium with the driven joints at `start`, holding efforts, and the effects' efforts there."""
        model, data = self.model, self.data
        held = np.zeros(len(self.axes))

        def added(q: np.ndarray) -> np.ndarray:
            drive = np.zeros(model.nv)
            drive[self.axes] = self.gear * held
            return physics.static_efforts(self.kinds, self.dofs, self.others, self.parameters, q, data.qfrc_bias.copy(), drive)

        def lacking(q: np.ndarray) -> np.ndarray:
            data.qpos[:], data.qvel[:], data.qacc[:] = q, 0.0, 0.0
            mujoco.mj_inverse(model, data)
            return data.qfrc_inverse - added(q)

        free = [j for j in range(model.nq) if j not in self.axes]
        q = np.zeros(model.nq)
        q[self.axes] = start
        for _ in range(8):
            if free:
                gradient = np.array([(lacking(q + 1e-6 * unit) - lacking(q - 1e-6 * unit)) / 2e-6 for unit in np.eye(model.nq)]).T
                q[free] -= np.linalg.lstsq(gradient[np.ix_(free, free)], lacking(q)[free], rcond=1e-9)[0]  # nothing pulls inside a gap
            gain = self.drives[:, DRIVE.index("gain")].copy()
            for i, axis in enumerate(self.axes):
                Np, A1, phi1, A2, phi2 = self.drives[i, 5:10]
                gain[i] *= 1.0 + physics.tabulated(Np * q[axis] / (2.0 * math.pi), A1, phi1, A2, phi2, 0.0)
            held = lacking(q)[self.axes] / (self.gear * gain)
        standing = added(q)
        standing[self.axes] += self.gear * held * (gain - 1.0)
        return q, held, standing

    def run(self, drive: Drive, lattices: bool = True, longest_step_s: float = STEP_S) -> Answer:
        """Run once; without `lattices` nothing is rounded and no disturbance acts."""
        machine, table = self.machine, self.machine.table
        n, samples = len(machine.axes), len(drive.reference)
        armature = self.model.dof_armature.copy()
        for e in np.flatnonzero(self.kinds == physics.POSE_INERTIA):
            self.parameters[e, 3] = armature[self.dofs[e]]
        q, held, standing = self._standstill(drive.start)
        sections, rows, states = self._controller(held, drive.start)
        see, link = np.zeros((n, self.model.nq)), np.zeros((n, self.model.nq))
        for i, axis in enumerate(machine.axes):
            for matrix, sensor in ((see, f"position_{axis}"), (link, f"link_position_{axis}")):
                for joint in table["sensors"].get(sensor, {}).get("joints", []):
                    matrix[i, self.dof(joint)] = 1.0
        outputs = [np.zeros((samples, n)) for _ in range(4)] + [np.zeros((samples, 6)), np.zeros((samples, self.model.nq))]
        outputs.append(np.zeros_like(outputs[-1]))
        data = self.data
        mujoco.mj_resetData(self.model, data)
        data.qpos[:] = q
        load = np.zeros(self.model.nv)
        load[self.axes] = self.gear * held
        effect_states = physics.standing_states(self.kinds, self.dofs, np.zeros((len(self.kinds), physics.STATES)), q, load)
        before = _controller_table(machine, rows, states)
        disturbance = np.zeros((samples, n)) if drive.disturbance is None or not lattices else drive.disturbance
        failed = run(
            FORWARD, self.model._address, data._address,
            (data.qpos, data.qvel, data.qacc, data.ctrl, data.qfrc_applied, data.qfrc_bias, self.model.dof_armature),
            self._imu_memory(), self.kinds, self.dofs, self.others, self.parameters, effect_states, self.drives, self.encoders, sections,
            rows, states, self.axes, see, link, self.gear, machine.limits, machine.target_steps() * lattices, machine.counts * lattices,
            np.ascontiguousarray(drive.reference), np.ascontiguousarray(drive.excitation), disturbance, drive.calm_speed, standing,
            math.ceil(1.0 / (machine.rate_Hz * longest_step_s)), 1.0 / machine.rate_Hz, self._imu_poles(), machine.closed, held, *outputs,
        )  # fmt: skip
        self.model.dof_armature[:] = armature
        command, effort, position, links, imu, joints, speeds = outputs
        channels = {f"{kind}_{axis}": effort[:, i] for i, (kind, axis) in enumerate(zip(machine.currents, machine.axes, strict=True))}
        channels |= {f"position_{axis}": position[:, i] for i, axis in enumerate(machine.axes)}
        channels |= {f"link_position_{axis}": links[:, i] for i, axis in enumerate(machine.axes) if machine.link_counts[i] > 0.0}
        if machine.imu:
            channels |= dict(zip(IMU_CHANNELS, imu.T, strict=True))
        return Answer(channels, command, joints, speeds, before, failed >= 0)

    def _imu_memory(self) -> np.ndarray:
        if not self.machine.imu:
            return np.zeros(0)
        first = self.model.sensor("imu").adr[0]
        assert self.model.sensor("gyro").adr[0] == first + 3
        return self.data.sensordata[first : first + 6]

    def _imu_poles(self) -> np.ndarray:
        imu = self.machine.imu or {}
        poles = [imu.get(f"{sensor}_bandwidth_Hz", 0.0) * self.setup.factors.get(f"{CORNER}:{sensor}", 1.0) for sensor in IMU_SENSORS]
        return np.array([*poles, self.setup.imu_pole_Hz])

    def _controller(self, held: np.ndarray, start: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """All sections, per axis the first of C_r, of C_y and the end, and states that hold the start."""
        if not self.machine.closed:
            return np.zeros((0, 6)), np.zeros((len(held), 3), dtype=np.int64), np.zeros((0, 2))
        sections: list[list[float]] = []
        rows = []
        for axis in self.machine.axes:
            first = len(sections)
            sections += self.machine.table["controller"][axis].get("reference_sections", [])
            middle = len(sections)
            assert first == middle, "the benchmark's machines have one filter on reference minus position"
            sections += self.machine.table["controller"][axis]["position_sections"]
            rows.append((first, middle, len(sections)))
        table = np.array(sections, dtype=float)
        states = np.zeros((len(table), 2))
        for (_, middle, end), effort in zip(rows, held, strict=True):
            _hold(table[middle:end], states[middle:end], effort)
        return table, np.array(rows, dtype=np.int64), states


def _hold(sections: np.ndarray, states: np.ndarray, effort: float) -> None:
    """States of sections with one pure integrator that have put out `effort` for long with no input."""
    integrating = [abs(1.0 + row[4] + row[5]) < 1e-9 for row in sections]
    assert sum(integrating) == 1
    at = integrating.index(True)
    gains = [(row[0] + row[1] + row[2]) / (1.0 + row[4] + row[5]) for row in sections[at + 1 :]]
    x = effort / math.prod(gains)
    states[at] = x, -sections[at, 5] * x
    for row, state, gain in zip(sections[at + 1 :], states[at + 1 :], gains, strict=True):
        state[:] = gain * x - row[0] * x, row[2] * x - row[5] * gain * x
        x *= gain


def _controller_table(machine: Machine, rows: np.ndarray, states: np.ndarray) -> dict[str, dict[str, list[list[float]]]]:
    if not machine.closed:
        return {}
    return {axis: {"position": states[row[1] : row[2]].tolist()} for axis, row in zip(machine.axes, rows, strict=True)}


FORWARD = forward_address()
