"""isocenter fleet run | status | query: many machines, many nights."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from hil.terminal.output import Answer, JsonOption
from hil.terminal.progress import progress

if TYPE_CHECKING:
    from rich.progress import TaskID

app = typer.Typer(
    no_args_is_help=True,
    short_help="Many machines, many nights.",
    help="Many machines, many nights: what is new is checked, identified, diagnosed or calibrated, and kept as Parquet."
    "\n\nExample:  isocenter fleet run fleet.toml",
)

FleetArgument = Annotated[Path, typer.Argument(metavar="FLEET", help="File of the fleet (TOML).")]
StoreOption = Annotated[
    Path | None, typer.Option("--store", metavar="DIR", help="Folder of the results; the file's `store` unless given.", show_default=False)
]

MOST_LINES = 20
"""Failures that are printed; the rest is counted."""


@app.command(
    short_help="Do what is new.",
    help="Do for every machine of the fleet what its file says, where recordings have no result yet, on this computer's processors or a"
    " Dask cluster. Started again, it goes on where it was ended; Ctrl-C keeps all that is finished."
    "\n\nExample:  isocenter fleet run fleet.toml"
    "\n\nExample:  isocenter fleet run fleet.toml --scheduler tls://scheduler.hospital:8786",
)
def run(
    fleet: FleetArgument,
    scheduler: Annotated[
        str | None, typer.Option("--scheduler", metavar="URL", help="Dask scheduler, tcp://HOST:PORT or tls://HOST:PORT.")
    ] = None,
    workers: Annotated[
        int | None,
        typer.Option(
            "--workers", metavar="N", min=0, help="Processes of this computer; 0: one, without Dask. One per processor unless given."
        ),
    ] = None,
    store: StoreOption = None,
    again: Annotated[
        Literal["failed", "earlier"] | None,
        typer.Option("--again", help="Compute again what lacked time, memory or a worker; or what another version computed."),
    ] = None,
    json_to: JsonOption = None,
) -> None:
    """Run the fleet; exit status 1 where something failed."""
    from hil.errors import BadAnswerError
    from hil.fleet.new_work import run_fleet

    answer = Answer(json_to)
    with progress() as bars:
        tasks: dict[str, TaskID] = {}

        def follow(what: str, done: int, total: int) -> None:
            if what not in tasks:
                tasks[what] = bars.add_task(what, total=total)
            bars.update(tasks[what], completed=done)

        def say(line: str) -> None:
            bars.print(line)

        done = run_fleet(fleet, store=store, scheduler=scheduler, workers=workers, again=again, progress=follow, say=say)
    answer.say(
        f"{done.store}: {done.done} new results, {done.present} were there"
        + (f"; {done.unneeded} nights need no diagnosis" if done.unneeded else "")
    )
    if done.by_verdict:
        answer.say("  " + ", ".join(f"{count} {verdict}" for verdict, count in done.by_verdict.most_common()))
    for line in done.wrong[:MOST_LINES]:
        answer.say(f"  {line}")
    answer.write(vars(done) | {"by_verdict": dict(done.by_verdict)})
    if done.cancelled:
        raise KeyboardInterrupt
    if bad := [*done.failures, *done.wrong]:
        more = f", and {len(bad) - 1} more: isocenter fleet status {fleet}" if len(bad) > 1 else ""
        raise BadAnswerError(f"{bad[0]}{more}")


@app.command(
    short_help="How far the fleet is.",
    help="How far a fleet is: per machine its nights, results, those that differ from the simulation, failures, and tasks that wait."
    "\n\nExample:  isocenter fleet status fleet.toml",
)
def status(fleet: FleetArgument, store: StoreOption = None, json_to: JsonOption = None) -> None:
    """Print a line per machine, then what failed."""
    from hil.fleet.status import fleet_status

    answer = Answer(json_to)
    found = fleet_status(fleet, store=store)
    width = max(len("machine"), *(len(each.machine) for each in found.machines))
    answer.say(f"{'machine':<{width}}  {'nights':>6}  {'newest':<10}  {'results':>7}  {'differ':>6}  {'failed':>6}  {'waiting':>7}")
    for each in found.machines:
        counts = f"{each.results:7d}  {each.differing:6d}  {each.failed:6d}  {each.waiting:7d}"
        answer.say(f"{each.machine:<{width}}  {each.nights:6d}  {each.newest:<10}  {counts}")
    lines = [*found.failures, *found.wrong]
    for line in lines[:MOST_LINES]:
        answer.say(line)
    if len(lines) > MOST_LINES:
        answer.say(f"and {len(lines) - MOST_LINES} more")
    answer.write(found)


@app.command(
    short_help="Ask the results in SQL.",
    help="Ask a question about a fleet's results in the SQL of DuckDB. The table is `results`, a row per number that was found: `machine`,"
    " `night`, `task`, `experiment`, `quantity`, `value`, `standard_deviation`, `unit`, `verdict`, `message` and more."
    "\n\nExample:  isocenter fleet query \"select machine, max(value) from results where quantity = 'mode 1 frequency' group by 1\"",
)
def query(
    sql: Annotated[str, typer.Argument(metavar="SQL", help="One statement.")],
    store: Annotated[Path, typer.Option("--store", metavar="DIR", help="Folder of the results.")] = Path("fleet-results"),
    json_to: JsonOption = None,
) -> None:
    """Print the rows."""
    from hil.fleet.store import query_fleet

    answer = Answer(json_to)
    found = query_fleet(store, sql)
    documents = found.documents()
    cells = [found.columns, *(tuple(_cell(value) for value in document.values()) for document in documents)]
    widths = [max(len(row[place]) for row in cells) for place in range(len(found.columns))]
    for row in cells:
        answer.say("  ".join(f"{cell:<{width}}" for cell, width in zip(row, widths, strict=True)).rstrip())
    answer.write({"columns": found.columns, "rows": documents})


def _cell(value: object) -> str:
    return "" if value is None else f"{value:.6g}" if isinstance(value, float) else str(value)
