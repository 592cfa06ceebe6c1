"""SHAPER files: NumPy .npz archives, with the layout of docs/generated/file-formats.md."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from controllers.errors import DesignError
from controllers.shapers.sampled import AxisShaper
from hil.errors import UnusableInputError
from hil.files.arrays import read_arrays, write_arrays

FORMAT = 1
_ARRAYS = ("delays", "gains", "positions", "tail", "static_gain", "name", "schedule_axis")


@dataclass(frozen=True)
class ShaperFile:
    """The shapers of one machine.

    Attributes
    ----------
    shapers : one per shaped axis.
    sample_rate_Hz : the rate of the samples in which delays are counted.
    notes : design goals and verdicts, plain values that JSON can hold.
    """

    shapers: tuple[AxisShaper, ...]
    sample_rate_Hz: float
    notes: dict[str, Any] = field(default_factory=dict)

    @property
    def transient_samples(self) -> int:
        """Longest transient of all axes, tails included."""
        return max(shaper.transient_samples + shaper.settling_samples for shaper in self.shapers)


def write_shaper(shaper: ShaperFile, path: str | Path) -> None:
    """Write a SHAPER file."""
    arrays: dict[str, np.ndarray] = {
        "format": np.array(FORMAT),
        "axes": np.array([each.axis for each in shaper.shapers], dtype=np.str_),
        "sample_rate_Hz": np.array(shaper.sample_rate_Hz),
        "notes": np.array(json.dumps(shaper.notes)),
    }
    for each in shaper.shapers:
        arrays |= {f"{name}_{each.axis}": np.asarray(getattr(each, name)) for name in _ARRAYS}
    write_arrays(path, arrays)


def read_shaper(path: str | Path) -> ShaperFile:
    """Read a SHAPER file.

    Raises
    ------
    UnusableInputError
        The file is missing or no .npz archive, lacks an array, or holds no valid shaper.
    """
    arrays = read_arrays(path, "a SHAPER file")
    axes = [str(axis) for axis in np.atleast_1d(arrays.get("axes", np.array([], dtype=np.str_)))]
    needed = ["format", "axes", "sample_rate_Hz", "notes", *(f"{name}_{axis}" for axis in axes for name in _ARRAYS)]
    missing = [name for name in needed if name not in arrays]
    if missing or not axes:
        raise UnusableInputError(f"{path}: not a SHAPER file: {f'the array {missing[0]} is missing' if missing else 'it shapes no axis'}")
    if int(arrays["format"]) != FORMAT:
        raise UnusableInputError(f"{path}: SHAPER format {int(arrays['format'])}; this version reads {FORMAT}")
    try:
        shapers = tuple(_axis(arrays, axis) for axis in axes)
        notes = json.loads(str(arrays["notes"]))
    except (DesignError, ValueError, TypeError) as error:
        raise UnusableInputError(f"{path}: {error}") from None
    return ShaperFile(shapers, float(arrays["sample_rate_Hz"]), notes)


def _axis(arrays: dict[str, np.ndarray], axis: str) -> AxisShaper:
    found = {name: arrays[f"{name}_{axis}"] for name in _ARRAYS}
    delays = found["delays"]
    if not np.issubdtype(delays.dtype, np.integer):
        raise DesignError(f"delays_{axis} must be whole numbers of samples")
    return AxisShaper(
        axis,
        delays.astype(np.int64),
        np.asarray(found["gains"], dtype=float),
        np.asarray(found["positions"], dtype=float),
        str(found["schedule_axis"]),
        np.asarray(found["tail"], dtype=float),
        float(found["static_gain"]),
        str(found["name"]),
    )
