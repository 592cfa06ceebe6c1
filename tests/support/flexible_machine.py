"""A C-arm whose every mount gives way, as a machine file and as MuJoCo's statics of it."""

from __future__ import annotations

import mujoco
import numpy as np

from hil.machine import Machine, machine_from_text
from hil.machine.load import load_machine
from hil.machine.mjcf import to_mjcf

SOFT = {
    "source_position_m = [0.0, 0.0, 0.0]": "source_position_m = [0.05, -0.03, -0.06]",  # off the tube's mount, or it would not matter
    "stiffness_Nm_rad = 4.0e7": "stiffness_Nm_rad = 6.0e4",  # ceiling
    "stiffness_Nm_rad = 2.4e7": "stiffness_Nm_rad = 5.0e4",  # arm
    "stiffness_Nm_rad = 1.015e4": "stiffness_Nm_rad = 6.0e3",  # panel's mount
    "stiffness_Nm_rad = 1.07e5": "stiffness_Nm_rad = 4.0e4",  # propeller's gear
    "stiffness_Nm_rad = 9.0e5": "stiffness_Nm_rad = 5.0e4",  # roll's gear
    "position_m = [0.0, 0.0, -0.81]                          # its focal spot\n": (
        "position_m = [0.01, -0.02, -0.81]\norientation_deg = [2.0, -1.0, 0.5]\n"
    ),
    "inertia_kg_m2 = [1.8, 1.8, 1.5, 0.0, 0.0, 0.0]\n": (
        "inertia_kg_m2 = [1.8, 1.8, 1.5, 0.0, 0.0, 0.0]\n"
        '[body.joint]\nname = "tube_mount"\ntype = "revolute"\naxis = [0.6, 0.0, 0.8]\nstiffness_Nm_rad = 8.0e3\ndamping_Nm_s_rad = 3.0\n'
    ),
    "position_m = [0.3, 0.0, -1.0]\n": "position_m = [0.3, 0.004, -1.002]\norientation_deg = [0.3, -0.2, 0.4]\n",
}


OFF = {
    "position_m = [0.3, 0.0, -1.0]\n": "position_m = [0.3, 0.0006, -1.0008]\norientation_deg = [0.05, -0.08, 0.06]\n",
    "position_m = [0.9, 0.0, 0.0]\n": "position_m = [0.9, 0.0004, 0.0007]\norientation_deg = [0.07, 0.05, -0.09]\n",
    "position_m = [0.0, 0.0, -0.81]  ": "position_m = [0.0012, -0.0009, -0.8115]  ",
    "position_m = [0.0, 0.0, 0.35]\n": "position_m = [0.0008, 0.0011, 0.3512]\norientation_deg = [0.12, -0.1, 0.15]\n",
    "stiffness_Nm_rad = 1.015e4": "stiffness_Nm_rad = 0.85e4",
    "stiffness_Nm_rad = 4.0e7": "stiffness_Nm_rad = 4.0e6",
}
"""A machine that is off its drawing: axes, tube and panel misplaced by tenths and ones of a millimetre and a milliradian, softer mounts."""

LONG = {
    "position_m = [0.3, 0.0, -1.0]\n": "position_m = [0.3, 0.0, -1.0008]\n",
    "position_m = [0.9, 0.0, 0.0]\n": "position_m = [0.9007, 0.0, 0.0]\n",
    "position_m = [0.0, 0.0, -0.81]  ": "position_m = [0.0, 0.0, -0.8115]  ",
    "position_m = [0.0, 0.0, 0.35]\n": "position_m = [0.0, 0.0, 0.3512]\n",
    "stiffness_Nm_rad = 1.015e4": "stiffness_Nm_rad = 0.85e4",
    "stiffness_Nm_rad = 4.0e7": "stiffness_Nm_rad = 4.0e6",
}
"""Off its drawing in lengths and stiffnesses alone: the plant's equations are the C-arm's own, and need no compilation."""


def machine_file(changes: dict[str, str], name: str = "carm") -> str:
    """The shipped C-arm with pieces of its file replaced."""
    text = load_machine("carm").text
    for old, new in changes.items():
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    return text.replace('name = "carm"', f'name = "{name}"')


def soft_machine(link_encoders: bool = True) -> Machine:
    text = machine_file(SOFT)
    if not link_encoders:
        for axis in ("propeller", "roll"):
            text = text.replace(f"[sensors.link_position_{axis}]\ntype", f"[sensors.other_{axis}]\ntype")
    return machine_from_text(text, label="soft")


class Statics:
    """Poses of panel and tube at rest, by MuJoCo: springs against its own gravity."""

    def __init__(self, machine: Machine, held: tuple[str, ...] = ()) -> None:
        self.machine, self.held = machine, held
        self.model = mujoco.MjModel.from_xml_string(to_mjcf(machine.plant, "statics"))
        self.data = mujoco.MjData(self.model)

    def __call__(self, positions: np.ndarray) -> list[np.ndarray]:
        """Frames (4, 4) of panel centre and focal spot in the isocentre."""
        model, data = self.model, self.data
        driven = {drive.joint: k for k, drive in enumerate(self.machine.plant.drives)}
        data.qpos[:] = 0.0
        for _ in range(60):
            mujoco.mj_forward(model, data)
            for joint in self.machine.plant.tree.joints:
                at = model.joint(joint.name).qposadr[0]
                if joint.name in driven:
                    data.qpos[at] = positions[driven[joint.name]]
                elif joint.name not in self.held:
                    data.qpos[at] = -data.qfrc_bias[model.joint(joint.name).dofadr[0]] / joint.stiffness
        mujoco.mj_kinematics(model, data)
        geometry = self.machine.geometry
        result = []
        for name, offset in ((geometry.detector_body, geometry.detector_center_m), (geometry.source_body, geometry.source_position_m)):
            frame = np.eye(4)
            frame[:3, :3] = data.body(name).xmat.reshape(3, 3)
            frame[:3, 3] = data.body(name).xpos + frame[:3, :3] @ offset - geometry.isocenter_m
            result.append(frame)
        return result
