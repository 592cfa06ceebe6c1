"""A machine's closed loop at one pose, from reference to motion, as the path for which a shaper is designed."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import scipy.linalg
import scipy.signal

from controllers.errors import DesignError
from controllers.settings import AxisController
from controllers.shapers.dynamics import Dynamics
from hil.machine import Machine
from virtual_bus.linear.plant import LinearPlant
from virtual_bus.linear.sampled import SampledPlant, sampled
from virtual_bus.physics import Physics

if TYPE_CHECKING:
    import control

OUTPUTS = ("link", "detector", "motor")

STEP = 1e-5
"""Joint displacement [rad or m] for the detector's Jacobian by central differences, whose error is about 1e-10."""


def closed_loop(machine: Machine, pose: np.ndarray, axis: str, output: str = "link", physics: Physics | None = None) -> Dynamics:
    """Return the path from an axis's reference to a position, linear about rest at a pose, with the loop's sampling.

    Timing: docs/explanation/notation.md. The path is scaled to DC gain 1: calibration, not the shaper, corrects the deflection by gravity
    at another pose.

    Parameters
    ----------
    machine : Machine
        With a controller.
    pose : (n_axes,) array
    axis : str
    output : str
        "detector": displacement of the detector's centre along the path on which this axis alone would carry it, over its lever arm, so in
        the axis's own unit; "link": behind the gear, where the link encoder is; "motor": the encoder the loop is closed on.
    physics : Physics, optional
        Of this machine, where it is already compiled.

    Raises
    ------
    DesignError
        The machine has no controller or no detector, or this axis does not move the detector.
    """
    if not machine.controllers:
        raise DesignError(f"{machine.name} has no controller, so no closed loop whose reference could be shaped")
    if output not in OUTPUTS:
        raise DesignError(f"output {output!r}: must be one of {', '.join(OUTPUTS)}")
    physics = physics or Physics(machine.plant, noise=False)
    index = machine.axis_index(axis)
    if output == "detector":
        jacobian = _detector_jacobian(machine, physics, pose)
        path = jacobian[:, physics.plant.joint_of_axis()[axis]]
        if not np.linalg.norm(path) > 1e-6:
            raise DesignError(f"{axis} does not move the detector's centre at {np.round(pose, 4).tolist()}; take output link")
        row = path @ jacobian / (path @ path)
    else:
        name = f"{'link_' if output == 'link' else ''}position_{axis}"
        encoder = next((each for each in machine.plant.encoders if each.channel == name), None)
        if encoder is None:
            raise DesignError(f"{machine.name} has no encoder {name}")
        row = np.array([float(joint.name in encoder.joints) for joint in machine.plant.tree.joints])
    return unit_gain(_of_joints(machine, physics, pose, index, row[None, :])[0])


def unit_gain(path: Dynamics) -> Dynamics:
    """Return the same path with a DC gain of 1."""
    return path.scaled(1.0 / complex(path.response(0.0)).real)


def detector_paths(machine: Machine, pose: np.ndarray, axis: str, physics: Physics) -> tuple[Dynamics, ...]:
    """Return paths from an axis's reference to the x, y, z displacement of the detector's centre [m]; without a detector, of the link."""
    if machine.geometry is None or machine.geometry.detector_body not in machine.plant.watched_bodies:
        return (closed_loop(machine, pose, axis, "motor", physics),)
    return tuple(_of_joints(machine, physics, pose, machine.axis_index(axis), _detector_jacobian(machine, physics, pose)))


def loops_around(machine: Machine, plant: control.StateSpace, axis: str, outputs: Sequence[str]) -> list[Dynamics]:
    """Return closed loops from one axis's reference to named outputs of a continuous plant model, for instance an identified one.

    Parameters
    ----------
    machine : Machine
        Its controllers close the loop.
    plant : control.StateSpace
        From the commands as the drives apply them, `command_<axis>`, to at least the motor positions `position_<axis>`.
    axis : str
    outputs : sequence of str

    Raises
    ------
    DesignError
        A command or output is missing.
    """
    inputs = [_index(plant.input_labels, f"command_{name}", "input") for name in machine.axes]
    positions = [_index(plant.output_labels, f"position_{name}", "output") for name in machine.axes]
    wanted = [_index(plant.output_labels, name, "output") for name in outputs]
    names = [plant.output_labels[k] for k in (*positions, *wanted)]
    identified = LinearPlant(
        plant.A, plant.B[:, inputs], plant.C, plant.D[:, inputs], tuple(plant.input_labels[k] for k in inputs),
        tuple(plant.output_labels), tuple(plant.state_labels), np.zeros(len(inputs)), np.zeros(len(plant.C)), len(plant.A),
    )  # fmt: skip
    met = sampled(identified, 1.0 / machine.sample_rate_Hz, names)
    return _loops(machine, met, machine.axis_index(axis), met.c[: len(positions)], met.c[len(positions) :])


