"""isocenter shape: reference shapers designed and judged."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Annotated

import typer

from hil.cli.asking import ask
from hil.cli.options import (
    EffectsOption,
    MachineArgument,
    PoseOption,
    can_be_written,
    load,
    parse_band,
    parse_pose,
    parse_whole_numbers,
)
from hil.cli.paged import PageOption, check_drawn, write_paged
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


def shape(
    machine_name: MachineArgument,
    axis: Annotated[str, typer.Option("--axis", help="Axis whose reference is shaped.")],
    out: Annotated[Path, typer.Option("-o", "--out", metavar="SHAPER", help="Where to write the shaper (.npz).")],
    pose: PoseOption = "",
    period: Annotated[float, typer.Option("--period", metavar="S", help="Period of a scan that repeats; 0 for a sweep.")] = 0.0,
    harmonics: Annotated[str, typer.Option("--harmonics", metavar="N,N,...", help="Of the period: tracked without error.")] = "1,3,5",
    longest: Annotated[
        float, typer.Option("--longest", metavar="S", help="Longest transient; 0.6 s for a sweep, one period otherwise.")
    ] = 0.0,
    schedule: Annotated[str, typer.Option("--schedule", metavar="AXIS", help="Design over the range of this axis and interpolate.")] = "",
    output: Annotated[str, typer.Option("--output", help="What shall track: link, detector or motor.")] = "link",
    frf: Annotated[Path | None, typer.Option("--frf", metavar="FRF", help="Design from an identified frequency response.")] = None,
    quiet: Annotated[str, typer.Option("--quiet", metavar="LOW:HIGH", help="Band [Hz] that the quiet design passes least in.")] = "4:20",
    also: Annotated[
        str, typer.Option("--also", metavar="NAME,...", help="Designs beside the usual ones: shortest, dc, zpetc, zmetc.")
    ] = "",
    take: Annotated[str, typer.Option("--take", metavar="NAME", help="Write this design instead of the recommended one.")] = "",
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
    request = verb.ShapeRequest(
        machine,
        axis,
        parse_pose(pose, machine),
        frf,
        period or None,
        parse_whole_numbers("--harmonics", harmonics) if period else (),
        longest or None,
        schedule,
        output,
        parse_band("--quiet", quiet),
        [name.strip() for name in also.split(",") if name.strip()],
        take,
        out,
    )
    check_drawn(figure, page, request.inputs)
    found = ask(verb.answer, request, answer, told_as=UnusableInputError)
    choice = found.choice
    for line in (found.sentence, *found.lines):
        answer.say(line)
    if table is not None:
        _write_csv([verdict.row for verdict in found.designs], table)
        answer.say(f"{table}: verdicts")
    if figure is not None:
        from hil.figures.shapers import design_figure

        title = f"{axis} of {machine.name}, {found.source}"
        subjects, rate = choice.subjects.each, machine.sample_rate_Hz
        save_figure(design_figure(choice.designs, subjects, found.aim, rate, found.steps, title), figure)
        answer.say(f"{figure}: figure")
    if page is not None:
        from hil.reports.shaped import shaped_page

        facts = {"Aim": found.aim.kind, "From": found.source}
        subjects = choice.subjects.each
        shown = shaped_page(machine, axis, found.sentence, choice.candidates, choice.chosen, subjects, found.steps, out, facts)
        write_paged(answer, shown, page)
    answer.write(found)
    if not found.fit:
        raise typer.Exit(1)


def _write_csv(rows: list[dict[str, str | float]], path: Path) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
