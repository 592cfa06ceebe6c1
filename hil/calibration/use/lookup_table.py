"""Look-up tables: deviations from the nominal geometry over the axis positions at which they were measured (thesis Fig. 2.4)."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from scipy.interpolate import LinearNDInterpolator
from scipy.spatial import QhullError

from hil.calibration.phantom.pose import PoseFit
from hil.errors import UnusableInputError
from hil.files.arrays import read_arrays, write_arrays
from hil.imaging.geometry import ConeBeam
from hil.machine import Machine

FORMAT = 1

SAME_POSE = 2e-3
"""Consecutive exposures whose positions differ by less [rad or m] are of one pose: the loop is settling, not moving."""

FEWEST_SHARE = 0.5
"""Share of a scan's exposures that must fit the phantom."""

STANDS = 0.02
"""An axis whose positions spread by less [rad or m] did not move in the calibration, though the other's drive may have shaken it by
milliradians; a pose farther than this from where it stood is another scan type."""

SAME_SPEED = 0.1
"""What bends with speed differs by less than a fifth between scans whose speeds differ by this share."""


def sweep_speed(time_s: np.ndarray, positions: np.ndarray) -> np.ndarray:
    """Return the median speed (axes,) [rad/s or m/s] of each axis while it moved, signed by direction.

    0 where it stood; NaN where there is no single value: the axis went both ways, or there are fewer than two exposures.

    Parameters
    ----------
    time_s : (N,) array
        Rising.
    positions : (N, axes) array
    """
    if len(time_s) < 2:
        return np.full(positions.shape[1], np.nan)
    speed = np.diff(positions, axis=0) / np.diff(time_s)[:, None]
    speed[:, np.ptp(positions, axis=0) < STANDS] = 0.0
    result = np.full(positions.shape[1], np.nan)
    for k, column in enumerate(speed.T):
        moving = column[np.abs(column) >= 0.5 * np.abs(column).max()]
        if len(moving) and np.ptp(np.sign(moving)) == 0.0:
            result[k] = np.median(moving)
    return result


@dataclass(frozen=True)
class LookUp:
    """Calibrated deviations of one scan type, or of a grid of poses.

    Attributes
    ----------
    axes : tuple of str
    positions : (N, axes) array
        Where each exposure was taken [rad or m].
    deviation : (N, 9) array
        From the nominal geometry there, as `ConeBeam.moved` takes it.
    covariance : (N, 9, 9) array
    notes : mapping
        Machine, its hash, scan type; `speed`, that of each axis (`sweep_speed`).
    shared : (N, 9, 9) array, optional
        The part of the covariance that exposures of one pose share (`PoseFit`); without it none.
    """

    axes: tuple[str, ...]
    positions: np.ndarray
    deviation: np.ndarray
    covariance: np.ndarray
    notes: Mapping[str, Any] = field(default_factory=dict)
    shared: np.ndarray | None = None

    def require(self, machine: Machine) -> None:
        """Refuse a table whose deviations are from another machine's geometry, or over other axes.

        Raises
        ------
        UnusableInputError
            Another machine's name, other axes, or another order of them.
        """
        made_for = self.notes.get("machine", machine.name)
        if made_for != machine.name or self.axes != machine.axes:
            raise UnusableInputError(
                f"the look-up table is of {made_for} with axes {', '.join(self.axes)};"
                f" {machine.name} has {', '.join(machine.axes)}: calibrate this machine"
            )

    def other_speed(self, speed: np.ndarray) -> str:
        """Return how a scan at this speed (axes,) differs from that of the table; "" where it does not, or this is unknown."""
        own = np.asarray(self.notes.get("speed") or [np.nan] * len(self.axes), dtype=float)
        differs = np.abs(speed - own) > SAME_SPEED * np.maximum(np.abs(own), np.abs(speed))
        named = [f"{self.axes[k]} went at {own[k]:+.3g} in the calibration and goes at {speed[k]:+.3g}" for k in np.flatnonzero(differs)]
        return f"{', '.join(named)} (rad/s, m/s): what bends with speed is not this scan's; calibrate this scan type" if named else ""

    def at(self, positions: np.ndarray) -> np.ndarray:
        """Return deviations (M, 9) at positions (M, axes), linear between calibrated exposures.

        Raises
        ------
        UnusableInputError
            A position is outside of what was calibrated.
        """
        positions = np.atleast_2d(positions)
        moved = np.flatnonzero(np.ptp(self.positions, axis=0) > STANDS)
        for k in range(len(self.axes)):
            off = np.abs(positions[:, k] - np.median(self.positions[:, k])).max()
            if k not in moved and off > STANDS:
                raise UnusableInputError(
                    f"{self.axes[k]} stood at {np.median(self.positions[:, k]):.3f} in the calibration; the scan is {off:.3f} away."
                    " Calibrate this scan type"
                )
        if len(moved) == 0:
            return np.repeat(self.deviation.mean(axis=0)[None], len(positions), axis=0)
        if len(moved) == 1:
            return self._along(int(moved[0]), positions)
        try:
            found: np.ndarray = LinearNDInterpolator(self.positions[:, moved], self.deviation, rescale=True)(positions[:, moved])
        except QhullError:
            named = " and ".join(self.axes[k] for k in moved)
            raise UnusableInputError(f"{len(self.positions)} poses that span no area of {named}; calibrate a grid of both") from None
        if np.isnan(found).any():
            worst = positions[np.flatnonzero(np.isnan(found).any(axis=1))[0]]
            raise UnusableInputError(f"pose {np.round(worst, 3)} is outside of the calibrated grid; calibrate farther out")
        return found

    def _along(self, axis: int, positions: np.ndarray) -> np.ndarray:
        order = np.argsort(self.positions[:, axis])
        known, wanted = self.positions[order, axis], positions[:, axis]
        step = np.max(np.diff(known), initial=0.0)
        if wanted.min() < known[0] - step or wanted.max() > known[-1] + step:
            raise UnusableInputError(
                f"{self.axes[axis]} goes from {wanted.min():.3f} to {wanted.max():.3f}; calibrated from {known[0]:.3f} to {known[-1]:.3f}"
            )
        return np.column_stack([np.interp(wanted, known, self.deviation[order, k]) for k in range(9)])