def _of_joints(machine: Machine, physics: Physics, pose: np.ndarray, axis: int, joints: np.ndarray) -> list[Dynamics]:
    """Return closed loops from one axis's reference to combinations of joint positions, rows (k, joints)."""
    plant = physics.sampled(pose, [f"position_{name}" for name in machine.axes])
    rows = np.hstack([joints, np.zeros((len(joints), len(plant.a) - joints.shape[1]))])  # joint positions are its first states
    return _loops(machine, plant, axis, plant.c, rows)


def _loops(machine: Machine, plant: SampledPlant, axis: int, measured: np.ndarray, rows: np.ndarray) -> list[Dynamics]:
    """Close the loops over the plant's states, then those of C_y and of a separate C_r.

    `measured` (axes, N) and `rows` (k, N) are positions and outputs over the plant's states.
    """
    laws = [_law(controller) for controller in machine.controllers]
    n = len(plant.a)
    total = n + sum(len(law.a) for law in laws)
    loop, entering = np.zeros((total, total)), np.zeros(total)
    loop[:n, :n] = plant.a
    start = n
    for number, law in enumerate(laws):
        own, b = slice(start, start + len(law.a)), plant.b[:, number]
        loop[own, own] = law.a
        loop[own, :n] = np.outer(law.from_position, measured[number])
        loop[:n, own] += np.outer(b, law.c)
        loop[:n, :n] += law.position_through * np.outer(b, measured[number])
        if number == axis:
            entering[own] = law.from_reference
            entering[:n] += law.reference_through * b
        start += len(law.a)
    seen = np.hstack([rows, np.zeros((len(rows), total - n))])
    return [Dynamics(loop, entering, row, 0.0, plant.period_s) for row in seen]


class _Law(NamedTuple):
    """A controller from reference and position to its command, in state space."""

    a: np.ndarray
    from_reference: np.ndarray
    from_position: np.ndarray
    c: np.ndarray
    reference_through: float
    position_through: float


def _law(controller: AxisController) -> _Law:
    """Return C_r r - C_y y with the last sections that both have in common once: two integrators beside each other are not stable."""
    of_position, of_reference = controller.position_sections, controller.reference_sections
    if of_reference is None:
        a, b, c, d = _state_space(of_position)
        return _Law(a, b, -b, c, d, -d)
    common = 0
    while common < min(len(of_position), len(of_reference)) and (of_position[-1 - common] == of_reference[-1 - common]).all():
        common += 1
    fr, gr, hr, dr = _state_space(of_reference[: len(of_reference) - common])
    fy, gy, hy, dy = _state_space(of_position[: len(of_position) - common])
    f, g, h, d = _state_space(of_position[len(of_position) - common :])
    difference = np.concatenate([hr, -hy])
    a = scipy.linalg.block_diag(fr, fy, f)
    before = len(fr) + len(fy)
    a[before:, :before] = np.outer(g, difference)
    return _Law(
        a,
        np.concatenate([gr, np.zeros(len(fy)), dr * g]),
        np.concatenate([np.zeros(len(fr)), gy, -dy * g]),
        np.concatenate([d * difference, h]),
        d * dr,
        -d * dy,
    )


def _detector_jacobian(machine: Machine, physics: Physics, pose: np.ndarray) -> np.ndarray:
    """Return the displacement (3, joints) of the detector's centre per joint, by central differences."""
    geometry = machine.geometry
    if geometry is None or geometry.detector_body not in machine.plant.watched_bodies:
        raise DesignError(f"{machine.name} has no [geometry] with a detector; take output link or motor")
    body = machine.plant.watched_bodies.index(geometry.detector_body)
    rest = np.zeros(physics.plant.joints)
    rest[list(physics.plant.joint_of_axis().values())] = pose

    def centre(q: np.ndarray) -> np.ndarray:
        found = physics.plant.body_poses(physics.model, q)[body]
        place: np.ndarray = found[:3] + found[3:].reshape(3, 3) @ geometry.detector_center_m
        return place

    shifts = STEP * np.eye(len(rest))
    return np.array([(centre(rest + shift) - centre(rest - shift)) / (2.0 * STEP) for shift in shifts]).T


def _state_space(sections: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """Return a cascade in state space; of no sections, what passes everything on."""
    if not len(sections):
        return np.zeros((0, 0)), np.zeros(0), np.zeros(0), 1.0
    zeros, poles, gain = scipy.signal.sos2zpk(sections)
    both = min(int(np.count_nonzero(zeros == 0.0)), int(np.count_nonzero(poles == 0.0)))  # sections of first order bring one of each
    zeros, poles = (np.concatenate([roots[roots != 0.0], np.zeros(np.count_nonzero(roots == 0.0) - both)]) for roots in (zeros, poles))
    a, b, c, d = scipy.signal.zpk2ss(zeros, poles, gain)
    return a, np.asarray(b).reshape(-1), np.asarray(c).reshape(-1), float(np.asarray(d).reshape(-1)[0])


def _index(labels: list[str], wanted: str, what: str) -> int:
    if wanted in labels:
        return labels.index(wanted)
    raise DesignError(f"{what} {wanted!r}: the system has {', '.join(labels)}")
