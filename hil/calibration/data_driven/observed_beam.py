"""An observer's account of a machine's geometry at every sample, from the estimates in a recording: its fast part, and the load.

At rest an accelerometer cannot distinguish a machine that is bent from one with mounting offsets, and an observer that knows only the
drawing's geometry mistakes one for the other: milliradians, on a real machine. So what changes more slowly than the motion of a scan is
left to the quasi-static parameters, which images determine; the observer's estimate counts from `SLOW_Hz` on.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.signal import butter, sosfiltfilt
from scipy.spatial.transform import Rotation

from hil.errors import UnusableInputError
from hil.imaging.geometry import ConeBeam
from hil.imaging.nominal import nominal_beam
from hil.machine import Machine
from hil.recording import Recording

FLOOR_M, FLOOR_RAD = 10e-6, 100e-6
"""Least deviations: an observer's own variances leave out its model's errors and some of slow bending."""

UNOBSERVED_M, UNOBSERVED_RAD = 50e-6, 200e-6
"""How far the detector swings in a scan without disturbances, where no observer estimates it."""


SLOW_Hz, ORDER = 0.3, 3
"""A scan's poses change in seconds, the slowest mode swings at 8 Hz and is pushed from 1 Hz on."""

PAD_S = 5.0
"""A recording begins and ends at standstill; it is continued by that on either side."""


@dataclass(frozen=True)
class ObservedBeam:
    """Geometry at N samples.

    Attributes
    ----------
    time_s : (N,) array
    positions : (N, axes) array
        Link sides, as the observer estimates them.
    deviation : (N, 9) array
        Its fast part: from the nominal geometry at `positions`, less what changes slower than `SLOW_Hz`.
    load : (N, 3) array
        Gravity less the slow acceleration of the detector, in the world, over gravity: what bends a machine that moves slowly.
    displacement_std : (6,) array
        Of the detector's displacement [m, rad].
    static : (4, 9) array
        The removed slow part, as far as it follows the pose: a constant and gravity's components in the detector's frame, times these.
        A live run, which has no later rows to smooth with, removes this at once. Zero without an observer.
    """

    time_s: np.ndarray
    positions: np.ndarray
    deviation: np.ndarray
    load: np.ndarray
    displacement_std: np.ndarray
    static: np.ndarray = field(default_factory=lambda: np.zeros((4, 9)))

    def __len__(self) -> int:
        """Return the number of samples N."""
        return len(self.time_s)

    def at(self, time_s: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return positions (M, axes), deviations (M, 9) and load (M, 3) at other times, linear between samples.

        Raises
        ------
        UnusableInputError
            A time lies outside of the recording.
        """
        first, last = self.time_s[0], self.time_s[-1]
        if len(time_s) and (np.min(time_s) < first or np.max(time_s) > last):
            raise UnusableInputError(
                f"exposures from {np.min(time_s):.3f} to {np.max(time_s):.3f} s, recording from {first:.3f} to {last:.3f} s:"
                " the panel's clock is not the loop's, or the recording is another run's"
            )
        table = np.concatenate([self.positions, self.deviation, self.load], axis=1)
        found = np.column_stack([np.interp(time_s, self.time_s, column) for column in table.T])
        axes = self.positions.shape[1]
        return found[:, :axes], found[:, axes : axes + 9], found[:, axes + 9 :]


def unobserved_beam(machine: Machine, recording: Recording) -> ObservedBeam:
    """Return the geometry by the encoders alone.

    Raises
    ------
    UnusableInputError
        A position is missing.
    """
    names = [f"link_position_{axis}" if f"link_position_{axis}" in recording else f"position_{axis}" for axis in machine.axes]
    positions = recording.matrix(names)
    if not np.isfinite(positions).all():
        row = int(np.flatnonzero(~np.isfinite(positions).all(axis=1))[0])
        raise UnusableInputError(f"the recording's axis positions are missing in row {row}; without an observer nothing stands for them")
    swings = np.repeat([UNOBSERVED_M, UNOBSERVED_RAD], 3)
    return ObservedBeam(recording.time, positions, np.zeros((len(positions), 9)), _load(machine, positions), swings)


def observed_beam(machine: Machine, recording: Recording) -> ObservedBeam:
    """Read the estimates of a recording.

    Raises
    ------
    UnusableInputError
        There are none, or one of them is not a number.
    """
    link = [f"estimate_link_position_{axis}" for axis in machine.axes]
    nine = [f"estimate_{what}_{axis}" for what in ("source", "isocenter", "orientation") for axis in "xyz"]
    turned = [f"estimate_detector_{name}" for name in ("x", "y", "z", "rx", "ry", "rz")]
    absent = [name for name in (*link, *nine, *turned) if name not in recording]
    if absent:
        raise UnusableInputError(
            f"the recording has no {absent[0]}: run the observer along with the scan (--observer), or over it (isocenter observe)"
        )
    values = recording.matrix([*link, *nine])
    if not np.isfinite(values).all():
        row = int(np.flatnonzero(~np.isfinite(values).all(axis=1))[0])
        raise UnusableInputError(f"the recording's estimates are not numbers from row {row} on; observe it again")
    axes = len(machine.axes)
    positions, parameters = values[:, :axes], values[:, axes:]
    # The observer speaks of the detector's frame at position zero; here orientations are in the world's.
    still = nominal_beam(machine, np.zeros((1, axes))).rotation[0]
    rotation = still @ Rotation.from_euler("xyz", parameters[:, 6:]).as_matrix()
    beam = ConeBeam(parameters[:, :3], parameters[:, 3:6], rotation)
    variances = [f"{name}_variance" for name in turned]
    known = np.zeros(6)
    if all(name in recording for name in variances):
        known = np.sqrt(np.median(recording.matrix(variances), axis=0))
    nominal = nominal_beam(machine, positions)
    deviation = beam.deviation_from(nominal)
    slow = _slow(deviation, machine.sample_rate_Hz)
    gravity = machine.plant.tree.gravity_m_s2 / np.linalg.norm(machine.plant.tree.gravity_m_s2)
    by_pose = np.column_stack([np.ones(len(positions)), np.einsum("nij,i->nj", nominal.rotation, gravity)])
    return ObservedBeam(
        recording.time,
        positions,
        deviation - slow,
        _load(machine, positions),
        np.maximum(known, np.repeat([FLOOR_M, FLOOR_RAD], 3)),
        np.linalg.lstsq(by_pose, slow, rcond=1e-6)[0],
    )


def _slow(values: np.ndarray, rate_Hz: float) -> np.ndarray:
    """Return the part that changes more slowly than `SLOW_Hz`, without delay."""
    pad = round(PAD_S * rate_Hz)
    padded = np.concatenate([np.repeat(values[:1], pad, axis=0), values, np.repeat(values[-1:], pad, axis=0)])
    smooth = sosfiltfilt(butter(ORDER, SLOW_Hz, fs=rate_Hz, output="sos"), padded, axis=0)
    inside: np.ndarray = smooth[pad : pad + len(values)]
    return inside


def _load(machine: Machine, positions: np.ndarray) -> np.ndarray:
    center = nominal_beam(machine, _slow(positions, machine.sample_rate_Hz)).detector_in_phantom_m
    gravity = machine.plant.tree.gravity_m_s2
    acceleration = np.gradient(np.gradient(center, axis=0), axis=0) * machine.sample_rate_Hz**2
    specific_force: np.ndarray = (gravity - acceleration) / np.linalg.norm(gravity)
    return specific_force
