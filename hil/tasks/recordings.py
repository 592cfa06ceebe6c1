"""The recordings of one experiment, and what functions take in their place."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, overload

import numpy as np

from hil.errors import RecordingError
from hil.files.frames import stacked
from hil.recording import Channel, Recording, recording_metadata
from hil.recording.naming import machine_unit

if TYPE_CHECKING:
    import pandas as pd

    from hil.machine import Machine


class Recordings(Sequence[Recording]):
    """The recordings of one experiment in the order in which they were run: of a multisine its realisations and experiments.

    Parameters
    ----------
    named : mapping of str to Recording
        By name, as `run_r1_e2` for realisation 1, experiment 2.
    """

    def __init__(self, named: Mapping[str, Recording]) -> None:
        self._named = dict(named)

    @property
    def names(self) -> tuple[str, ...]:
        """Name of each."""
        return tuple(self._named)

    @overload
    def __getitem__(self, place: int) -> Recording: ...
    @overload
    def __getitem__(self, place: slice) -> Recordings: ...
    def __getitem__(self, place: int | slice) -> Recording | Recordings:
        """Return one by its place, or some."""
        if isinstance(place, slice):
            return Recordings({name: self._named[name] for name in self.names[place]})
        return self._named[self.names[place]]

    def __len__(self) -> int:
        """Return how many there are."""
        return len(self._named)

    def __iter__(self) -> Iterator[Recording]:
        """Go through them."""
        return iter(self._named.values())

    def __repr__(self) -> str:
        """Name them."""
        return f"Recordings({', '.join(self.names)})"

    def items(self) -> Iterable[tuple[str, Recording]]:
        """Return names and recordings."""
        return self._named.items()

    def frame(self) -> pd.DataFrame:
        """Return all of them, one above the other, by recording and time [s]; UnusableInputError without pandas, an extra."""
        return stacked({name: recording.frame() for name, recording in self._named.items()}, "recording")


def recording_from_frame(frame: pd.DataFrame, machine: Machine | None = None, units: Mapping[str, str] | None = None) -> Recording:
    """Make a recording of a data frame: columns are channels, their index is time [s] unless there is a column `time`.

    Parameters
    ----------
    frame : pandas.DataFrame
        Columns named as channels: `reference_roll`, `position_roll`, `command_roll`, `current_roll`, `imu_y` and so on.
    machine : Machine, optional
        Of which it is a recording; its units are taken where none are given.
    units : mapping of str to str, optional
        Unit of a channel by its name, such as `deg`, `mA` or `ms`; also `frame.attrs["units"]`. Converted to SI.

    Raises
    ------
    RecordingError
        An unknown channel or unit, or time that does not increase.
    """
    known = {**frame.attrs.get("units", {}), **(units or {})}
    columns = {str(name): np.asarray(frame[name], dtype=float) for name in frame.columns}
    columns = {"time": columns.pop("time", np.asarray(frame.index, dtype=float)), **columns}
    units = {"time": "s"} | {
        name: machine_unit(name, machine, "the frame") for name in columns if machine is not None and name not in known
    }
    channels = {name: Channel(known.get(name, units.get(name, "")), values) for name, values in columns.items()}
    return Recording(channels, {} if machine is None else recording_metadata(machine))


Several = Recording | Recordings | Iterable[Recording | Recordings]
"""What a function takes that works on any number of recordings."""


def every_one(recordings: Several, called: str = "recording") -> dict[str, Recording]:
    """Return recordings by name; those without a name are called by their number."""
    found: dict[str, Recording] = {}
    for part in [recordings] if isinstance(recordings, Recording | Recordings) else recordings:
        for name, recording in part.items() if isinstance(part, Recordings) else (("", part),):
            found[name if name and name not in found else f"{called} {len(found) + 1}"] = recording
    return found


def the_one(recording: Recording | Recordings) -> Recording:
    """Return the recording; RecordingError where there are several.

    Raises
    ------
    RecordingError
        There are several, or none.
    """
    if isinstance(recording, Recording):
        return recording
    if len(recording) != 1:
        raise RecordingError(f"{len(recording)} recordings ({', '.join(recording.names)}): give one of them, such as recordings[0]")
    return recording[0]
