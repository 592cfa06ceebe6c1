"""A draft of a machine from a model that MuJoCo reads: MJCF, or URDF."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
from scipy.spatial.transform import Rotation

from hil.errors import UnusableInputError
from hil.extras import extra_package
from hil.machine.new.draft import Draft, DraftAxis, DraftBody, Value
from hil.machine.new.questions import KnownDrive

KINDS = {2: "prismatic", 3: "revolute"}
"""MuJoCo's types of joints that a machine file has; 0 is free, 1 a ball."""

SPLIT_SHARE = 1e-6
"""Mass and inertia of a body between two joints of one body, as shares of that body's: too little to show, enough to be a body."""

DIGITS = 14
NEGLIGIBLE = 1e-15

Model = Any
"""An `mjModel`, or MuJoCo itself: of a package that is optional."""

DriveOf = dict[str, KnownDrive]


def draft_of_model(path: Path, name: str, rate: Value) -> tuple[Draft, DriveOf]:
    """Read a model.

    Returns
    -------
    Draft, dict
        Bodies and axes; and what the model says of each axis's drive.

    Raises
    ------
    UnusableInputError
        MuJoCo is missing or refuses the file, or the model has a joint or an actuator that no machine file can say.
    """
    mujoco = extra_package("mujoco", "MJCF and URDF models")
    model, is_urdf = _compiled(mujoco, path)
    names = _Names(model)
    bodies = _bodies(model, names, path)
    joints = {joint["name"].value: str(joint["type"].value) for body in bodies if (joint := body.joint) is not None}
    if not joints:
        raise UnusableInputError(f"{path}: no body of it has a joint; a machine needs one that moves")
    axes, drives, left = _axes(mujoco, model, names, path, is_urdf)
    for count, words in (
        (model.neq, "equality constraints"),
        (model.nflex, "flexes"),
        (model.nsensor, "sensors"),
        (model.nkey, "keyframes"),
    ):
        if count:
            left.append(f"{count} {words}")
    if model.ngeom and not is_urdf:
        left.append("shapes and contacts")
    gravity = Value(_plain(model.opt.gravity))
    return Draft(name, "", path.name, rate, gravity, bodies, axes, left), drives


def _compiled(mujoco: Model, path: Path) -> tuple[Model, bool]:
    try:
        text = path.read_text(encoding="utf-8")
        root = ElementTree.fromstring(text)
    except OSError as error:
        raise UnusableInputError(f"{path}: cannot be read: {error.strerror}") from None
    except (UnicodeDecodeError, ElementTree.ParseError) as error:
        raise UnusableInputError(f"{path}: is no XML: {error}") from None
    if root.tag not in ("mujoco", "robot"):
        raise UnusableInputError(f"{path}: is <{root.tag}>; a model is <mujoco> (MJCF) or <robot> (URDF)")
    is_urdf = root.tag == "robot"
    try:
        if not is_urdf:
            return mujoco.MjModel.from_xml_path(str(path)), False
        for link in root.iter("link"):  # their inertia is written: meshes, which are seldom beside the file, add nothing
            if link.find("inertial") is not None:
                for shape in (*link.findall("visual"), *link.findall("collision")):
                    link.remove(shape)
        return mujoco.MjModel.from_xml_string(ElementTree.tostring(root, encoding="unicode")), True
    except ValueError as error:
        raise UnusableInputError(f"{path}: MuJoCo refuses it: {' '.join(str(error).split())}") from None


class _Names:
    """Names of the machine file for the model's elements, each once."""

    def __init__(self, model: Model) -> None:
        self._model = model
        self._taken: dict[str, set[str]] = {}

    def of(self, kind: str, index: int, fallback: str) -> str:
        plain = re.sub(r"\W", "_", getattr(self._model, kind)(index).name, flags=re.ASCII) or fallback
        plain = plain if plain[0].isascii() and plain[0].isalpha() else f"{kind}_{plain}".replace("__", "_")
        taken = self._taken.setdefault(kind, {"world"} if kind == "body" else set())
        name, count = plain[:60], 1
        while name in taken:
            count += 1
            name = f"{plain[:55]}_{count}"
        taken.add(name)
        return name


def _bodies(model: Model, names: _Names, path: Path) -> list[DraftBody]:
    """Return the bodies; where one has several joints, a body of next to no mass stands between two of them."""
    found: list[DraftBody] = []
    name_of = {0: "world"}
    origin = {0: np.zeros(3)}  # of the machine file's frame, in the model's
    for index in range(1, model.nbody):
        name = name_of[index] = names.of("body", index, f"body_{index}")
        parent = int(model.body_parentid[index])
        joints = range(model.body_jntadr[index], model.body_jntadr[index] + model.body_jntnum[index])
        turn = Rotation.from_quat(model.body_quat[index], scalar_first=True)
        at, above = model.body_pos[index] - origin[parent], name_of[parent]
        place = {"position_m": Value(_plain(at)), "orientation_rad": Value(_plain(_angles(turn)))}
        origin[index] = np.zeros(3)
        mass, inertia = float(model.body_mass[index]), _inertia(model, index)
        for number, joint in enumerate(joints):
            anchor = np.array(model.jnt_pos[joint])
            if number == 0:
                place["position_m"] = Value(_plain(at + turn.apply(anchor)))
            else:
                place = {"position_m": Value(_plain(anchor - origin[index]))}
            origin[index] = anchor
            table = _joint(model, names, joint, path)
            if number + 1 < len(joints):
                small = {"mass_kg": Value(SPLIT_SHARE * mass, "next to none"), "inertia_kg_m2": Value(_plain(SPLIT_SHARE * inertia), "so")}
                between = f"{name}_{number + 1}"
                found.append(DraftBody(between, above, place | small, table))
                above = between
            else:
                found.append(DraftBody(name, above, place | _masses(model, index, mass, inertia, origin[index]), table))
        if not joints:
            found.append(DraftBody(name, above, place | _masses(model, index, mass, inertia, origin[index]), None))
    for body in found:
        if body.values.get("orientation_rad") == Value([0.0, 0.0, 0.0]):
            del body.values["orientation_rad"]
    return found


