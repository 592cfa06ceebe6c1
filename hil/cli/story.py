"""isocenter demo: the demonstration on the emulator."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hil.cli.options import folder_can_be_written
from hil.terminal.output import Answer, JsonOption


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command(
        short_help="The whole story on the emulator, in about a minute.",
        help="The whole story on the emulator, in about a minute: the emulated C-arm hides an effect, or what a seed draws, the bench "
        "records it over the CANopen stack, the diagnosis names from the recordings what the simulation lacks, and the page opens the "
        "envelope. The first run on a computer compiles for another minute."
        "\n\nExample:  isocenter demo --seed 7 -o demo",
    )(demo)


def demo(
    out: Annotated[
        Path,
        typer.Option(
            "-o", "--out", metavar="DIR", help="Where recordings, diagnosis and page go; where it is in use, a new folder beside it."
        ),
    ] = Path("isocenter-demo"),
    seed: Annotated[
        int | None,
        typer.Option(min=0, metavar="N", help="Draws what the emulated machine hides; unless given, an effect that the eye can find."),
    ] = None,
    json_to: JsonOption = None,
) -> None:
    """Seal, record, diagnose, open, show."""
    from hil.demo import run_demo

    answer = Answer(json_to)
    folder_can_be_written(out)
    answer.write(run_demo(out, answer, seed))
