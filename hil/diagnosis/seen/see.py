"""What recordings show by themselves: motions, and the efforts that the machine file's equations lack along them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from hil.diagnosis.observed.groups import Group, groups
from hil.diagnosis.observed.in_readings import ShownAt, shown_by_readings
from hil.diagnosis.observed.rows import Observed, observed
from hil.diagnosis.result import NoiseKind
from hil.diagnosis.seen.along import Along
from hil.diagnosis.seen.assumed import assumed_levels, coarsest, efforts_by_encoders
from hil.diagnosis.seen.beside import Levels
from hil.diagnosis.seen.levels import repeat_levels
from hil.errors import RecordingError
from hil.machine import Machine
from hil.recording import Recording
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
        [s]; [rad or m]; per second; the drive's effort on the joint, and what of it the motion does not take [Nm or N].
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
class Seen:
    """Recordings of a machine beside its equations.

    Attributes
    ----------
    groups : tuple of Group
        Repeats together.
    alongs : tuple of Along
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
    alongs: tuple[Along, ...]
    levels: Levels
    by: int = 1
    shown: tuple[ShownAt, ...] = ()
    freely: bool = False

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
        first = self.alongs[0]
        driven = {drive.joint for drive in first.settings.drives}
        followed = {first.joints[joint] for joint in first.smooth}
        moved = set()
        for along in self.alongs:
            for joint, motion in along.smooth.items():
                if np.ptp(motion.position) > STANDSTILL * max(6.0 * motion.noise, _step(along, joint)):
                    moved.add(along.joints[joint])
        return [name for name in first.joints if name in driven & followed and name not in moved]

    @property
    def is_still(self) -> bool:
        """Whether nothing moves."""
        first = self.alongs[0]
        return set(self.still) >= {first.joints[joint] for joint in first.smooth} & {drive.joint for drive in first.settings.drives}

    def missing(self) -> list[Missing]:
        """Return what the machine file's equations lack on every driven joint that an encoder follows."""
        found = []
        for along in self.alongs:
            motion, given, left = efforts_by_encoders(along)
            driven = {drive.joint for drive in along.settings.drives}
            for joint in along.smooth:
                if along.joints[joint] in driven and joint not in along.imposed:
                    columns = (motion.position, motion.speed, given, left)
                    values = (each[:, joint] for each in columns)
                    found.append(Missing(along.observed.name, along.joints[joint], along.observed.time, *values))
        return found

    def said_by(self, values: np.ndarray, effects: Sequence[EffectSetting]) -> list[np.ndarray]:
        """Return what other numbers and effects say of the efforts (N,) in `missing`, in the same order."""
        found = []
        for along, motion in ((along, efforts_by_encoders(along)[0]) for along in self.alongs):
            nominal = along.signals(motion, along.model())
            other = along.signals(motion, along.model(values, effects), effects)
            said = (other.needed - nominal.needed) - (other.given - nominal.given)
            driven = {drive.joint for drive in along.settings.drives}
            found += [said[:, joint] for joint in along.smooth if along.joints[joint] in driven and joint not in along.imposed]
        return found


def see(machine: Machine, recordings: Mapping[str, Recording], beside: Seen | None = None, *, freely: bool = False) -> Seen:
    """See what recordings of a machine show beside its equations.

    Parameters
    ----------
    machine : Machine
    recordings : mapping of str to Recording
    beside : Seen, optional
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
    found = groups(every, None if beside is None else beside.alongs[0].observed.channels)
    alongs = [Along(group.mean) for group in found]
    driven = {drive.joint for drive in machine.plant.drives}
    if machine.plant.drives and not driven & {alongs[0].joints[joint] for joint in alongs[0].smooth}:
        lacking = [name for name, one in recordings.items() if not any(each.channel in one for each in machine.plant.encoders)]
        name = (lacking or list(recordings))[0]
        raise RecordingError(f"{name}: no encoder of {machine.name} follows a driven joint by itself; record position_{machine.axes[0]}")
    if beside is not None:
        alongs = [Along(along.observed.coarser(beside.by)) for along in alongs]
        return Seen(found, tuple(alongs), beside.levels, beside.by, beside.shown, beside.freely)
    levels, by = None if freely else repeat_levels(found, alongs), 1
    if levels is None:
        by = coarsest(alongs)
        alongs = [Along(along.observed.coarser(by)) for along in alongs] if by > 1 else alongs
        levels = assumed_levels(alongs)
    return Seen(found, tuple(alongs), levels, by, shown, freely)


def with_imposed(one: Observed) -> Observed:
    """Return a recording with the efforts that imposed axes would take by the machine file.

    Raises
    ------
    RecordingError
        There is no sensor beside theirs that could tell anything.
    """
    if not one.imposed:
        return one
    along, axis = Along(one), one.imposed[0]
    if not set(along.imposed) <= set(along.smooth) or len(one.channels) <= len(along.smooth):
        needed = f"one of them is needed, or another sensor beside position_{axis}"
        raise RecordingError(f"{one.name}: neither command_{axis} nor a measured effort of {axis} is complete; {needed}")
    motion, given, missing = efforts_by_encoders(along)
    axes, targets = [one.machine.axis_index(name) for name in one.imposed], one.targets.copy()
    gains = along.plant.drive_gains(along.model(), motion.position[0])
    targets[:, axes] = (given - missing)[:, along.imposed] / gains[axes]
    return replace(one, targets=targets)


def _step(along: Along, joint: int) -> float:
    return max(encoder.resolution for encoder in along.settings.encoders if along.joints[joint] in encoder.joints)