def look_up_of(fit: PoseFit, nominal: ConeBeam, axes: tuple[str, ...], positions: np.ndarray, notes: Mapping[str, Any]) -> LookUp:
    """Return the table of a phantom calibration; exposures that could not be used are left out.

    Raises
    ------
    UnusableInputError
        The scan's axis positions are not known, or most exposures do not fit the phantom.
    """
    if np.isnan(positions).any():
        raise UnusableInputError("the exposures have no axis positions; give the recording of the scan, a look-up table goes by position")
    good = fit.good
    if good.sum() < FEWEST_SHARE * len(good):
        raise UnusableInputError(
            f"{int(good.sum())} of {len(good)} exposures show the phantom where it is expected; compare phantom, positions and"
            " order of the images with the scan, and whether they are mirrored"
        )
    return LookUp(axes, positions[good], fit.beam.deviation_from(nominal)[good], fit.covariance[good], dict(notes), fit.shared[good])


def standing(table: LookUp) -> LookUp:
    """Return the poses at which the machine stood, each with its exposures averaged: a roadmapping grid, of no speed.

    Raises
    ------
    UnusableInputError
        No two exposures in a row at one pose.
    """
    moved = np.abs(np.diff(table.positions, axis=0)).max(axis=1, initial=0.0) > SAME_POSE
    runs = [run for run in np.split(np.arange(len(table.positions)), np.flatnonzero(moved) + 1) if len(run) >= 2]
    if not runs:
        raise UnusableInputError(
            f"no two exposures in a row within {SAME_POSE:g} rad (m): the machine never stood; use a tour with dwell_s"
        )
    every = table.positions, table.deviation, table.covariance, np.zeros_like(table.covariance) if table.shared is None else table.shared
    positions, deviation, covariance, shared = (np.array([each[run].mean(axis=0) for run in runs]) for each in every)
    covariance = shared + (covariance - shared) / np.array([len(run) for run in runs])[:, None, None]
    notes = {name: value for name, value in table.notes.items() if name != "speed"}
    return LookUp(table.axes, positions, deviation, covariance, notes, None if table.shared is None else shared)


def write_look_up(table: LookUp, path: Path) -> None:
    """Write the table to its file; raise RecordingError where it cannot be written."""
    arrays = {
        "format": FORMAT,
        "axes": table.axes,
        "positions": table.positions,
        "deviation": table.deviation,
        "covariance": table.covariance,
        "notes": json.dumps(dict(table.notes)),
    }
    write_arrays(path, arrays | ({} if table.shared is None else {"shared": table.shared}))


def read_look_up(path: Path) -> LookUp:
    """Read a look-up table from its file.

    Raises
    ------
    UnusableInputError
        Missing, or no look-up table.
    """
    return look_up_from(path, read_arrays(path, "a look-up table"))


def _is_speed(value: object) -> bool:
    return value is None or (isinstance(value, (int, float)) and not isinstance(value, bool))


def look_up_from(path: Path, arrays: Mapping[str, np.ndarray]) -> LookUp:
    """Make a look-up table from the arrays of its file.

    Raises
    ------
    UnusableInputError
        An array is missing or of another shape, or of another version.
    """
    try:
        if int(arrays["format"]) != FORMAT:
            raise UnusableInputError(f"{path}: format {int(arrays['format'])}; this version reads {FORMAT}")
        axes, notes = tuple(str(axis) for axis in arrays["axes"]), json.loads(str(arrays["notes"]))
        names = ["positions", "deviation", "covariance"] + ["shared"] * ("shared" in arrays)
        numbers = [np.asarray(arrays[name], dtype=float) for name in names]
        table = LookUp(axes, numbers[0], numbers[1], numbers[2], notes, *numbers[3:])
    except UnusableInputError:
        raise
    except (ValueError, KeyError, TypeError) as error:
        raise UnusableInputError(f"{path}: no look-up table of isocenter calibrate phantom ({error})") from None
    count = len(table.positions) if table.positions.ndim else 0
    shapes = [each.shape for each in numbers]
    if not count or shapes != [(count, len(axes)), (count, 9), *[(count, 9, 9)] * (len(numbers) - 2)] or not isinstance(notes, dict):
        raise UnusableInputError(
            f"{path}: arrays do not belong together; a look-up table has positions (N, axes), deviation (N, 9), covariance"
        )
    if not all(np.isfinite(each).all() for each in numbers):
        raise UnusableInputError(f"{path}: a number is not finite; take the table as isocenter calibrate phantom wrote it")
    speed = notes.get("speed")
    if speed is not None and (not isinstance(speed, list) or len(speed) != len(axes) or not all(map(_is_speed, speed))):
        raise UnusableInputError(f"{path}: notes: speed = {speed!r}; it is a list of {len(axes)} numbers, null where none is known")
    return table
