"""What there is to do for a fleet: each task as a job whose name is made of the hashes of all that goes into it."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from itertools import groupby
from pathlib import Path

from hil.errors import UnusableInputError
from hil.fleet.file import Fleet, FleetMachine, TaskName, When
from hil.fleet.job import Job
from hil.fleet.listing import KnownHashes, StoredRecording, list_recordings
from hil.machine.load import load_machine
from hil.machine.machine import Machine
from hil.verbs.errors import as_bench_errors

WORK = "hil.fleet.work:work"

IDENTITY_DIGITS, CONTENT_DIGITS = 12, 20
"""Of a result's name: hexadecimal digits of what it is of (machine, night, task, recordings' names) and of what went into it."""


@dataclass(frozen=True)
class Task:
    """A task of one machine and night, and when it is done; `name` is the path of its result under the store's folder of results."""

    machine: str
    date: str
    kind: TaskName
    name: str
    job: Job
    when: When = "always"


@dataclass
class Plan:
    """Tasks of a fleet, and a line for each thing that cannot be used."""

    tasks: list[Task] = field(default_factory=list)
    wrong: list[str] = field(default_factory=list)


def plan_fleet(fleet: Fleet, store: Path, progress: Callable[[int, int], None] = lambda done, total: None) -> Plan:
    """List all recordings and return every task there is for them, done before or not."""
    plan, known = Plan(), KnownHashes(store)
    for place, machine in enumerate(fleet.machines):
        try:
            with as_bench_errors():
                loaded = load_machine(machine.file)
            recordings, wrong = list_recordings(machine.recordings, known, "calibrate" in machine.tasks)
        except UnusableInputError as problem:
            plan.wrong.append(f"{machine.name}: {problem}")
        else:
            plan.wrong += [f"{machine.name}: {line}" for line in wrong]
            plan.tasks += _tasks(fleet, machine, loaded, recordings)
        progress(place + 1, len(fleet.machines))
    known.keep()
    return plan


def _tasks(fleet: Fleet, machine: FleetMachine, loaded: Machine, recordings: list[StoredRecording]) -> Iterable[Task]:
    """Return the tasks of a machine, night by night."""
    by_date = sorted(recordings, key=lambda one: (one.night.date(), one.file.name))
    for _, group in groupby(by_date, key=lambda one: one.night.date()):
        scans = list(group)
        night = [replace(one, images=()) for one in scans]
        held_out = [one for one in night if _is_of(one, machine.held_out)]
        train = [one for one in night if _is_of(one, machine.repeats) and one not in held_out]
        parts: list[tuple[TaskName, str, list[StoredRecording], list[StoredRecording]]] = []
        if "check" in machine.tasks:
            parts += [("check", _experiment(one, machine), [one], []) for one in night]
        if "identify" in machine.tasks:
            groups = [(pattern, [one for one in night if _is_of(one, [pattern])]) for pattern in machine.identified]
            parts += [("identify", pattern, of_pattern, []) for pattern, of_pattern in groups if of_pattern]
        if "calibrate" in machine.tasks:
            parts += [("calibrate", _experiment(one, machine), [one], []) for one in scans if one.images]
        if "friction" in machine.tasks and train:
            parts.append(("friction", ", ".join(machine.repeats), train, []))
        if "diagnose" in machine.tasks and train:
            parts.append(("diagnose", ", ".join(machine.repeats), train, held_out))
        for part in parts:
            yield _task(fleet, machine, loaded, *part)


def identity_of(name: str) -> str:
    """Return the part of a result's name that stays when other recordings of the same night come later, or another machine file."""
    return name[: -CONTENT_DIGITS - len(".parquet")]


def _task(
    fleet: Fleet,
    machine: FleetMachine,
    loaded: Machine,
    kind: TaskName,
    experiment: str,
    train: list[StoredRecording],
    held: list[StoredRecording],
) -> Task:
    night, needs = min(one.night for one in [*train, *held]), fleet.needs[kind]
    date = night.date().isoformat()
    argument = {
        "task": kind,
        "machine": machine.name,
        "machine_file": {"text": loaded.text, "hash": loaded.hash, "path": None if loaded.path is None else str(loaded.path)},
        "night": night.isoformat(),
        "experiment": experiment,
        "recordings": [one.document() for one in train],
        "held_out": [one.document() for one in held],
        "threads": needs.threads,
    }
    of = train[0].file.name if kind in ("check", "calibrate") else ""
    identity = _digits([machine.name, date, kind, experiment, of], IDENTITY_DIGITS)
    read = [[[one.file.name, *one.hashes] for one in group] for group in (train, held)]
    name = f"machine={machine.name}/date={date}/{kind}-{identity}{_digits([loaded.hash, *read], CONTENT_DIGITS)}.parquet"
    when = machine.diagnose_when if kind == "diagnose" else "always"
    if when == "differs" and "check" not in machine.tasks:
        when = "always"
    return Task(machine.name, date, kind, name, Job(name, WORK, argument, needs), when)


def _experiment(recording: StoredRecording, machine: FleetMachine) -> str:
    """Return the pattern that a recording is of, of one without its own name, less the date."""
    return next((one for one in (*machine.repeats, *machine.held_out) if _is_of(recording, [one])), recording.undated)


def _is_of(recording: StoredRecording, patterns: Iterable[str]) -> bool:
    return any(fnmatchcase(recording.stem, pattern) for pattern in patterns)


def _digits(value: object, count: int) -> str:
    return hashlib.sha256(json.dumps(value, ensure_ascii=False).encode("utf-8")).hexdigest()[:count]
