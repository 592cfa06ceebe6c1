"""What recordings show by themselves: motions, and the efforts that the machine file's equations lack along them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from hil.diagnosis.observed.groups import Group, groups
from hil.diagnosis.observed.in_readings import ShownAt, shown_by_readings
from hil.diagnosis.observed.rows import Observed, observed
from hil.diagnosis.residuals.assumed_noise import assumed_levels, coarsest, efforts_by_encoders
from hil.diagnosis.residuals.equation_errors import Levels
from hil.diagnosis.residuals.repeat_noise import repeat_levels
from hil.diagnosis.residuals.trajectory import Trajectory
from hil.diagnosis.result import NoiseKind
from hil.errors import RecordingError
from hil.machine import Machine
from hil.recording import Recording, means_between_rows
from virtual_bus.settings import EffectSetting

STANDSTILL = 3.0
"""Range of a position, in units of what its sensor's noise and lattice make of standstill, up to which a joint did not move."""


@dataclass(frozen=True, eq=False)
class Missing:
    """What one joint's equation lacks along one recording.

    Attributes
    ----------
    recording, joint : str
    time, position, speed, given, missing : (N,) arrays
        Between rows: [s]; [rad or m]; per second; the drive's mean effort on the joint, and what of it no motion takes [Nm or N].
    """

    recording: str
    joint: str
    time: np.ndarray
    position: np.ndarray
    speed: np.ndarray
    given: np.ndarray
    missing: np.ndarray

    @property
    def share(self) -> float:
        """Rms of what is missing over that of the effort; 1 where no effort was given, and 0 where nothing is missing."""
        given, missing = float(np.mean(self.given**2)), float(np.mean(self.missing**2))
        return float(np.sqrt(missing / given)) if given > 0.0 else float(missing > 0.0)


@dataclass(frozen=True, eq=False)
class Residuals:
    """Recordings of a machine beside its equations.

    Attributes
    ----------
    groups : tuple of Group
        Repeats together.
    trajectories : tuple of Trajectory
        One a group.
    levels : Levels
        Noise along the motion: from repeats, or assumed.
    by : int
        Recorded rows that are one row here.
    shown : tuple of ShownAt
        What readings show by themselves: held ones are left out, and coarser lattices known.
    freely : bool
        Whether free runs judge, which know their noise from repeats.
    """

    groups: tuple[Group, ...]
    trajectories: tuple[Trajectory, ...]
    levels: Levels
    by: int = 1
    shown: tuple[ShownAt, ...] = ()
    freely: bool = False

    @property
    def machine(self) -> Machine:
        """The simulation that they are seen beside."""
        return self.trajectories[0].observed.machine

    @property
    def noise(self) -> NoiseKind:
        """From what the noise is known by which effects are judged."""
        repeated = [group for group in self.groups if len(group.repeats) > 1]
        if not repeated or (self.levels.are_assumed and not self.freely):
            return "assumed"
        return "periods" if all(group.are_periods for group in repeated) else "repeats"

    @property
    def still(self) -> list[str]:
        """The driven joints that encoders follow and no recording moves."""
        first = self.trajectories[0]
        driven = {drive.joint for drive in first.settings.drives}
        followed = {first.joints[joint] for joint in first.smooth}
        moved = set()
        for trajectory in self.trajectories:
            for joint, motion in trajectory.smooth.items():
                if np.ptp(motion.position) > STANDSTILL * max(6.0 * motion.noise, _step(trajectory, joint)):
                    moved.add(trajectory.joints[joint])
        return [name for name in first.joints if name in driven & followed and name not in moved]

    @property
    def is_still(self) -> bool:
        """Whether nothing moves."""
        first = self.trajectories[0]
        return set(self.still) >= {first.joints[joint] for joint in first.smooth} & {drive.joint for drive in first.settings.drives}

    def missing(self) -> list[Missing]:
        """Return what the machine file's equations lack on every driven joint that an encoder follows."""
        found = []
        for trajectory in self.trajectories:
            motion, given, left = efforts_by_encoders(trajectory)
            driven, of = {drive.joint for drive in trajectory.settings.drives}, trajectory.observed
            time_s, *motions, needed = map(means_between_rows, (of.time, motion.position, motion.speed, given - left))
            columns = (*motions, given[:-1], given[:-1] - needed)  # an effort is a mean from its row to the next
            for joint in trajectory.smooth:
                if trajectory.joints[joint] in driven and joint not in trajectory.imposed:
                    found.append(Missing(of.name, trajectory.joints[joint], time_s, *(each[:, joint] for each in columns)))
        return found

    def said_by(self, values: np.ndarray, effects: Sequence[EffectSetting]) -> list[np.ndarray]:
        """Return what other numbers and effects say of the efforts (N,) in `missing`, in the same order."""
        found = []
        for trajectory, motion in ((trajectory, efforts_by_encoders(trajectory)[0]) for trajectory in self.trajectories):
            nominal = trajectory.signals(motion, trajectory.model())
            other = trajectory.signals(motion, trajectory.model(values, effects), effects)
            said = means_between_rows(other.needed - nominal.needed) - (other.given - nominal.given)[:-1]
            driven = {drive.joint for drive in trajectory.settings.drives}
            found += [
                said[:, joint] for joint in trajectory.smooth if trajectory.joints[joint] in driven and joint not in trajectory.imposed
            ]
        return found


