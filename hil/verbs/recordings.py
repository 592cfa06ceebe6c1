"""The recordings of one experiment, and what functions take in their place."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, overload

import numpy as np

from hil.errors import RecordingError
from hil.files.frames import stacked
from hil.recording import Channel, Recording, read_recording, recording_metadata
from hil.recording.naming import machine_unit
from hil.simulation import in_effort

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

    Examples
    --------
    >>> import hil, pandas
    >>> frame = pandas.DataFrame({"position_roll": [0.0, 90.0]}, index=[0.0, 0.005])
    >>> hil.recording_from_frame(frame, units={"position_roll": "deg"})["position_roll"].round(4).tolist()
    [0.0, 1.5708]
    """
    known = {**frame.attrs.get("units", {}), **(units or {})}
    columns = {str(name): np.asarray(frame[name], dtype=float) for name in frame.columns}
    columns = {"time": columns.pop("time", np.asarray(frame.index, dtype=float)), **columns}
    units = {"time": "s"} | {
        name: machine_unit(name, machine, "the frame") for name in columns if machine is not None and name not in known
    }
    channels = {name: Channel(known.get(name, units.get(name, "")), values) for name, values in columns.items()}
    return Recording(channels, {} if machine is None else recording_metadata(machine))


Given = Recording | Recordings | str | Path
"""A recording, those of one experiment, or a file to be read."""

Several = Given | Iterable[Given]
"""What a function takes that works on any number of recordings."""


def each_of(given: Several) -> list[Given]:
    """Return what was given, one or several, as a list."""
    return [given] if isinstance(given, Recording | Recordings | str | Path) else list(given)


def every_one(recordings: Several, called: str = "recording", machine: Machine | None = None) -> dict[str, Recording]:
    """Return recordings by name, files by that without suffix; those without a name are called by their number.

    `machine` is for files that do not carry theirs.
    """
    found: dict[str, Recording] = {}
    for part in each_of(recordings):
        for name, recording in part.items() if isinstance(part, Recordings) else (_named(part, machine),):
            number = len(found)
            while not name or name in found:
                number += 1
                name = f"{called} {number}"
            found[name] = recording
    return found


def the_one(given: Given, machine: Machine | None = None) -> Recording:
    """Return the recording; RecordingError where there are several.

    Raises
    ------
    RecordingError
        There are several, or none.
    """
    if not isinstance(given, Recordings):
        return _named(given, machine)[1]
    if len(given) != 1:
        raise RecordingError(f"{len(given)} recordings ({', '.join(given.names)}): give one of them, such as recordings[0]")
    return given[0]


def efforts(recordings: Several, machine: Machine) -> list[Recording]:
    """Return recordings of a machine, with commands in effort."""
    return [in_effort(each, machine) for each in every_one(recordings, machine=machine).values()]


def _named(given: Recording | str | Path, machine: Machine | None) -> tuple[str, Recording]:
    return ("", given) if isinstance(given, Recording) else (Path(given).stem, read_recording(given, machine))
