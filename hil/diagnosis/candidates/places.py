"""What the places of a machine did in the recordings: what laws of effects begin from."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hil.diagnosis.residuals.trajectory import Motion, Signals, Trajectory
from virtual_bus.effects.effect import TRANSMISSION, Effect
from virtual_bus.effects.law import Place
from virtual_bus.effects.places import imu_channel_names, joint_at, joint_of_place


def joint_of(effect: Effect, at: str, trajectory: Trajectory) -> int | None:
    """Return the number of the joint that an effect acts at; None for a sensor that no joint carries."""
    name = joint_of_place(effect.kind, at, trajectory.settings)
    return None if name is None else trajectory.joints.index(name)


def place_of(
    effect: Effect, at: str, trajectories: Sequence[Trajectory], motions: Sequence[Motion], signals: Sequence[Signals],
    missing: Sequence[np.ndarray], inertias: np.ndarray,
) -> Place:  # fmt: skip
    """Return what one place did, over all recordings together.

    Parameters
    ----------
    missing : sequence of (1 + D, N, n) arrays
        How much the recordings ask for further efforts on the joints, one array a recording; then how much noise does, drawn D times.
    inertias : (n,) array
        Of what moves with each joint.
    """
    first = trajectories[0]
    settings = first.settings
    joint = joint_of(effect, at, first)
    axis = next((k for k, drive in enumerate(settings.drives) if drive.axis == at), None)
    j = 0 if joint is None else joint
    of_motor = effect.kind is TRANSMISSION  # its law is one of the motor's position; what it does shows at the spring behind
    moving = first.joints.index(joint_at(at, settings)) if of_motor else j
    position = np.concatenate([motion.position[:, moving] for motion in motions])
    speed = np.concatenate([motion.speed[:, moving] for motion in motions])
    effort = np.concatenate([each.needed[:, j] for each in signals])
    short = np.concatenate([each[:, :, j] for each in missing], axis=1)
    current = 0.0 if axis is None else max(float(np.abs(trajectory.observed.targets[:, axis]).max()) for trajectory in trajectories)
    lowest, highest = np.quantile(position, [0.0, 1.0])
    if effect.kind.needs == "spring" and not of_motor:
        largest = max(abs(float(lowest)), abs(float(highest)))
        lowest, highest = -largest, largest
    return Place(
        low=float(lowest),
        high=float(highest),
        speed=max(float(np.quantile(np.abs(speed), 0.995)), 1e-9),
        effort=max(float(np.sqrt(np.mean(effort**2))), 1e-12),
        current=current,
        ratio=1.0 if axis is None else settings.drives[axis].ratio,
        stiffness=settings.tree.joints[j].stiffness,
        inertia=float(inertias[j]),
        period_s=first.observed.period_s,
        duration_s=max(float(trajectory.observed.time[-1]) for trajectory in trajectories),
        is_seen_twice=joint is not None and _seen_twice(first, joint),
        is_prismatic=settings.tree.joints[moving].kind == "prismatic",
        position=position,
        missing=short[0],
        noise=short[1:],
    )


def _seen_twice(trajectory: Trajectory, joint: int) -> bool:
    """Return whether an encoder beyond the motor's, on the link or with the next joints, or an IMU reads what a joint does, too."""
    channels = set(trajectory.observed.channels)
    name = trajectory.joints[joint]
    read = [encoder for encoder in trajectory.settings.encoders if name in encoder.joints and encoder.channel in channels]
    return len(read) > 1 or any(len(encoder.joints) > 1 for encoder in read) or bool(channels & set(imu_channel_names(trajectory.settings)))
