"""Whether a simulation agrees with its recording, and what differs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from hil.verbs.errors import as_bench_errors
from hil.verbs.verb import KEPT, NOBODY, RECORDING, Listener, argument, option

if TYPE_CHECKING:
    from hil.machine import Machine
    from hil.recording import Recording
    from hil.simulation import ChannelComparison, Comparison
    from hil.verbs.recordings import Given, Recordings, Several


@dataclass(frozen=True)
class CompareRequest:
    """A recording and its simulation, or their files."""

    recording: Given = argument(RECORDING, "REC")
    simulation: Given = argument("Its simulation.", "SIM")
    repeats: Several = option(
        "The same experiment recorded again, which shows the noise; repeatable.", "REC", "--repeat", default=(), is_several=True
    )
    machine: Machine | None = None
    """For recordings that do not carry theirs."""


@dataclass(frozen=True)
class CompareAnswer:
    """What differs, channel by channel, in units of the noise."""

    verdict: str
    """The answer in a sentence."""
    agrees: bool
    """Whether no channel differs by more than its noise."""
    noise: str
    """Where the noise is known from: `repeats`, `periods`, or `assumed`."""
    channels: Mapping[str, ChannelComparison]
    """Channel to what differs in it."""
    only_recorded: tuple[str, ...]
    """Channels that only the recording has."""
    only_simulated: tuple[str, ...]
    """Channels that only the simulation has."""
    emulated: bool
    """Whether the recording was made on the emulator."""
    comparison: Comparison = field(metadata=KEPT, repr=False)
    recorded: Recording = field(metadata=KEPT, repr=False)


def answer(request: CompareRequest, listener: Listener = NOBODY) -> CompareAnswer:
    """Compare a recording with its simulation; raises as `compare` does, and RecordingError where a file cannot be read."""
    from hil.simulation import compare as compared
    from hil.verbs.recordings import every_one, the_one

    recorded = the_one(request.recording, request.machine)
    repeats = list(every_one(request.repeats, machine=request.machine).values())
    found = compared(recorded, the_one(request.simulation, request.machine), repeats)
    channels = {each.name: each for each in found.channels}
    told = found.verdict, found.agrees, found.noise.source, channels, found.only_recorded, found.only_simulated
    return CompareAnswer(*told, recorded.emulated, found, recorded)


@as_bench_errors()
def compare(recording: Recording | Recordings, simulation: Recording | Recordings, repeats: Several = ()) -> Comparison:
    """Compare a recording with its simulation, channel by channel, in units of noise.

    Parameters
    ----------
    recording, simulation : Recording
        Of the same rows.
    repeats : Recording, Recordings or several of them
        Of the same experiment, which show the noise; without any it is from the recording's periods, or assumed.

    Returns
    -------
    Comparison
        `.verdict` and `.table()` for a person, `comparison["position_roll"].rms`, `.frame()` for pandas.

    Raises
    ------
    RecordingError
        Rows, times or units differ, no channel is common to both, or there are several recordings.

    Examples
    --------
    >>> import hil
    >>> import numpy as np
    >>> time_s, swing = np.arange(1000) / 200.0, np.sin(np.arange(1000) / 50.0)
    >>> was, simulated = (
    ...     hil.Recording({"time": hil.Channel("s", time_s), "position_roll": hil.Channel("rad", swing + offset)}, {})
    ...     for offset in (0.001, 0.0)
    ... )
    >>> round(hil.compare(was, simulated)["position_roll"].rms, 6)
    0.001
    """
    return answer(CompareRequest(recording, simulation, repeats)).comparison
