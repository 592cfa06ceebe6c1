"""From recordings to the answer: checked, audited, then diagnosed along their motion. docs/explanation/diagnosis.md follows it."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path

import numpy as np

from hil.diagnosis.audit.audit import Audit, audit
from hil.diagnosis.audit.recordings import faults
from hil.diagnosis.free_runs.runs import free_runs
from hil.diagnosis.model_choice.alternatives import is_spanned, times_noise
from hil.diagnosis.model_choice.choose import Choice, choose_effects, engineers_fit
from hil.diagnosis.model_choice.far_off import with_numbers_far_off
from hil.diagnosis.model_choice.fitting import Fitted
from hil.diagnosis.residuals.residuals import Residuals, residuals_of
from hil.diagnosis.result import Diagnosis
from hil.diagnosis.selection.select import select
from hil.diagnosis.verdict.answer import EFFECTS_CHOSEN, WEIGHED, answer
from hil.diagnosis.verdict.early import first_answer, nothing_moves, play_measured, wrong_recordings
from hil.diagnosis.verdict.values import Everyday, Outcome, everyday_of
from hil.diagnosis.verdict.without_repeats import answer_of_runs
from hil.errors import RecordingError
from hil.machine import Machine
from hil.processes.kept_memory import keep_memory
from hil.recording import Recording

MOST_JOINTS = 3
"""Of machines that free runs judge: each joint brings a dozen numbers and forty laws, each of which is a simulation of all joints."""
FITTED, SOUGHT, USUAL = 0.2, 0.5, 12
"""Share of the whole before the search, and of the search, half of which is done after so many steps as usual."""
Report = Callable[[str, float], None]
"""Told what is being done, and the share of the whole that is done."""


def diagnose(
    machine: Machine,
    recordings: Mapping[str, Recording],
    held_out: Mapping[str, Recording] | None = None,
    *,
    report: Report = lambda what, share: None,
    first: Callable[[Diagnosis], None] = lambda diagnosis: None,
    freely: bool = False,
    jobs: int | None = None,
) -> Outcome:
    """Diagnose a machine from its recordings.

    Parameters
    ----------
    machine : Machine
        The simulation.
    recordings, held_out : mapping of str to Recording
        By name; held-out ones are scored, and choose no name; they may take assurance away.
    report : callable
        Told what is being done, and the share that is done.
    first : callable
        Told a first answer as soon as there is one.
    freely : bool
        Whether effects are judged by free runs of the closed loop, or not at all.
    jobs : int, optional
        Processors that free runs may use; all of them unless given.

    Raises
    ------
    RecordingError
        Recordings that cannot be used, or that free runs are not possible beside.
    """
    held_out = held_out or {}
    audited = audit_recordings(machine, recordings, held_out)
    return diagnose_audited(machine, recordings, held_out, audited, freely=freely, jobs=jobs, report=report, first=first)


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
    return audit(machine, recordings)


def diagnose_audited(
    machine: Machine,
    recordings: Mapping[str, Recording],
    held_out: Mapping[str, Recording],
    audited: Audit,
    *,
    freely: bool = False,
    jobs: int | None = None,
    report: Report = lambda what, share: None,
    first: Callable[[Diagnosis], None] = lambda diagnosis: None,
) -> Outcome:
    """Diagnose a machine from audited recordings; as `diagnose`, with their audit by `audit_recordings`."""
    began = time.monotonic()
    keep_memory()
    report("reading the motion", 0.0)
    residuals = _residuals_or_answer(machine, recordings, held_out, audited, began, freely=freely)
    if isinstance(residuals, Outcome):
        return residuals
    free = free_runs(residuals, audited, jobs) if freely else None

    def say(baseline: Fitted) -> None:
        first(first_answer(machine, audited, residuals, baseline, time.monotonic() - began))

    if not freely and is_judged_by_runs(residuals):
        report("fitting numbers and friction", 0.1)
        levels, _, baseline = engineers_fit(residuals)
        say(baseline)
        tried = itertools.count(1)

        def trying(_: str) -> None:
            done = next(tried)
            report("trying numbers and laws in simulations", FITTED + SOUGHT * done / (done + USUAL))

        if (selected := select(machine, recordings, trying, jobs)) is not None:
            return answer_of_runs(machine, audited, residuals, levels, selected, held_out, began, report)
    choice = choose_effects(residuals, free, report, say)
    if not freely and (freed := with_numbers_far_off(choice)) is not None:
        return answer(machine, audited, freed, held_out, began, report)
    is_converged = freely or residuals.noise == "assumed" or len(residuals.trajectories[0].joints) > MOST_JOINTS
    again = None if is_converged else partial(_freely, machine, recordings, audited, jobs, report)
    return answer(machine, audited, choice, held_out, began, report, again)


def _freely(
    machine: Machine, recordings: Mapping[str, Recording], audited: Audit, jobs: int | None, report: Report, choice: Choice
) -> Choice | None:
    """Return what free runs of the closed loop name beside what was named along the motion; None where they cannot judge, or leave more.

    Along a recorded motion equations are linear: where they do not settle what acts, simulations may.
    """
    residuals = residuals_of(machine, recordings, freely=True)
    try:
        free = free_runs(residuals, audited, jobs)
    except RecordingError:
        return None
    found = choose_effects(
        residuals, free, lambda what, share: report(f"{what} by free runs", EFFECTS_CHOSEN + (WEIGHED - EFFECTS_CHOSEN) * share)
    )
    return found if is_spanned(found) or times_noise(found) < times_noise(choice) else None


def fit_everyday(machine: Machine, recordings: Mapping[str, Recording]) -> Everyday:
    """Fit the machine's numbers and the everyday effects at every driven joint to recordings, by name, and seek nothing else.

    Raises
    ------
    RecordingError
        As `audit_recordings` does.
    """
    began = time.monotonic()
    keep_memory()
    audited = audit_recordings(machine, recordings, {})
    residuals = _residuals_or_answer(machine, recordings, {}, audited, began)
    if isinstance(residuals, Outcome):
        return Everyday(residuals.diagnosis)
    *_, fitted = engineers_fit(residuals)
    return everyday_of(machine, first_answer(machine, audited, residuals, fitted, time.monotonic() - began), fitted)


def _residuals_or_answer(
    machine: Machine, recordings: Mapping[str, Recording], held_out: Mapping[str, Recording], audited: Audit, began: float, *,
    freely: bool = False,
) -> Residuals | Outcome:  # fmt: skip
    """Return what is seen along the recordings' motion, or the answer where that needs no fit."""
    if audited.faults:
        return wrong_recordings(machine, audited, {**recordings, **held_out}, time.monotonic() - began)
    residuals = residuals_of(machine, recordings, freely=freely)
    if residuals.is_still:
        return nothing_moves(machine, audited, residuals, time.monotonic() - began)
    if audited.has_play:
        return play_measured(machine, audited, residuals, time.monotonic() - began)
    return residuals


def is_judged_by_runs(residuals: Residuals) -> bool:
    """Return whether free runs of windows, or of the loop, judge: nothing repeats, and joint sensors alone follow every joint."""
    if len(residuals.trajectories[0].joints) > MOST_JOINTS:
        return False
    sensors = {sensor.channel for sensor in residuals.trajectories[0].settings.joint_sensors}
    return (
        residuals.noise == "assumed"
        and not residuals.shown
        and not residuals.trajectories[0].imposed
        and all(trajectory.followed.all() and sensors.issuperset(trajectory.observed.channels) for trajectory in residuals.trajectories)
    )


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
