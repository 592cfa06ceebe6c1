"""How far a fleet is: per machine its nights, results, and what failed or waits."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from hil.fleet.answers import FAILED, UNUSABLE
from hil.fleet.file import Fleet, read_fleet
from hil.fleet.plan import plan_fleet
from hil.fleet.store import query_fleet

RESULTS = f"""
select machine, count(distinct night::date), max(night)::date::varchar, list(distinct file),
       count(distinct file) filter (where verdict in ('{FAILED}', '{UNUSABLE}')),
       count(distinct file) filter (where verdict = 'differs')
from results group by machine
"""

FAILURES = f"""
select machine || ', ' || strftime(night, '%Y-%m-%d') || ': ' || task || ': ' || message from results
where verdict in ('{FAILED}', '{UNUSABLE}') order by night desc, machine, task
"""


@dataclass(frozen=True)
class MachineStatus:
    """One machine: nights with results and the newest of them ("" without any), results, those that failed or differ, tasks to do."""

    machine: str
    nights: int
    newest: str
    results: int
    failed: int
    differing: int
    waiting: int


@dataclass(frozen=True)
class FleetStatus:
    """A fleet: its machines, a line for each failure, newest first, and for everything that cannot be used."""

    store: Path
    machines: tuple[MachineStatus, ...]
    failures: tuple[str, ...]
    wrong: tuple[str, ...]


def fleet_status(fleet: Fleet | str | Path, *, store: str | Path | None = None) -> FleetStatus:
    """Return how far a fleet is; what waits also counts diagnoses that will turn out not to be needed.

    Raises
    ------
    UnusableInputError
        The file cannot be used, or there is no store yet.
    """
    read = fleet if isinstance(fleet, Fleet) else read_fleet(fleet)
    folder = Path(store) if store is not None else read.store
    rows = {row[0]: row[1:] for row in query_fleet(folder, RESULTS).rows}
    plan = plan_fleet(read, folder)
    machines = []
    for machine in read.machines:
        nights, newest, files, failed, differing = rows.get(machine.name, (0, "", [], 0, 0))
        tasks = {task.name for task in plan.tasks if task.machine == machine.name}
        machines.append(MachineStatus(machine.name, nights, newest, len(files), failed, differing, len(tasks - set(files))))
    failures = tuple(str(row[0]) for row in query_fleet(folder, FAILURES).rows)
    return FleetStatus(folder, tuple(machines), failures, tuple(plan.wrong))
