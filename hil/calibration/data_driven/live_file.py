"""Files of a live calibration: sightings as they arrived, from which it can be replayed, and the geometry of the run."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from hil.calibration.data_driven.data_file import write_data_file
from hil.calibration.data_driven.live import LiveCalibration
from hil.calibration.data_driven.observed_beam import FLOOR_M, FLOOR_RAD, ObservedBeam
from hil.calibration.data_driven.values import CHANGE, REFUSED, Calibration
from hil.errors import UnusableInputError
from hil.files.arrays import read_arrays, write_arrays
from hil.imaging.mailbox import KINDS, LARGEST, Sighting

FORMAT = 1
SIGHTINGS, GEOMETRY = "sightings.npz", "geometry.npz"
"""Their names in the folder of the scan."""


def write_sightings(live: LiveCalibration, path: Path) -> None:
    """Write the sightings of the finished run to their file; raise RecordingError where it cannot be written."""
    arrivals = live.arrivals
    values, covariance = np.full((len(arrivals), LARGEST), np.nan), np.full((len(arrivals), LARGEST, LARGEST), np.nan)
    for k, arrival in enumerate(arrivals):
        size = len(arrival.sighting.values)
        values[k, :size], covariance[k, :size, :size] = arrival.sighting.values, arrival.sighting.covariance
    seen = [arrival.sighting for arrival in arrivals]
    arrays = {
        "sightings_format": FORMAT,
        "until_m": live.until_m,
        "poses": live.poses,
        "row": np.array([arrival.row for arrival in arrivals], dtype=np.int64),
        "fate": np.array([arrival.fate for arrival in arrivals], dtype=np.str_),
        "exposure_id": np.array([each.exposure_id for each in seen], dtype=np.int64),
        "time_s": np.array([each.time_s for each in seen]),
        "kind": np.array([each.kind for each in seen], dtype=np.str_),
        "positions": np.array([each.positions for each in seen]).reshape(len(seen), live.poses.shape[1]),
        "values": values,
        "covariance": covariance,
    }
    write_arrays(path, arrays)


class KeptSightings:
    """Sightings of a run, handed out in the rows in which they came: the inbox of a replay.

    Parameters
    ----------
    path : Path

    Attributes
    ----------
    until_m, poses
        Of the run's calibration.

    Raises
    ------
    UnusableInputError
        Missing, or another file.
    """

    def __init__(self, path: Path) -> None:
        arrays = read_arrays(path, "sightings of a live calibration")
        wanted = ("until_m", "poses", "row", "exposure_id", "time_s", "kind", "positions", "values", "covariance")
        if arrays.get("sightings_format", np.array(-1)).tolist() != FORMAT or any(name not in arrays for name in wanted):
            raise UnusableInputError(f"{path}: no sightings of a live calibration; `isocenter run ... --data` leaves them with its images")
        rows, poses = arrays["row"].shape, arrays["poses"].shape
        shapes = {
            "until_m": (),
            "poses": poses[:1] + poses[-1:],
            "row": rows[:1],
            **dict.fromkeys(("exposure_id", "time_s", "kind"), rows),
            "positions": rows + poses[-1:],
            "values": (*rows, LARGEST),
            "covariance": (*rows, LARGEST, LARGEST),
        }
        bent = [name for name, shape in shapes.items() if arrays[name].shape != shape]
        if bent:
            raise UnusableInputError(f"{path}: damaged: {bent[0]} has shape {arrays[bent[0]].shape}, expected {shapes[bent[0]]}")
        self.until_m, self.poses = float(arrays["until_m"]), arrays["poses"]
        self._by_row: dict[int, list[Sighting]] = {}
        for k, row in enumerate(arrays["row"]):
            kind = str(arrays["kind"][k])
            size = LARGEST if kind == KINDS[0] else 6
            numbers = arrays["positions"][k], arrays["values"][k, :size], arrays["covariance"][k, :size, :size]
            sighting = Sighting(int(arrays["exposure_id"][k]), 0, float(arrays["time_s"][k]), kind, *numbers)
            self._by_row.setdefault(int(row), []).append(sighting)

    def tell(self, row: int, time_s: float, positions: np.ndarray) -> None:
        """Ignore the row: a replay needs no positions."""

    def collect(self, row: int) -> list[Sighting]:
        """Return what came in this row."""
        return self._by_row.get(row, [])


def write_live_geometry(live: LiveCalibration, path: Path) -> None:
    """Write the geometry of the finished run, in the format of `isocenter calibrate data`."""
    known = np.isfinite(live.live).all(axis=1)
    period_s = 1.0 / live.machine.sample_rate_Hz
    positions, fast = live.positions[known], live.fast[known]
    load = np.tile(live.gravity, (len(positions), 1))
    spread = np.repeat([FLOOR_M, FLOOR_RAD], 3)
    observed = ObservedBeam(np.flatnonzero(known) * period_s, positions, fast, load, spread, live.static)
    parameters = live.filter.parameters
    final = fast + live.model.rows(positions, load) @ parameters.values
    fates = [arrival.fate for arrival in live.arrivals]
    found = Calibration(live.live[known], final, live.covariance[known], parameters)
    found.used = [k for k, fate in enumerate(fates) if fate in ("used", CHANGE)]
    found.refused = [k for k, fate in enumerate(fates) if fate == REFUSED]
    write_data_file(live.model, observed, found, path)
