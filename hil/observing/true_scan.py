"""A motion of the emulated machine with what only the emulator knows of it: where detector, focal spot and axes really were."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from controllers.feedback import Feedback
from hil.experiments import Plan
from hil.machine import Machine
from hil.observing.geometry import observed_chain, placed_bodies
from hil.recording import Channel, Recording
from hil.simulation.simulate import imu_units
from virtual_bus.effects.registry import effect_number
from virtual_bus.physics import Physics
from virtual_bus.settings import EffectSetting

SETTLE_s = 2.0


@dataclass(frozen=True)
class TrueScan:
    """A recording and what only the emulator knows.

    Attributes
    ----------
    recording : Recording
    position, rotation : (N, 3), (N, 3, 3) of the detector
    source : (N, 3) focal spot
    motor, link : (N, axes) of the joints that an axis's two encoders look at
    """

    recording: Recording
    position: np.ndarray
    rotation: np.ndarray
    source: np.ndarray
    motor: np.ndarray
    link: np.ndarray


def true_scan(machine: Machine, plan: Plan, seed: int, pushes: Mapping[str, np.ndarray] | None = None) -> TrueScan:
    """Run a plan in closed loop on the emulated machine, after two seconds at rest.

    Parameters
    ----------
    machine : Machine
    plan : Plan
    seed : int
        Of the sensors' noise.
    pushes : mapping of str to (N,) array, optional
        Torques [Nm] at joints, from the beginning of the rest on.
    """
    pushes, geometry, settle = pushes or {}, machine.geometry, round(SETTLE_s * machine.sample_rate_Hz)
    assert geometry is not None
    still = Physics(machine.plant, noise=False)
    still.place(plan.start_pose)
    holding = still.holding_effort(plan.start_pose)
    bodies = {body.joint.name: body.name for body in machine.plant.tree.bodies if body.joint is not None}
    loads = tuple(EffectSetting("constant_load", bodies[joint], {"tau0": 0.0}) for joint in pushes)
    watched = tuple(dict.fromkeys((*machine.plant.watched_bodies, geometry.detector_body, geometry.source_body)))
    physics = Physics(replace(machine.plant, effects=(*machine.plant.effects, *loads), watched_bodies=watched), seed)
    table = physics.model["effort_rows"].reshape(-1, physics.model["effort_rows"].shape[-1])
    pushed = np.flatnonzero(table[:, 0] == effect_number("constant_load"))[-len(loads) :] if loads else np.zeros(0, dtype=int)
    torques = np.column_stack(list(pushes.values())) if pushes else np.zeros((settle + plan.rows, 0))
    physics.place(plan.start_pose)
    nothing = np.zeros(len(machine.axes))
    physics.set_brakes(nothing.astype(bool))
    feedback = Feedback(machine.controllers)
    feedback.preload(holding, plan.start_pose, nothing)
    step = np.array([drive.resolution for drive in machine.plant.drives])
    command, answer = holding.copy(), holding.copy()
    kept: dict[str, list[np.ndarray]] = {name: [] for name in ("position", "link", "imu", "command", "detector", "tube", "joints")}
    for k in range(settle + plan.rows):
        table[pushed, 1] = torques[k]
        physics.apply(np.where(step > 0.0, step * np.round(command / np.where(step > 0.0, step, 1.0)), command))
        latched, row = physics.latch(), max(k - settle, 0)
        feedback.step(plan.reference[row], latched.position, plan.excitation[row], nothing, answer)
        if k >= settle:
            truth = physics.truth()
            read = (latched.position, latched.link_position, latched.imu, answer, truth[f"pose_{geometry.detector_body}"])
            for values, value in zip(kept.values(), (*read, truth[f"pose_{geometry.source_body}"], truth["joint_position"]), strict=True):
                values.append(value.copy())
        command[:] = answer
        physics.advance()
    return _scan(machine, {name: np.array(values) for name, values in kept.items()})


def _scan(machine: Machine, table: dict[str, np.ndarray]) -> TrueScan:
    geometry, tree = machine.geometry, machine.plant.tree
    assert geometry is not None
    channels = {"time": Channel("s", np.arange(len(table["command"])) / machine.sample_rate_Hz)}
    for i, units in enumerate(machine.units):
        channels[f"command_{units.axis}"] = Channel(units.effort, table["command"][:, i])
        channels[f"position_{units.axis}"] = Channel(units.position, table["position"][:, i])
        channels[f"link_position_{units.axis}"] = Channel(units.position, table["link"][:, i])
    for (name, unit), values in zip(imu_units(machine).items(), table["imu"].T, strict=True):
        channels[name] = Channel(unit, values)
    detector, tube, joints = table["detector"], table["tube"], table["joints"]
    rotation = detector[:, 3:].reshape(-1, 3, 3)
    center = detector[:, :3] + rotation @ geometry.detector_center_m
    source = tube[:, :3] + tube[:, 3:].reshape(-1, 3, 3) @ geometry.source_position_m
    seen = {encoder.channel: [tree.joint_index(name) for name in encoder.joints] for encoder in machine.plant.encoders}
    motor, link = (
        np.column_stack([joints[:, seen[f"{prefix}_{axis}"]].sum(axis=1) for axis in machine.axes])
        for prefix in ("position", "link_position")
    )
    return TrueScan(Recording(channels, {}), center, rotation, source, motor, link)


def nominal_pose(machine: Machine, axes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return detector position (N, 3) and rotation (N, 3, 3) of the rigid machine with its axes at (N, n)."""
    chain, sensors, _, _ = observed_chain(machine)
    turn = Rotation.identity(len(axes))
    position = np.zeros((len(axes), 3))
    for i in range(axes.shape[1]):
        position = position + turn.apply(chain.points[i])
        turn = turn * Rotation.from_rotvec(axes[:, i : i + 1] * chain.axes[i])
    return position + turn.apply(sensors[0].body_end_m), turn.as_matrix()


def nine(position: np.ndarray, rotation: np.ndarray, source: np.ndarray, isocenter: np.ndarray) -> np.ndarray:
    """Return the nine parameters (N, 9) of detectors (N, 3), (N, 3, 3) and focal spots (N, 3)."""
    inside = [np.einsum("nji,nj->ni", rotation, point - position) for point in (source, isocenter)]
    return np.hstack([*inside, Rotation.from_matrix(rotation).as_euler("xyz")])


def published_truth(machine: Machine, scan: TrueScan) -> np.ndarray:
    """Return the truth (N, values) of all that an observer publishes, in the order of its values."""
    position, rotation = nominal_pose(machine, scan.motor)
    _, _, _, isocenter = observed_chain(machine)
    world = placed_bodies(machine.plant.tree.bodies)[machine.geometry.detector_body][1]  # type: ignore[union-attr]
    center, source, turned = scan.position @ world, scan.source @ world, world.T @ scan.rotation  # in the chain's frame
    shift = np.einsum("nji,nj->ni", rotation, center - position)
    turn = (Rotation.from_matrix(rotation).inv() * Rotation.from_matrix(turned)).as_rotvec()
    displaced = np.hstack([shift, turn])
    moves = np.gradient(displaced, 1.0 / machine.sample_rate_Hz, axis=0)
    return np.hstack([scan.motor, scan.link, displaced, moves, nine(center, turned, source, isocenter)])
