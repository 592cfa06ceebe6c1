"""isocenter faults list | check: the faults of the emulated machine, and the table of what becomes of each."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hil.cli.options import MachineArgument, folder_can_be_written, load
from hil.terminal.output import Answer, JsonOption, plain
from hil.terminal.progress import progress

if TYPE_CHECKING:
    from hil.faults.check import TrialOutcome

app = typer.Typer(
    no_args_is_help=True,
    short_help="Faults of the emulated machine.",
    help="Faults of the emulated machine: what there is, and what becomes of a machine that has each.\n\nExample:  isocenter faults list",
)


@app.command(
    "list",
    short_help="What there is to inject.",
    help="Every fault: its class, where it may act, its parameters, and what it does; with --json also bounds and states."
    "\n\nExample:  isocenter faults list --json faults.json",
)
def list_faults(json_to: JsonOption = None) -> None:
    """Print one line per fault."""
    from virtual_bus.faults import catalogue
    from virtual_bus.faults.fault import PLACES
    from virtual_bus.faults.registry import fault_kinds, states

    answer = Answer(json_to)
    for kind in fault_kinds().values():
        parameters = ", ".join(f"{parameter.key} = {parameter.default:g}" for parameter in kind.parameters)
        where = kind.at if kind.begin is not None else f"{kind.at}, not emulated"
        answer.say(f"{kind.name:28s} {kind.group:13s} {where:24s} {kind.does}{f' ({parameters})' if parameters else ''}")
    answer.write({"faults": catalogue(), "places": PLACES, "states": states()})


@app.command(
    "quirks",
    short_help="How drives bend the standard.",
    help="Every quirk of a drive that `emulate` and `run --bus lockstep:` take as --quirk DRIVE:NAME: what it does, and where that was"
    " reported.\n\nExample:  isocenter faults quirks\n\nExample:  isocenter emulate carm --quirk roll_drive:mode_display_late",
)
def list_quirks(json_to: JsonOption = None) -> None:
    """Print one line per quirk."""
    from virtual_bus.quirks.registry import quirks

    answer = Answer(json_to)
    for quirk in quirks().values():
        answer.say(f"{quirk.name:26s} {quirk.does}")
    answer.write({"quirks": [{key: getattr(quirk, key) for key in ("name", "does", "group", "source")} for quirk in quirks().values()]})


@app.command(
    short_help="Try every fault on a machine.",
    help="Run every fault on the emulated machine in lockstep, each in a short run of its own, and write a page of what was said, what"
    " moved and what is kept. Started again, it goes on where it was ended."
    "\n\nExample:  isocenter faults check carm -o faults"
    "\n\nExample:  isocenter faults check carm -o faults --only torque_lost --only brake_stays_open"
    "\n\nExample:  isocenter faults check carm -o faults --while move",
)
def check(
    machine_name: MachineArgument,
    out: Annotated[Path, typer.Option("-o", "--out", metavar="DIR", help="Folder for faults.html, faults.json and outcomes.jsonl.")],
    only: Annotated[
        list[str] | None, typer.Option("--only", metavar="NAME", help="This fault, or this row of an earlier table; once for each.")
    ] = None,
    axis: Annotated[str, typer.Option("--axis", help="Axis that moves and has the faults; the machine's last unless given.")] = "",
    moved_by: Annotated[
        str, typer.Option("--while", metavar="MOTION", help="What moves the axis: scan (recorded), move (to a pose), homing.")
    ] = "scan",
    json_to: JsonOption = None,
) -> None:
    """Run the table; exit status 1 where something moved on, was not noticed, took more than its budget, or was told wrongly."""
    from hil.errors import BadAnswerError, UnusableInputError
    from hil.faults.check import check_faults
    from hil.faults.motion import MOTIONS, motion_of
    from hil.faults.page import DATA, document_of, is_failure, summary_of, write_page
    from hil.faults.trials import swept_axis, trials

    if moved_by not in MOTIONS:
        raise UnusableInputError(f"--while {moved_by}: there is {', '.join(MOTIONS)}")

    machine = load(machine_name)
    answer = Answer(json_to)
    swept = swept_axis(machine, axis)
    table = trials(machine, swept, only or (), moved_by)
    motion = motion_of(machine, swept, moved_by)
    folder_can_be_written(out)
    out.mkdir(parents=True, exist_ok=True)
    with progress() as bars:
        task = bars.add_task("faults", total=len(table))

        def show(done: int, outcome: TrialOutcome) -> None:
            bars.update(task, completed=done, description=outcome.name)
            if is_failure(outcome) or not answer.console.is_terminal:
                answer.say(f"{outcome.verdict:12s} {outcome.name}: {outcome.said or 'nothing was said'}")

        outcomes = check_faults(machine, swept, table, out, show, moved_by)
    document = document_of(machine, swept, outcomes, motion)
    Answer(str(out / DATA)).write(document)
    page = write_page(machine, swept, outcomes, out, motion)
    answer.say(summary_of(outcomes))
    answer.say(f"{page} has them all")
    answer.write(plain(document))
    if bad := [outcome.name for outcome in outcomes if is_failure(outcome)]:
        more = f" and {len(bad) - 1} more" if len(bad) > 1 else ""
        raise BadAnswerError(f"{page}: {bad[0]}{more} moved on, went unnoticed, took more than its budget, or was told wrongly")
