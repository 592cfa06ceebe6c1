"""Whether recordings are what they say, before anything is explained: docs/explanation/diagnosis.md, "Wrong recordings"."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from hil.diagnosis.audit.belonging import belonging_faults
from hil.diagnosis.audit.laws import law_faults
from hil.diagnosis.audit.readings import Fault, channels_of, reading_faults, smooth_faults, stamp_fault
from hil.errors import RecordingError
from hil.machine import Machine
from hil.recording import Recording

COPIES = (("position", "reference"), ("link_position", "reference"), ("current", "command"))
"""What is measured is never to the last digit what was asked for; a lattice that both lie on makes it so."""


def faults(machine: Machine, recordings: Mapping[str, Recording]) -> list[Fault]:
    """Return what is wrong with recordings, each channel's first fault; where several recordings have one, it is said once.

    Raises
    ------
    RecordingError
        A recording has no channel of the machine's axes.
    """
    found: list[Fault] = []
    for label, recording in recordings.items():
        if not any(kind != "reference" for kind, _, _ in channels_of(machine, recording)):
            wanted = f"position_{machine.axes[0]}, current_{machine.axes[0]} or command_{machine.axes[0]}"
            raise RecordingError(f"{label}: no measured channel of {machine.name}; {wanted} would be right: another machine's file?")
        known = {(fault.channel, fault.is_lack) for fault in found}
        found += [fault for fault in _faults(machine, label, recording) if (fault.channel, fault.is_lack) not in known]
    return found


def _faults(machine: Machine, label: str, recording: Recording) -> list[Fault]:
    """Return the faults of one recording; what would follow from another fault is not looked for."""
    found = _copies(machine, label, recording) or reading_faults(machine, label, recording)
    if found:
        return found
    found, lawful = law_faults(machine, label, recording)
    if not found and (stamps := stamp_fault(machine, label, recording)) is not None:
        found = [stamps]
    return found or belonging_faults(machine, label, recording, lawful) or smooth_faults(machine, label, recording, lawful)


def _copies(machine: Machine, label: str, recording: Recording) -> list[Fault]:
    """Return the channels that hold another one's numbers."""
    pairs = [(f"{kind}_{axis}", f"{of}_{axis}") for kind, of in COPIES for axis in machine.axes]
    pairs += [
        (f"{kind}_{axis}", f"{kind}_{other}")
        for kind in ("position", "link_position", "speed", "current")
        for number, other in enumerate(machine.axes)
        for axis in machine.axes[number + 1 :]
    ]
    lattices = {encoder.channel: encoder.resolution for encoder in machine.plant.encoders}
    lattices |= {current.channel: current.resolution for current in machine.plant.currents}
    found = []
    for name, other in pairs:
        is_asked = other.startswith(("reference", "command"))
        lattice = lattices.get(name, 0.0) if is_asked else 0.0
        if name in recording and other in recording and _is_copy(recording[name], recording[other], lattice):
            what = f"what was asked for ({other})" if is_asked else other
            found.append(
                Fault(
                    label,
                    name,
                    False,
                    f"{label}: {name} has the numbers of {other}, row for row: it is a copy of {what}, and was not measured",
                )
            )
    return found


def _is_copy(values: np.ndarray, others: np.ndarray, lattice: float) -> bool:
    for rows in (0, 1):
        mine, theirs = values[rows:], others[: len(others) - rows]
        there = np.isfinite(mine) & np.isfinite(theirs)
        mine, theirs = mine[there], theirs[there]
        if len(mine) > 1 and np.ptp(theirs) > 0.0 and np.array_equal(mine, theirs):
            return lattice == 0.0 or bool(np.abs(theirs / lattice - np.round(theirs / lattice)).max() >= 1e-3)
    return False
