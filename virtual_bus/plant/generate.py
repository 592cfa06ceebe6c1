"""The source of a plant's generated modules."""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass

import numpy as np

from virtual_bus.effects.dispatch import compiled_effects
from virtual_bus.plant.emit import Emitter
from virtual_bus.plant.equations import PlantEquations
from virtual_bus.plant.parameters import plant_parameters
from virtual_bus.settings import PlantSettings

HEADER = '''"""Generated from a tree of rigid bodies; do not edit."""

from math import cos, sin

from EFFECTS import effort_of, friction_of, limited_by, reaction_of, ripple_of, terms_of
from virtual_bus.plant import drives, integrator, readings, terms
from virtual_bus.compilation.jit import compiled_and_cached, compiled_inside
'''

ENTRY_POINTS = """
@compiled_inside
def add_terms(model, work):
    terms.add_efforts(effort_of, model, work)
    terms.add_pairs(terms_of, model, work)


@compiled_inside
def equations(model, work):
    mass_and_bias(model, work)
    if model.effort_count + model.pair_count > 0:
        add_terms(model, work)


@compiled_and_cached
def advance(state, effort, brakes, model, work):
    integrator.advance(
        AXIS_JOINTS, IMUS, equations, friction_of, reaction_of, limited_by, ripple_of, imu, state, effort, brakes, model[0], work[0]
    )


@compiled_and_cached
def joint_acceleration(state, effort, brakes, model, work):
    readings.joint_acceleration(
        AXIS_JOINTS, IMUS, equations, friction_of, reaction_of, limited_by, ripple_of, state, effort, brakes, model[0], work[0]
    )


@compiled_and_cached
def imu_reading(state, effort, brakes, model, work, reading):
    readings.imu_reading(
        AXIS_JOINTS, IMUS, equations, friction_of, reaction_of, limited_by, ripple_of, imu,
        state, effort, brakes, model[0], work[0], reading,
    )


@compiled_and_cached
def drive_currents(state, effort, model, currents):
    drives.drive_currents(AXIS_JOINTS, FIRST_DRIVE, limited_by, state, effort, model[0], currents)


@compiled_and_cached
def evaluate_gains(model, work):
    drives.drive_gains(AXIS_JOINTS, ripple_of, model[0], work[0])


@compiled_and_cached
def evaluate_imu(model, work):
    imu(model[0], work[0])


@compiled_and_cached
def evaluate_poses(model, work):
    poses(model[0], work[0])
"""

QUERY = "c = model.constants; q = work.query_position; v = work.query_speed; a = work.query_acceleration"


FEWEST_CONSTANTS = 32
"""Room for the derived constants of any small machine. It doubles where more are needed: plants with records of the same size share what is
compiled for the records alone."""


@dataclass(frozen=True)
class PlantText:
    """Sources of a plant's compiled module and of what derives its equations' constants, and the room that these have.

    They are apart because plants that differ only in how their constants follow from their parameters share their machine code.
    """

    text: str
    derive: str
    constant_count: int


_written: dict[Hashable, PlantText] = {}
KEPT = 16
"""Plants of so many structures. To write one out takes 20 ms; a diagnosis or a design asks for hundreds that differ in numbers alone."""


def plant_text(settings: PlantSettings) -> PlantText:
    """Write out the equations of a plant, or return what was written for another one that differs in the values of its parameters alone.

    The module's `mass_and_bias(model, work)` (`equations` with the effects' terms), `imu(model, work)` and `poses(model, work)` evaluate
    them at work.query_position, query_speed and query_acceleration: into work.mass (lower half) and bias, into reading, and into poses.
    `derive(p, c)` computes model.constants from the parameters, and is not compiled. The rest is the calling convention of `compiled.py`.
    """
    structure = structure_of(settings)
    written = _written.get(structure)
    if written is None:
        if len(_written) >= KEPT:
            _written.clear()
        written = _written[structure] = _write(settings)
    return written


def structure_of(settings: PlantSettings) -> Hashable:
    """Return all of a plant that its text depends on."""
    tree = settings.tree
    return (
        tuple(parameter.name for parameter in plant_parameters(settings)),
        tuple((body.name, body.parent, _bytes(body.orientation), body.joint is None) for body in tree.bodies),
        tuple((joint.name, joint.kind, _bytes(joint.axis)) for joint in tree.joints),
        tuple(drive.joint for drive in settings.drives),
        tuple((imu.name, imu.body, _bytes(imu.orientation)) for imu in settings.imus),
        tuple(settings.watched_bodies),
    )


def _bytes(values: np.ndarray) -> bytes:
    return np.asarray(values, dtype=float).tobytes()


def _write(settings: PlantSettings) -> PlantText:
    equations = PlantEquations(settings, tuple(parameter.name for parameter in plant_parameters(settings)))
    emitter = Emitter()
    count = len(settings.tree.joints)
    inertia = equations.inertia()
    masses = [(f"work.mass[{i}, {j}]", inertia.get((i, j), equations.graph.zero)) for i in range(count) for j in range(i + 1)]
    biases = [(f"work.bias[{i}]", node) for i, node in enumerate(equations.bias())]
    channels = [node for imu in settings.imus for node in equations.imu(imu)]
    readings = [(f"work.reading[{k}]", node) for k, node in enumerate(channels)]
    poses = [
        (f"work.poses[{i}, {k}]", node) for i, body in enumerate(settings.watched_bodies) for k, node in enumerate(equations.pose(body))
    ]
    axis_joints = tuple(settings.tree.joint_index(drive.joint) for drive in settings.drives)
    parts = [
        HEADER.replace("EFFECTS", compiled_effects().__name__),
        f"AXIS_JOINTS = {axis_joints!r}\nIMUS = {len(settings.imus)}\nFIRST_DRIVE = {4 * count + 6 * len(settings.imus) + 1}\n",
        emitter.function_text("mass_and_bias", masses + biases, QUERY),
        emitter.function_text("imu", readings, QUERY),
        emitter.function_text("poses", poses, QUERY),
    ]
    derive = emitter.derive_text()
    room = max(FEWEST_CONSTANTS, 1 << (emitter.constant_count - 1).bit_length())
    return PlantText("\n\n".join(parts) + "\n" + ENTRY_POINTS, derive, room)
