"""A fleet's new work: planned, computed where it is told to, and each result kept as soon as it is there."""

from __future__ import annotations

import math
import os
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Any, Literal

from hil.errors import UnusableInputError
from hil.fleet.answers import FAILED, UNUSABLE, Number, failure
from hil.fleet.engine import Engine, cancelled_by_key, one_by_one
from hil.fleet.file import Fleet, read_fleet
from hil.fleet.job import Job, Outcome
from hil.fleet.keep import Keeper
from hil.fleet.plan import Task, identity_of, plan_fleet
from hil.fleet.store import names_in, query_fleet
from hil.version import software_version

Again = Literal["failed", "earlier"]
AGAIN = {
    "failed": f"select distinct file from results where verdict = '{FAILED}'",
    "earlier": f"select distinct file from results where software_version <> '{software_version()}'",
}
"""Results that are computed again on demand: those that the computer failed on, or that another version of the software made."""

DIFFERS = "select distinct machine, strftime(night, '%Y-%m-%d') from results where task = 'check' and verdict = 'differs'"

NUMBERS = "select 1 from results where value is not null limit 1"


@dataclass
class FleetRun:
    """What a run did.

    Attributes
    ----------
    planned : tasks that the recordings make; of those, `present` had a result and `unneeded` are diagnoses of
        nights on which nothing differs, or changed.
    done : results that were written, failures among them.
    failures : a line for each result without an answer that was written.
    wrong : a line for everything that could not be used: machine files, folders, recordings without a date.
    cancelled : whether Ctrl-C ended it early.
    """

    store: Path
    planned: int = 0
    present: int = 0
    unneeded: int = 0
    done: int = 0
    failures: list[str] = field(default_factory=list)
    wrong: list[str] = field(default_factory=list)
    cancelled: bool = False
    by_verdict: Counter[str] = field(default_factory=Counter)


def run_fleet(
    fleet: Fleet | str | Path,
    *,
    store: str | Path | None = None,
    scheduler: str | None = None,
    workers: int | None = None,
    again: Again | None = None,
    progress: Callable[[str, int, int], None] = lambda what, done, total: None,
    say: Callable[[str], None] = lambda line: None,
) -> FleetRun:
    """Compute what a fleet's recordings have no result for yet.

    Parameters
    ----------
    fleet : Fleet, or the path of its file
    store : str or Path, optional
        Folder of the results; the file's unless given.
    scheduler : str, optional
        Of a Dask cluster, as `tcp://HOST:PORT` or `tls://HOST:PORT`.
    workers : int, optional
        Without a scheduler: how many processes of this computer work on it, through Dask; 0: one, without Dask. One per processor unless
        given.
    again : "failed" or "earlier", optional
        Compute also what failed for want of time, memory or a worker; or what an earlier version of the software computed.
    progress : callable
        Told what is being done, and how many of how many.
    say : callable
        Told of each failure, and of what becomes of the cluster.

    Returns
    -------
    FleetRun

    Raises
    ------
    UnusableInputError
        The fleet's file, the store or the cluster cannot be used.
    RecordingError
        A result cannot be written (disk full); what was written before is kept.
    """
    read = fleet if isinstance(fleet, Fleet) else read_fleet(fleet)
    folder = Path(store) if store is not None else read.store
    made_store(folder)
    engine = _engine(read, scheduler, workers, say)
    plan = plan_fleet(read, folder, lambda done, total: progress("listing recordings", done, total))
    run = FleetRun(folder, planned=len(plan.tasks), wrong=plan.wrong)
    first = [task for task in plan.tasks if task.when == "always"]
    later = [task for task in plan.tasks if task.when != "always"]
    redone = frozenset(_files(folder, AGAIN[again])) if again is not None else frozenset()
    with cancelled_by_key() as cancelled:

        def compute(tasks: Sequence[Task], what: str) -> None:
            there = names_in(folder) - redone
            new = [task for task in tasks if task.name not in there]
            run.present += len(tasks) - len(new)
            if not new:
                return
            by_name = {task.name: task for task in new}
            older = _older(there | redone, by_name.values())
            before = run.done
            progress(what, 0, len(new))
            with Keeper(folder) as keeper:
                for outcome in engine((task.job for task in new), cancelled):
                    keeper.keep(outcome.name, _rows_of(by_name[outcome.name].job, outcome, run, say), older.get(outcome.name, ()))
                    progress(what, run.done - before, len(new))
            run.cancelled = cancelled.is_set()

        compute(first, "checking, identifying, calibrating")
        if later and not run.cancelled:
            nights = {when: _NIGHTS[when](folder) for when in {task.when for task in later}}
            wanted = [task for task in later if (task.machine, task.date) in nights[task.when]]
            run.unneeded = len(later) - len(wanted)
            compute(wanted, "diagnosing")
    return run


