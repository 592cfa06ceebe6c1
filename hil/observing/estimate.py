"""An observer's estimates row by row, and their file: EST in docs/generated/file-formats.md."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hil.errors import UnusableInputError
from hil.files.arrays import read_arrays, write_arrays
from hil.files.frames import data_frame
from hil.recording import Channel, Recording, write_recording

if TYPE_CHECKING:
    import pandas as pd

FORMAT = 1


@dataclass(frozen=True)
class Estimate:
    """An observer's estimates over a recording.

    Attributes
    ----------
    time_s : (N,)
    names, units : of the columns of `values`: `estimate_*`, their variances, and the consistency's four numbers
    values : (N, len(names))
    measured_names : channels looked at
    innovation : (N, len(measured_names)) NaN where nothing was measured
    state_names, states : (N, len(state_names))
    filter : "kf", "ekf" or "ukf"
    machine_hash : of the machine the design was made for
    notes : what a user should know
    """

    time_s: np.ndarray
    names: tuple[str, ...]
    units: tuple[str, ...]
    values: np.ndarray
    measured_names: tuple[str, ...]
    innovation: np.ndarray
    state_names: tuple[str, ...]
    states: np.ndarray
    filter: str
    machine_hash: str
    notes: tuple[str, ...] = ()

    def __getitem__(self, name: str) -> np.ndarray:
        """Return a column (N,) by name."""
        try:
            return self.values[:, self.names.index(name)]
        except ValueError:
            raise UnusableInputError(f"no estimate {name}; there is {', '.join(self.names[: len(self.names) // 2])}") from None

    @property
    def mean_nis(self) -> float:
        """Mean normalised innovation squared per measurement; 1 fits."""
        return float(self["estimate_nis"].sum() / max(self["estimate_measured"].sum(), 1.0))

    @property
    def alarm_share(self) -> float:
        """Share of rows with an alarm."""
        return float(np.mean(self["estimate_alarm"]))

    @property
    def rms(self) -> dict[str, float]:
        """Root mean square of every estimate."""
        values = self.names.index("estimate_nis") // 2
        return {name: float(np.sqrt(np.mean(self[name] ** 2))) for name in self.names[:values]}

    def frame(self) -> pd.DataFrame:
        """Return the columns over time [s], their units in `attrs["units"]`; UnusableInputError without pandas, an extra."""
        columns = dict(zip(self.names, self.values.T, strict=True))
        return data_frame(columns, index=self.time_s, index_name="time", units=dict(zip(self.names, self.units, strict=True)))


_NAMES = ("names", "units", "measured_names", "state_names", "notes")
_ARRAYS = ("time_s", "values", "innovation", "states")


def write_estimate(estimate: Estimate, path: str | Path, recording: Recording | None = None) -> None:
    """Write an EST file (.npz), or with a recording and a path in .mf4 or .csv, that recording with the estimates as channels."""
    path = Path(path)
    if path.suffix.lower() in (".mf4", ".csv"):
        if recording is None:
            raise UnusableInputError(f"{path}: estimates join a recording's rows; without one write an .npz")
        channels = {name: channel for name, channel in recording.channels.items() if not name.startswith("estimate_")}
        for name, unit, values in zip(estimate.names, estimate.units, estimate.values.T, strict=True):
            channels[name] = Channel(unit, values)
        write_recording(Recording(channels, recording.metadata), path)
        return
    arrays = {name: np.asarray(getattr(estimate, name)) for name in (*_ARRAYS, "filter", "machine_hash")}
    arrays |= {name: np.array(getattr(estimate, name), dtype=np.str_) for name in _NAMES}
    write_arrays(path, {"estimate_format": FORMAT, **arrays})


def read_estimate(path: str | Path) -> Estimate:
    """Read an EST file.

    Raises
    ------
    UnusableInputError
        The file is missing or no EST file.
    """
    arrays = read_arrays(path, "an EST file")
    if str(arrays.get("estimate_format")) != str(FORMAT):
        raise UnusableInputError(f"{path}: not an EST file of format {FORMAT}; `isocenter observe` writes one")
    if lacking := [name for name in (*_ARRAYS, *_NAMES, "filter", "machine_hash") if name not in arrays]:
        raise UnusableInputError(f"{path}: not an EST file: the array {lacking[0]} is missing")
    fields: dict[str, Any] = {name: arrays[name] for name in _ARRAYS}
    fields |= {name: tuple(str(text) for text in arrays[name]) for name in _NAMES}
    return Estimate(**fields, filter=str(arrays["filter"]), machine_hash=str(arrays["machine_hash"]))
