"""isocenter shape-plant: a harmonic time-delay filter for a plant that is typed."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hil.cli.options import can_be_written
from hil.terminal.output import Answer, JsonOption


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command(
        "shape-plant",
        short_help="Design a reference shaper for a plant that you type.",
        help="Design a harmonic time-delay filter for a continuous plant that you type, and say how it tracks."
        "\n\nA transfer function (--numerator, --denominator), or its poles and zeros; lists that begin with a minus follow an equals sign."
        "\n\nExample:  isocenter shape-plant --numerator 2 --denominator 1,0.0566,2 --forcing 0.7"
        "\n\nExample:  isocenter shape-plant --poles=-0.0283+1.414j --forcing 0.7 --delay 1.5 --robust-forcing 0.7",
    )(shape_plant)


def shape_plant(
    forcing: Annotated[str, typer.Option("--forcing", metavar="W,W,...", help="Frequencies [rad/s] to track; 0 where there is a mean.")],
    numerator: Annotated[str, typer.Option("--numerator", metavar="B,...", help="Coefficients, the highest power of s first.")] = "",
    denominator: Annotated[str, typer.Option("--denominator", metavar="A,...", help="Coefficients, the highest power of s first.")] = "",
    poles: Annotated[str, typer.Option("--poles", metavar="P,...", help="Poles [rad/s]; one of a pair is enough.")] = "",
    zeros: Annotated[str, typer.Option("--zeros", metavar="Z,...", help="Zeros [rad/s], beside --poles.")] = "",
    gain: Annotated[float, typer.Option("--gain", help="Gain at s = 0, beside --poles.")] = 1.0,
    delay: Annotated[float, typer.Option("--delay", metavar="S", help="Delay T, one tap more; 0: the shortest there is.")] = 0.0,
    longest: Annotated[float, typer.Option("--longest", metavar="S", help="Longest T; 0: two periods of the slowest pole.")] = 0.0,
    robust_poles: Annotated[str, typer.Option("--robust-poles", metavar="P,...", help="Poles that may change.")] = "",
    robust_forcing: Annotated[str, typer.Option("--robust-forcing", metavar="W,...", help="Frequencies that may change.")] = "",
    invert: Annotated[str, typer.Option("--invert", metavar="NAME", help="Invert the zeros on the last tap: dc, zpetc or zmetc.")] = "",
    table: Annotated[Path | None, typer.Option("--csv", metavar="FILE", help="Response in time, without and with the filter.")] = None,
    json_to: JsonOption = None,
) -> None:
    """Print the taps, and how the plant follows with them."""
    from hil.shaping.typed_plant import design_for, document, lines, numbers_in, plant_of, write_in_time

    answer = Answer(json_to)
    can_be_written(table)
    found = design_for(
        plant_of(numerator, denominator, poles, zeros, gain),
        [each.real for each in numbers_in("--forcing", forcing, are_real=True)],
        delay_s=delay or None,
        longest_s=longest or None,
        robust_poles=numbers_in("--robust-poles", robust_poles),
        robust_forcing_rad_s=[each.real for each in numbers_in("--robust-forcing", robust_forcing, are_real=True)],
        inverse=invert,
    )
    for line in lines(found):
        answer.say(line)
    if table is not None:
        write_in_time(found, table)
        answer.say(f"{table}: time, reference, output without the filter and with it")
    answer.write(document(found))
