"""A diagnosis along the recorded motion: efforts in, motions out, no controller in between. docs/explanation/diagnosis.md follows it."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping

from hil.diagnosis.answered.answer import Answered, answer, first_answer, nothing_seen, play_seen
from hil.diagnosis.audit.audit import Audit
from hil.diagnosis.named.fitting import Fitted
from hil.diagnosis.named.naming import name
from hil.diagnosis.observed.groups import groups
from hil.diagnosis.result import Diagnosis
from hil.diagnosis.seen.see import see
from hil.machine import Machine
from hil.recording import Recording


def diagnose_along(
    machine: Machine,
    recordings: Mapping[str, Recording],
    held_out: Mapping[str, Recording],
    audit: Audit,
    report: Callable[[str, float], None] = lambda what, share: None,
    first: Callable[[Diagnosis], None] = lambda diagnosis: None,
) -> Answered:
    """Diagnose a machine along its recorded motion.

    Parameters
    ----------
    machine : Machine
        The simulation.
    recordings, held_out : mapping of str to Recording
        By name; held-out ones are scored and decide nothing.
    audit : Audit
        Of all of these recordings.
    report : callable, optional
        Told what is being done, and the share of the whole that is done.
    first : callable, optional
        Told a first answer as soon as there is one.

    Raises
    ------
    RecordingError
        Recordings that cannot be used.
    """
    began = time.monotonic()
    report("seeing", 0.0)
    seen = see(machine, recordings)
    if seen.still:
        return nothing_seen(machine, audit, seen, time.monotonic() - began)
    if audit.has_play:
        return play_seen(machine, audit, seen, time.monotonic() - began)

    def say(baseline: Fitted) -> None:
        first(first_answer(machine, audit, seen, baseline, time.monotonic() - began))

    named = name(seen, report, say)
    report("weighing rivals", 0.9)
    return answer(machine, audit, named, held_out, began)


def is_along_the_motion(machine: Machine, recordings: Mapping[str, Recording], audit: Audit) -> bool:
    """Return whether recordings are diagnosed along their motion, and not by free runs of the closed loop.

    They are where no free run of the loop would be the machine's: its controllers are not the file's, or are not known; or where nothing
    repeats, so that a free run cannot be told from noise. Play that encoders show is read off.
    """
    if audit.has_play or not audit.are_controllers_as_filed:
        return True
    has_periods = any(recording.experiment.get("period_samples") for recording in recordings.values())
    return not has_periods and all(len(group.repeats) == 1 for group in groups(machine, recordings))
