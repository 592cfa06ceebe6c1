"""Images of a scan as the emulated machine's panel takes them, from the emulator's truth file."""

from __future__ import annotations

import csv
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline

from hil.emulated.beam import Beam
from hil.errors import UnusableInputError
from hil.extras import extra_package
from hil.files.regular import check_regular
from hil.imaging.detector import Detector
from hil.imaging.geometry import ConeBeam
from hil.imaging.nominal import imaging_geometry
from hil.imaging.scan_folder import FRAMES, write_description, write_exposures
from hil.machine import Machine
from hil.recording import Recording
from virtual_bus.xray.motion import FocalSpot, PoseTrack, XraySide


@dataclass(frozen=True)
class Exposures:
    """Times of the exposures, by the panel's own clock.

    Attributes
    ----------
    rate_Hz : float
        Rate by the panel's clock.
    width_s : float
    first_s : float
        Start of the first exposure in loop time.
    clock_ppm : float
        By how much the panel's clock is faster than the loop's.
    """

    rate_Hz: float = 7.0
    width_s: float = 0.008
    first_s: float = 0.1
    clock_ppm: float = 20.0

    def starts(self, last_s: float) -> np.ndarray:
        """Return the starts of all exposures that end before `last_s`, in loop time."""
        period = self._period_s
        return self.first_s + period * np.arange(max(0, int(np.floor((last_s - self.width_s - self.first_s) / period)) + 1))

    def start(self, exposure_id: int) -> float:
        """Return the start of one exposure in loop time."""
        return self.first_s + self._period_s * exposure_id

    @property
    def _period_s(self) -> float:
        return 1.0 / (self.rate_Hz * (1.0 + 1e-6 * self.clock_ppm))


def xray_side(machine: Machine, truth: Path, spot: FocalSpot, hot_since_s: float) -> XraySide:
    """Return the true motion of tube and panel from an emulator's truth file.

    Raises
    ------
    UnusableInputError
        The machine has no [geometry], or the truth file lacks the poses of its bodies.
    """
    geometry = imaging_geometry(machine)
    columns = _truth_columns(truth, (geometry.source_body, geometry.detector_body))
    time_s = columns["time"][:, 0] - columns["time"][0, 0]  # the loop's time begins with row 0 of the recording

    def track(body: str) -> PoseTrack:
        return PoseTrack(time_s, columns[body][:, :3] - geometry.isocenter_m, columns[body][:, 3:].reshape(-1, 3, 3))

    tube, panel = track(geometry.source_body), track(geometry.detector_body)
    return XraySide(tube, panel, geometry.source_position_m, geometry.detector_center_m, spot, hot_since_s)


def true_beam(side: XraySide, start_s: np.ndarray, width_s: np.ndarray) -> ConeBeam:
    """Return the true geometry in the middle of each exposure, referred to the isocentre."""
    views = [side.views(float(start), float(width), 1)[0] for start, width in zip(start_s, width_s, strict=True)]
    return ConeBeam.from_frames(
        np.array([view.source_m for view in views]),
        np.array([view.panel_m for view in views]),
        np.array([view.panel_rotation for view in views]),
    )


def expose(
    machine: Machine,
    side: XraySide,
    exposures: Exposures,
    beam: Beam,
    detector: Detector,
    folder: Path,
    recording: Recording | None = None,
    seed: int = 0,
    progress: Callable[[int, int], None] = lambda done, total: None,
    notes: dict[str, object] | None = None,
) -> int:
    """Write the images of a scan.

    Parameters
    ----------
    recording : Recording, optional
        Axis positions in the middle of each exposure are interpolated from it.

    Returns
    -------
    int
        Number of exposures.

    Raises
    ------
    UnusableInputError
        The scan is shorter than one exposure, or the folder cannot be written.
    """
    tifffile = extra_package("tifffile", "images")
    starts = exposures.starts(side.panel.last_s)
    starts = starts[starts >= side.panel.first_s]
    if not len(starts):
        raise UnusableInputError(f"no exposure of {exposures.width_s:g} s fits between {side.panel.first_s:g} and {side.panel.last_s:g} s")
    widths = np.full(len(starts), exposures.width_s)
    rng = np.random.default_rng(seed)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tifffile.TiffWriter(folder / FRAMES) as frames:
            for k, start in enumerate(starts):
                frames.write(beam.image(side, float(start), exposures.width_s, detector, rng), contiguous=True)
                progress(k + 1, len(starts))
        write_description(folder, detector, machine.axes, {"machine": machine.name, "machine_hash": machine.hash, **(notes or {})})
        positions = positions_at(machine, recording, starts + 0.5 * widths)
        write_exposures(folder, np.arange(len(starts)), starts, widths, {axis.axis: axis.position for axis in machine.units}, positions)
    except OSError as error:
        raise UnusableInputError(f"{folder}: cannot be written: {error.strerror or error}") from None
    return len(starts)


def positions_at(machine: Machine, recording: Recording | None, time_s: np.ndarray) -> np.ndarray:
    """Return measured axis positions (N, axes) at loop times, cubic between rows; NaN without a recording.

    Raises
    ------
    UnusableInputError
        An exposure lies outside the recording: the clocks disagree, or the recording is of another run.
    """
    if recording is None:
        return np.full((len(time_s), len(machine.axes)), np.nan)
    rows = recording.time
    if time_s[0] < rows[0] or time_s[-1] > rows[-1]:
        raise UnusableInputError(
            f"exposures from {time_s[0]:.3f} to {time_s[-1]:.3f} s, recording from {rows[0]:.3f} to {rows[-1]:.3f} s:"
            " the panel's clock is not the loop's, or the recording is another run's"
        )
    names = [f"link_position_{axis}" if f"link_position_{axis}" in recording else f"position_{axis}" for axis in machine.axes]
    values = recording.matrix(names)
    whole = np.isfinite(values).all(axis=1)
    positions: np.ndarray = CubicSpline(rows[whole], values[whole])(time_s)
    return positions


def _truth_columns(path: Path, bodies: tuple[str, ...]) -> dict[str, np.ndarray]:
    """Return time (N, 1) and pose (N, 12) of each body."""
    check_regular(path)
    try:
        with path.open(newline="", encoding="utf-8") as file:
            header = next(csv.reader(file), [])
            rows = [row for row in csv.reader(file) if row]
        values = np.array([[float(cell) for cell in row] for row in rows if len(row) == len(header)])
    except (OSError, UnicodeDecodeError, csv.Error, ValueError) as error:
        raise UnusableInputError(f"{path}: no truth file: {error}") from None
    if len(values) < 2 or len(values) < len(rows):
        cells = f"{len(header)} cells in every row, two rows at least"
        raise UnusableInputError(f"{path}: {len(values)} whole rows of {len(rows)}; a truth file has {cells}")
    if not np.isfinite(values).all() or (np.diff(values[:, 0]) <= 0.0).any():
        raise UnusableInputError(f"{path}: a number is not finite, or time does not rise; take the file as the emulator wrote it")
    result = {"time": values[:, :1]}
    for body in bodies:
        found = [k for k, name in enumerate(header) if name.startswith(f"pose_{body}_")]
        if len(found) != 12:
            raise UnusableInputError(f"{path}: no pose of {body}; write it with `isocenter run ... --truth FILE` on the emulator")
        result[body] = values[:, found]
    return result