def _masses(model: Model, index: int, mass: float, inertia: np.ndarray, origin: np.ndarray) -> dict[str, Value]:
    centre = Value(_plain(model.body_ipos[index] - origin))
    return {"mass_kg": Value(mass), "center_of_mass_m": centre, "inertia_kg_m2": Value(_plain(inertia))}


def _inertia(model: Model, index: int) -> np.ndarray:
    """Return Ixx, Iyy, Izz, Ixy, Ixz, Iyz about the centre of mass, in the body's frame."""
    turn = Rotation.from_quat(model.body_iquat[index], scalar_first=True).as_matrix()
    whole = turn @ np.diag(model.body_inertia[index]) @ turn.T
    return np.array([*np.diag(whole), whole[0, 1], whole[0, 2], whole[1, 2]])


def _joint(model: Model, names: _Names, joint: int, path: Path) -> dict[str, Value]:
    kind = KINDS.get(int(model.jnt_type[joint]))
    name = names.of("joint", joint, f"joint_{joint}")
    if kind is None:
        raise UnusableInputError(f"{path}: joint {name} is a free or ball joint; a machine's turn about one axis or slide: hinge or slide")
    place, freedom = int(model.jnt_qposadr[joint]), int(model.jnt_dofadr[joint])
    damping, stiffness, rest = ("Nm_s_rad", "Nm_rad", "rad") if kind == "revolute" else ("N_s_m", "N_m", "m")
    table = {"name": Value(name), "type": Value(kind), "axis": Value(_plain(model.jnt_axis[joint]))}
    spring = float(np.ravel(model.jnt_stiffness[joint])[0])
    if spring:
        table[f"stiffness_{stiffness}"] = Value(spring)
        if unloaded := float(model.qpos_spring[place] - model.qpos0[place]):
            table[f"rest_position_{rest}"] = Value(unloaded)
    return table | {f"damping_{damping}": Value(float(np.ravel(model.dof_damping[freedom])[0]))}


def _axes(mujoco: Model, model: Model, names: _Names, path: Path, is_urdf: bool) -> tuple[list[DraftAxis], DriveOf, list[str]]:
    """Return an axis for each actuator at a joint; for each joint where there is none."""
    axes: list[DraftAxis] = []
    drives: DriveOf = {}
    left: list[str] = []
    joint_names = _joint_names(model)
    driven: set[int] = set()
    for actuator in range(model.nu):
        name = names.of("actuator", actuator, f"axis_{actuator}")
        joint = int(model.actuator_trnid[actuator][0])
        if int(model.actuator_trntype[actuator]) != int(mujoco.mjtTrn.mjTRN_JOINT) or joint in driven:
            left.append(f"actuator {name}, which is not the only one of a joint")
            continue
        gear = float(model.actuator_gear[actuator][0])
        if gear <= 0.0:
            raise UnusableInputError(f"{path}: actuator {name} has a gear of {gear:g}; turn its joint's axis round and make it positive")
        driven.add(joint)
        is_plain = not model.actuator_biastype[actuator] and not model.actuator_gaintype[actuator]
        if not is_plain:
            left.append(f"the servo loop of actuator {name}: its drive is commanded in effort here")
        factor = float(model.actuator_gainprm[actuator][0]) if is_plain else 1.0
        span = model.actuator_ctrlrange if is_plain else model.actuator_forcerange
        is_limited = (model.actuator_ctrllimited if is_plain else model.actuator_forcelimited)[actuator]
        limit = factor * float(span[actuator][1]) if is_limited else None
        _add(axes, drives, model, name, joint, joint_names[joint], gear, limit)
    if not axes:
        for joint in range(model.njnt):
            limited = getattr(model, "jnt_actfrclimited", np.zeros(model.njnt))[joint]
            limit = float(model.jnt_actfrcrange[joint][1]) if limited else None
            _add(axes, drives, model, joint_names[joint], joint, joint_names[joint], None, limit)
        if not is_urdf:
            left.append("nothing is said of actuators: every joint has a drive here")
    return axes, drives, left


def _joint_names(model: Model) -> list[str]:
    fresh = _Names(model)
    return [fresh.of("joint", joint, f"joint_{joint}") for joint in range(model.njnt)]


def _add(
    axes: list[DraftAxis], drives: DriveOf, model: Model, name: str, joint: int, joint_name: str, gear: float | None, limit: float | None
) -> None:
    place, freedom = int(model.jnt_qposadr[joint]), int(model.jnt_dofadr[joint])
    span = model.jnt_range[joint] - model.qpos0[place] if model.jnt_limited[joint] else None
    axes.append(DraftAxis(name, joint_name, KINDS[int(model.jnt_type[joint])]))
    drives[name] = KnownDrive(
        ratio=gear,
        armature=float(model.dof_armature[freedom]),
        limit=limit,
        range=None if span is None else (float(span[0]), float(span[1])),
    )


def _angles(turn: Rotation) -> np.ndarray:
    import warnings

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of two axes that coincide: any split of their angle is right
        angles: np.ndarray = turn.as_euler("xyz")
    return angles


def _plain(values: np.ndarray) -> list[float]:
    """Return numbers without the last digits, in which rounding shows."""
    largest = float(np.abs(values).max(initial=0.0))
    return [0.0 if abs(value) <= NEGLIGIBLE * largest else float(f"{value:.{DIGITS}g}") for value in values.tolist()]
