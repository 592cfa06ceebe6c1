"""From recordings to the answer: checked, audited, then diagnosed along the motion or by free runs, whichever they allow."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from hil.diagnosis.answered.answer import Answered, wrong_recordings
from hil.diagnosis.audit.audit import Audit, audit
from hil.diagnosis.audit.recordings import faults
from hil.diagnosis.by_motion import diagnose_along, is_along_the_motion, with_second_opinion
from hil.diagnosis.diagnose import Outcome, Report, diagnose
from hil.diagnosis.result import Diagnosis
from hil.errors import RecordingError
from hil.machine import Machine
from hil.processes.kept_memory import keep_memory
from hil.recording import Recording

MOST_THREADS = 4
"""By default: more would find little to do, since eight runs go side by side in each and fits wait for their answers."""


def audit_recordings(machine: Machine, recordings: Mapping[str, Recording], held_out: Mapping[str, Recording]) -> Audit:
    """Audit recordings, by name, before any physics is sought; where they are not what they say, only its `faults` are there.

    Raises
    ------
    RecordingError
        A recording is of a machine with other axes, has no measured channel, or holds the same rows as another.
    """
    everything = {**recordings, **held_out}
    for label, recording in everything.items():
        check_axes(label, recording, machine)
    if wrong := tuple(faults(machine, everything)):
        return Audit(machine, (), (), wrong)
    _check_no_copies(recordings, held_out)
    return audit(machine, list(recordings.values()))


def diagnose_audited(
    machine: Machine,
    recordings: Mapping[str, Recording],
    held_out: Mapping[str, Recording],
    audited: Audit,
    *,
    jobs: int | None = None,
    report: Report = lambda what, share: None,
    first: Callable[[Diagnosis], None] = lambda diagnosis: None,
) -> Outcome | Answered:
    """Diagnose a machine from audited recordings.

    Parameters
    ----------
    machine : Machine
        The simulation.
    recordings, held_out : mapping of str to Recording
        By name; nothing is fitted to the held-out ones.
    audited : Audit
        By `audit_recordings`.
    jobs : int, optional
        Threads; one per processor unless given, `MOST_THREADS` at most. The answer does not depend on it.
    report, first : callable
        Told what is being done and the share that is done; told a first answer as soon as there is one.

    Raises
    ------
    RecordingError
        Recordings that cannot be used.
    """
    began = time.monotonic()
    keep_memory()
    if audited.faults:
        return wrong_recordings(machine, audited, {**recordings, **held_out}, time.monotonic() - began)
    if is_along_the_motion(machine, recordings, audited):
        return diagnose_along(machine, recordings, held_out, audited, report, first)
    outcome = diagnose(machine, recordings, held_out, jobs=_processors() if jobs is None else jobs, report=report)
    report("looking along the motion", 0.98)
    diagnosis = with_second_opinion(machine, recordings, outcome.diagnosis)
    return replace(outcome, diagnosis=replace(diagnosis, audit=audited.document()))


def _processors() -> int:
    """Return the number of processors that this process may use."""
    return min(len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1, MOST_THREADS)


def check_axes(label: str | Path, recording: Recording, machine: Machine) -> None:
    """Raise RecordingError where a recording is of a machine without one of this machine's axes, and has no such channel."""
    own = recording.metadata.get("machine", {})
    axes = own.get("axes") or machine.axes
    if any(axis not in axes and not {f"reference_{axis}", f"command_{axis}"} & set(recording.channels) for axis in machine.axes):
        has = f"{own.get('name', 'a machine')} with axes {', '.join(axes)}; {machine.name} has {', '.join(machine.axes)}"
        raise RecordingError(f"{label}: recorded of {has}: give recordings of this machine, or the other one's file")


def _check_no_copies(train: Mapping[str, Recording], held: Mapping[str, Recording]) -> None:
    """Raise RecordingError where a recording holds the same rows as another: a copy under another name, or the same seed."""
    earlier: dict[str, Recording] = {}
    for label, recording in {**train, **held}.items():
        for other, its in earlier.items():
            if not _same_rows(recording, its):
                continue
            if label in held and other in train:
                raise RecordingError(f"{label}: holds the same rows as {other}, which is fitted to; hold out a recording of another motion")
            raise RecordingError(f"{label}: holds the same rows as {other}; give each recording once (emulated: its own --seed each)")
        earlier[label] = recording


def _same_rows(one: Recording, other: Recording) -> bool:
    names = set(one.channels)
    return names == set(other.channels) and all(np.array_equal(one[n], other[n], equal_nan=True) for n in names)
