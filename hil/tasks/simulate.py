"""Simulations of recordings, and what differs."""

from __future__ import annotations

from typing import overload

from hil.machine import Machine
from hil.recording import Recording
from hil.simulation import Comparison
from hil.simulation import compare as compare_recordings
from hil.simulation import simulate as simulate_recording
from hil.tasks.errors import as_bench_errors
from hil.tasks.recordings import Recordings, Several, every_one, the_one


@overload
def simulate(machine: Machine, recording: Recording) -> Recording: ...
@overload
def simulate(machine: Machine, recording: Recordings) -> Recordings: ...
@as_bench_errors()
def simulate(machine: Machine, recording: Recording | Recordings) -> Recording | Recordings:
    """Simulate what a machine would have recorded, noise off, from a recording's reference and excitation.

    Parameters
    ----------
    machine : Machine
        With effects where it has some: `machine.with_effect(...)`.
    recording : Recording or Recordings

    Returns
    -------
    Recording or Recordings
        The same rows.

    Raises
    ------
    RecordingError
        The reference (or command) is missing or has a hole, or the sample rate is not the machine's.
    BadAnswerError
        The simulation diverged.
    """
    if isinstance(recording, Recording):
        return simulate_recording(machine, recording)
    return Recordings({name: simulate_recording(machine, each) for name, each in recording.items()})


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
    """
    return compare_recordings(the_one(recording), the_one(simulation), list(every_one(repeats).values()))