def made_store(folder: Path) -> None:
    """Make the folder of a store.

    Raises
    ------
    UnusableInputError
        It cannot be made.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as problem:
        raise UnusableInputError(f"{folder}: cannot be made: {problem.strerror}; give another --store") from None


def _engine(fleet: Fleet, scheduler: str | None, workers: int | None, say: Callable[[str], None]) -> Engine:
    if workers is not None and scheduler is not None:
        raise UnusableInputError("--workers is of a cluster on this computer; that of --scheduler has its own")
    if workers == 0:
        return one_by_one
    from hil.fleet.cluster import on_cluster

    kinds = {kind for machine in fleet.machines for kind in machine.tasks}
    return on_cluster(scheduler, workers or os.cpu_count() or 1, [fleet.needs[kind] for kind in kinds], say)


def _rows_of(job: Job, outcome: Outcome, run: FleetRun, say: Callable[[str], None]) -> list[dict[str, Any]]:
    """Return the rows of a result, which is counted and, where it has no answer, said."""
    if outcome.failure:
        software, notes = software_version(), []
        numbers = failure(outcome.failure, FAILED)
    else:
        software, notes = outcome.value["software"], outcome.value["notes"]
        numbers = [Number(**{**row, "covariance": tuple(row["covariance"])}) for row in outcome.value["rows"]]
    run.done += 1
    run.by_verdict[numbers[0].verdict] += 1
    if numbers[0].verdict in (FAILED, UNUSABLE):
        line = f"{job.argument['machine']}, {job.argument['night'][:10]}: {job.argument['task']}: {numbers[0].message}"
        run.failures.append(line)
        say(line)
    return list(_result_rows(job, numbers, software, notes))


def _result_rows(job: Job, numbers: Sequence[Number], software: str, notes: Sequence[str]) -> Iterable[dict[str, Any]]:
    """Return the rows of a result; notes of its recordings go with the first."""
    argument = job.argument
    files = [file["sha256"] for which in ("recordings", "held_out") for one in argument[which] for file in one["files"]]
    for place, number in enumerate(numbers):
        yield {
            "machine": argument["machine"],
            "night": datetime.fromisoformat(argument["night"]),
            "task": argument["task"],
            "experiment": argument["experiment"],
            "quantity": number.quantity,
            "value": _known(number.value),
            "standard_deviation": _known(number.standard_deviation),
            "unit": number.unit,
            "covariance_group": number.group or number.quantity,
            "covariance": list(number.covariance),
            "covariance_index": number.place,
            "verdict": number.verdict,
            "message": "; ".join(filter(None, (number.message, *(notes if place == 0 else ())))),
            "software_version": software,
            "machine_file_hash": argument["machine_file"]["hash"],
            "recording_hashes": files,
        }


def _known(value: float) -> float | None:
    """Return None, NULL in SQL, for what is no number: SQL would count a NaN as the greatest of all."""
    return value if math.isfinite(value) else None


def _older(there: Iterable[str], tasks: Iterable[Task]) -> dict[str, list[str]]:
    """Return for each task the results that were made of earlier recordings, or by an earlier machine file, of the same night."""
    of_identity: dict[str, list[str]] = {}
    for name in there:
        of_identity.setdefault(identity_of(name), []).append(name)
    return {task.name: [name for name in of_identity.get(identity_of(task.name), []) if name != task.name] for task in tasks}


def _differing(folder: Path) -> set[tuple[str, str]]:
    """Return machines and nights of which a check differs."""
    return {(machine, date) for machine, date in _rows(folder, DIFFERS)}


def _changed(folder: Path) -> set[tuple[str, str]]:
    """Return machines that changed, each with the night on which that was first said."""
    from hil.fleet.change import fleet_change, read_tracks

    if not _rows(folder, NUMBERS):
        return set()
    return {(change.machine, str(change.alarm)) for change in fleet_change(read_tracks(folder)).changes}


_NIGHTS = {"differs": _differing, "changed": _changed}


def _rows(folder: Path, sql: str) -> tuple[tuple[Any, ...], ...]:
    return query_fleet(folder, sql).rows


def _files(folder: Path, sql: str) -> list[str]:
    return [str(row[0]) for row in _rows(folder, sql)]
