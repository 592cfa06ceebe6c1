"""isocenter shape: reference shapers designed and judged."""

from __future__ import annotations

import csv
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, cast

import typer

from hil.cli.asking import ask
from hil.cli.options import EffectsOption, MachineArgument, can_be_written, load
from hil.cli.paged import PageOption, check_drawn, write_paged
from hil.cli.shared import asks
from hil.errors import UnusableInputError
from hil.terminal.output import Answer, JsonOption, save_figure
from hil.verbs import shape as verb


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command(
        short_help="Design and judge a reference shaper.",
        help="Design reference shapers for one axis of a machine, judge them, and write the recommended one."
        "\n\nFor a sweep unless --period says that the scan repeats. Designed from the machine file's closed loop at a pose, at several "
        "with --schedule, or from an identified frequency response with --frf."
        "\n\n--also shortest searches the shortest delay with one tap fewer; dc, zpetc and zmetc invert the path's zeros on the last tap, "
        "those that cannot be inverted by their DC gain, without phase error, or without magnitude error."
        "\n\nExit status: 0, the shaper that was written is fit to run; 1, it was written, but something is against it; 2, none was."
        "\n\nExample:  isocenter shape carm --axis roll -o roll.shaper.npz",
    )(shape)


@asks
def shape(
    machine_name: MachineArgument,
    request: Callable[..., verb.ShapeRequest],
    table: Annotated[Path | None, typer.Option("--csv", metavar="FILE", help="Verdicts as CSV.")] = None,
    figure: Annotated[
        Path | None, typer.Option("--figure", metavar="PNG", help="Taps, frequency responses, map of delays, before and after in time.")
    ] = None,
    effects: EffectsOption = None,
    page: PageOption = None,
    json_to: JsonOption = None,
) -> None:
    """Print one line per design, the recommended one first."""
    machine = load(machine_name, effects)
    answer = Answer(json_to)
    can_be_written(table)
    asked = request(machine=machine)
    check_drawn(figure, page, asked.inputs)
    found = ask(verb.answer, asked, answer, told_as=UnusableInputError)
    choice = found.choice
    for line in (found.sentence, *found.lines):
        answer.say(line)
    if table is not None:
        _write_csv([verdict.row for verdict in found.designs], table)
        answer.say(f"{table}: verdicts")
    if figure is not None:
        from hil.figures.shapers import design_figure

        title = f"{asked.axis} of {machine.name}, {found.source}"
        subjects, rate = choice.subjects.each, machine.sample_rate_Hz
        save_figure(design_figure(choice.designs, subjects, found.aim, rate, found.steps, title), figure)
        answer.say(f"{figure}: figure")
    if page is not None:
        from hil.reports.shaped import shaped_page

        facts = {"Aim": found.aim.kind, "From": found.source}
        subjects = choice.subjects.each
        shown = shaped_page(
            machine, asked.axis, found.sentence, choice.candidates, choice.chosen, subjects, found.steps, cast(Path, asked.out), facts
        )
        write_paged(answer, shown, page)
    answer.write(found)
    if not found.fit:
        raise typer.Exit(1)


def _write_csv(rows: list[dict[str, str | float]], path: Path) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