def residuals_of(
    machine: Machine, recordings: Mapping[str, Recording], nearby: Residuals | None = None, *, freely: bool = False
) -> Residuals:
    """See what recordings of a machine show beside its equations.

    Parameters
    ----------
    machine : Machine
    recordings : mapping of str to Recording
    nearby : Residuals, optional
        Others, on whose rows and by whose noise these are seen.
    freely : bool
        Whether free runs will judge: noise along the motion is then assumed, which is quick.

    Raises
    ------
    RecordingError
        Recordings that cannot be used.
    """
    read = [with_imposed(observed(machine, name, recording, may_be_imposed=True)) for name, recording in recordings.items()]
    every, shown = shown_by_readings(read)
    found = groups(every, None if nearby is None else nearby.trajectories[0].observed.channels)
    trajectories = [Trajectory(group.mean) for group in found]
    driven = {drive.joint for drive in machine.plant.drives}
    if machine.plant.drives and not driven & {trajectories[0].joints[joint] for joint in trajectories[0].smooth}:
        lacking = [name for name, one in recordings.items() if not any(each.channel in one for each in machine.plant.encoders)]
        name = (lacking or list(recordings))[0]
        raise RecordingError(f"{name}: no encoder of {machine.name} follows a driven joint by itself; record position_{machine.axes[0]}")
    if nearby is not None:
        trajectories = [Trajectory(trajectory.observed.coarser(nearby.by)) for trajectory in trajectories]
        return Residuals(found, tuple(trajectories), nearby.levels, nearby.by, nearby.shown, nearby.freely)
    levels, by = None if freely else repeat_levels(found, trajectories), 1
    if levels is None:
        by = coarsest(trajectories)
        trajectories = [Trajectory(trajectory.observed.coarser(by)) for trajectory in trajectories] if by > 1 else trajectories
        levels = assumed_levels(trajectories)
    return Residuals(found, tuple(trajectories), levels, by, shown, freely)


def with_imposed(one: Observed) -> Observed:
    """Return a recording with the efforts that imposed axes would take by the machine file.

    Raises
    ------
    RecordingError
        There is no sensor beside theirs that could tell anything.
    """
    if not one.imposed:
        return one
    trajectory, axis = Trajectory(one), one.imposed[0]
    if not set(trajectory.imposed) <= set(trajectory.smooth) or len(one.channels) <= len(trajectory.smooth):
        needed = f"one of them is needed, or another sensor beside position_{axis}"
        raise RecordingError(f"{one.name}: neither command_{axis} nor a measured effort of {axis} is complete; {needed}")
    motion, given, missing = efforts_by_encoders(trajectory)
    axes, targets = [one.machine.axis_index(name) for name in one.imposed], one.targets.copy()
    gains = trajectory.plant.drive_gains(trajectory.model(), motion.position[0])
    targets[:, axes] = (given - missing)[:, trajectory.imposed] / gains[axes]
    return replace(one, targets=targets)


def _step(trajectory: Trajectory, joint: int) -> float:
    return max(encoder.resolution for encoder in trajectory.settings.encoders if trajectory.joints[joint] in encoder.joints)
