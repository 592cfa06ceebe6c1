"""Poses of panel and tube from an external tracker: the geometry that they show, as truth for a calibration or input to one (Fig. 2.9).

A tracker sees a target on the panel and one on the tube, in a frame of its own. Nobody knows where that frame stands in the room, how the
target on the panel is mounted, and where the focal spot is in the target on the tube:

    R_k = R_w Rd_k R_t,   d_k = t_w + R_w (pd_k + Rd_k a),   s_k = t_w + R_w (ps_k + Rs_k b).

These are fitted to a reference geometry R_k, d_k, s_k (panel's orientation, its centre, the spot). What is left is what the tracker
measures: how the geometry changes from pose to pose, not constant errors of the reference, which the mounting takes up.
"""

from __future__ import annotations

import csv
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from hil.calibration.use.lookup_table import LookUp, sweep_speed
from hil.errors import UnusableInputError
from hil.imaging.geometry import ConeBeam
from hil.imaging.nominal import nominal_beam
from hil.machine import Machine
from hil.recording import Recording

TARGETS = ("detector", "source")
PLACE, TURN = ("x", "y", "z"), ("qx", "qy", "qz", "qw")
LENGTHS = {"m": 1.0, "mm": 1e-3}
TIMES = {"": 1.0, "s": 1.0, "ms": 1e-3, "us": 1e-6}
FEWEST = 8
"""Poses: fifteen numbers of mountings and frames are fitted to nine of each."""
STEPS, SETTLED, DIFFERENCE = 20, 1e-9, 1e-6
"""Of Gauss and Newton: most of them, the largest one [rad, m] at which they have settled, and of differences."""
SHOWN = 1e-6
"""Share of what the poses show best below which a combination of frames and mountings stays where it is: a sweep of one axis shows no place
along it, and none is needed to tell how the geometry changes."""
ROUNDS = 50
"""Most turns of the start, in which frame and mounting are fitted in turn."""


@dataclass(frozen=True, eq=False)
class TrackedPoses:
    """What a tracker saw, targets in its own frame.

    Attributes
    ----------
    time_s : (N,) array
    place_m : mapping of target to (N, 3) array
    rotation : mapping of target to (N, 3, 3) array
    lost : int
        Lines without one of the targets.
    """

    time_s: np.ndarray
    place_m: Mapping[str, np.ndarray]
    rotation: Mapping[str, np.ndarray]
    lost: int = 0


@dataclass(frozen=True, eq=False)
class Registered:
    """A tracker's poses laid on a reference geometry.

    Attributes
    ----------
    beam : ConeBeam
        What the tracker shows, in the reference's frame.
    difference : (N, 9) array
        Of it from the reference, as `ConeBeam.deviation_from` gives it.
    target_m : (3,) array
        Of the panel, in its frame.
    spot_m : (3,) array
        Focal spot in the frame of the target on the tube.
    tube : (N, 3, 3) array
        From that frame to the panel's.
    """

    beam: ConeBeam
    difference: np.ndarray
    target_m: np.ndarray
    spot_m: np.ndarray
    tube: np.ndarray


def read_tracker(path: Path) -> TrackedPoses:
    """Read a CSV of poses: `time [s, ms or us]`, and of `detector_` and `source_` each `x`, `y`, `z` [m or mm] and `qx`, `qy`, `qz`, `qw`.

    A target that was not seen has empty cells; such lines are left out.

    Raises
    ------
    UnusableInputError
        No such file, a column is missing or in another unit, a cell is no number, or times do not rise.
    """
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            header, *lines = [line for line in csv.reader(file) if line]
    except (OSError, UnicodeDecodeError, ValueError) as error:
        raise UnusableInputError(f"{path}: cannot be read as a table of poses: {error}") from None
    units = {name.partition("[")[0].strip(): name.partition("[")[2].rstrip("] ") for name in header}
    wanted = ["time", *(f"{target}_{part}" for target in TARGETS for part in (*PLACE, *TURN))]
    if missing := [name for name in wanted if name not in units]:
        raise UnusableInputError(f"{path}: no column {', '.join(missing)}; a tracker's table has {', '.join(wanted)}")
    names = list(units)
    rows = []
    for number, line in enumerate(lines, 2):
        cells = dict(zip(names, line, strict=False))
        try:
            rows.append([float(cells.get(name) or np.nan) for name in wanted])
        except ValueError:
            raise UnusableInputError(f"{path}: line {number}: a cell is no number") from None
    values = np.array(rows).reshape(-1, len(wanted))
    seen = np.isfinite(values).all(axis=1)
    kept = values[seen]
    if units["time"] not in TIMES:
        raise UnusableInputError(f"{path}: time [{units['time']}]: must be in s, ms or us")
    kept[:, 0] *= TIMES[units["time"]]
    if (np.diff(kept[:, 0]) <= 0.0).any():
        raise UnusableInputError(f"{path}: times do not rise")
    for k, name in enumerate(wanted):
        if name.endswith(tuple(f"_{part}" for part in PLACE)):
            if units[name] not in LENGTHS:
                raise UnusableInputError(f"{path}: {name} [{units[name]}]: must be in m or mm")
            kept[:, k] *= LENGTHS[units[name]]
    quaternions = [kept[:, 4 + first : 8 + first] for first in (0, 7)]
    if any((np.abs(np.linalg.norm(each, axis=1) - 1.0) > 0.01).any() for each in quaternions):
        raise UnusableInputError(f"{path}: qx, qy, qz, qw must be quaternions of length 1")
    places = [kept[:, 1 + first : 4 + first] for first in (0, 7)]
    return TrackedPoses(
        kept[:, 0],
        dict(zip(TARGETS, places, strict=True)),
        {target: Rotation.from_quat(each).as_matrix() for target, each in zip(TARGETS, quaternions, strict=True)},
        int(np.sum(~seen)),
    )


def register_on(poses: TrackedPoses, reference: ConeBeam, *, position_sigma_m: float, rotation_sigma_rad: float) -> Registered:
    """Lay a tracker's poses on a reference geometry of the same exposures.

    The sigmas are the tracker's, of a target's place and of its orientation about each axis: they weigh one against the other.

    Raises
    ------
    UnusableInputError
        Fewer than FEWEST poses.
    """
    if len(reference) < FEWEST:
        raise UnusableInputError(f"{len(reference)} poses of the tracker within the recording: it takes {FEWEST}")
    panel, spot = reference.detector_in_phantom_m, reference.source_in_phantom_m
    turned, tube = poses.rotation["detector"], poses.rotation["source"]
    frame, mounting = _start(turned, reference.rotation)

    def laid(numbers: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        world, target = (Rotation.from_rotvec(numbers[k : k + 3]).as_matrix() for k in (0, 3))
        world, target = world @ frame, mounting @ target
        shift, centre, focus = numbers[6:9], numbers[9:12], numbers[12:15]
        at = shift + (poses.place_m["detector"] + turned @ centre) @ world.T
        return at, shift + (poses.place_m["source"] + tube @ focus) @ world.T, world @ turned @ target, world @ tube

    def off(numbers: np.ndarray) -> np.ndarray:
        at, source, orientation, _ = laid(numbers)
        angles = Rotation.from_matrix(np.swapaxes(reference.rotation, 1, 2) @ orientation).as_rotvec()
        parts = ((at - panel) / position_sigma_m, (source - spot) / position_sigma_m, angles / rotation_sigma_rad)
        return np.concatenate([part.ravel() for part in parts])

    best = np.zeros(15)
    for _ in range(STEPS):
        here = off(best)
        slopes = np.column_stack([(off(best + each) - here) / DIFFERENCE for each in DIFFERENCE * np.eye(15)])
        step = np.linalg.lstsq(slopes, -here, rcond=SHOWN)[0]
        best = best + step
        if np.abs(step).max() < SETTLED:
            break
    at, source, orientation, tubes = laid(best)
    beam = ConeBeam.from_frames(source, at, orientation)
    target = -(mounting @ Rotation.from_rotvec(best[3:6]).as_matrix()).T @ best[9:12]
    return Registered(beam, beam.deviation_from(reference), target, best[12:15], np.swapaxes(orientation, 1, 2) @ tubes)


def _start(turned: np.ndarray, wanted: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return R_w and R_t with R_w Rd_k R_t near R_k: turns from pose to pose have their axes in both, and then each is fitted in turn."""
    mine = Rotation.from_matrix(np.swapaxes(turned[:1], 1, 2) @ turned).as_rotvec()
    theirs = Rotation.from_matrix(np.swapaxes(wanted[:1], 1, 2) @ wanted).as_rotvec()
    mounting = _nearest(mine.T @ theirs)
    frame = np.eye(3)
    for _ in range(ROUNDS):
        frame = _nearest(np.einsum("nij,nkj->ik", wanted, turned @ mounting))
        mounting = _nearest(np.einsum("nji,njk->ik", frame @ turned, wanted))
    return frame, mounting


def _nearest(matrix: np.ndarray) -> np.ndarray:
    """Return the rotation nearest to a matrix (Kabsch 1976)."""
    left, _, right = np.linalg.svd(matrix)
    turned: np.ndarray = left @ np.diag([1.0, 1.0, np.sign(np.linalg.det(left @ right))]) @ right
    return turned


def tracked_table(
    machine: Machine,
    recording: Recording,
    poses: TrackedPoses,
    *,
    position_sigma_m: float,
    rotation_sigma_rad: float,
    later_s: float = 0.0,
    against: LookUp | None = None,
) -> tuple[LookUp, Registered]:
    """Return the look-up table that a tracker gives of a recorded motion, and the poses laid on what they are held against.

    Parameters
    ----------
    machine : Machine
        Whose file says the nominal geometry.
    recording : Recording
        Of the same motion: axis positions.
    poses : TrackedPoses
    position_sigma_m, rotation_sigma_rad : float
        Of the tracker.
    later_s : float
        What the tracker's clock shows at the recording's first row.
    against : LookUp, optional
        A calibration that the poses are laid on and held against; nominal geometry unless given.

    Raises
    ------
    UnusableInputError
        Too few poses within the recording, or a table of another machine.
    """
    time_s = poses.time_s - later_s
    rows = recording.time - recording.time[0]
    within = (time_s >= rows[0]) & (time_s <= rows[-1])
    poses = TrackedPoses(
        time_s[within],
        {target: values[within] for target, values in poses.place_m.items()},
        {target: values[within] for target, values in poses.rotation.items()},
    )
    positions = np.column_stack([np.interp(poses.time_s, rows, _position(recording, axis)) for axis in machine.axes])
    nominal = nominal_beam(machine, positions)
    reference = nominal
    if against is not None:
        against.require(machine)
        reference = nominal.moved(against.at(positions))
    sigmas = {"position_sigma_m": position_sigma_m, "rotation_sigma_rad": rotation_sigma_rad}
    found = register_on(poses, reference, **sigmas)
    speed = [float(each) if np.isfinite(each) else None for each in sweep_speed(poses.time_s, positions)]
    notes: dict[str, Any] = {"machine": machine.name, "hash": machine.hash, "six": False, "speed": speed, "source": "tracker"}
    covariance = _covariance(found, **sigmas)
    return LookUp(machine.axes, positions, found.beam.deviation_from(nominal), covariance, notes), found


def rms_of(laid: Registered, table: LookUp) -> tuple[dict[str, float], dict[str, float]]:
    """Return rms of `source_m`, `phantom_m` and `rotation_rad` of a difference, and what of it the tracker's noise makes."""
    squares = np.mean(laid.difference**2, axis=0)
    variances = np.mean(np.diagonal(table.covariance, axis1=1, axis2=2), axis=0)
    names = {"source_m": 0, "phantom_m": 3, "rotation_rad": 6}
    both = [{name: float(np.sqrt(each[k : k + 3].sum())) for name, k in names.items()} for each in (squares, variances)]
    return both[0], both[1]


def _position(recording: Recording, axis: str) -> np.ndarray:
    """Return an axis's positions, of its link encoder where there is one."""
    for name in (f"link_position_{axis}", f"position_{axis}"):
        if name in recording and np.isfinite(recording[name]).all():
            values: np.ndarray = recording[name]
            return values
    raise UnusableInputError(f"the recording has no complete position_{axis}")


def _covariance(found: Registered, *, position_sigma_m: float, rotation_sigma_rad: float) -> np.ndarray:
    """Return the covariances (N, 9, 9) that the tracker's noise has in source, phantom and orientation, in the panel's frame.

    To the panel everything else moves by its distance from the target where this turns.
    """
    beam, place, turn = found.beam, position_sigma_m**2, rotation_sigma_rad**2
    covariance = np.zeros((len(beam), 9, 9))
    both = np.zeros((9, 3))
    both[:3] = both[3:6] = np.eye(3)
    for k in range(len(beam)):
        turned = np.vstack([_cross(beam.source_m[k] - found.target_m), _cross(beam.phantom_m[k] - found.target_m), np.eye(3)])
        focus = found.tube[k] @ _cross(found.spot_m)
        covariance[k] = turn * turned @ turned.T + place * both @ both.T
        covariance[k, :3, :3] += place * np.eye(3) + turn * focus @ focus.T
    return covariance


def _cross(vector: np.ndarray) -> np.ndarray:
    """Return the matrix of r x w as a function of w."""
    x, y, z = vector
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
