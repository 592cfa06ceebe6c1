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
        short_help="The whole story on the emulator, under a minute.",
        help="The whole story on the emulator, under a minute: a closed-loop multisine with jog over the CANopen stack, recorded, "
        "identified, and held against simulations with and without a friction that the emulated machine secretly has."
        "\n\nExample:  isocenter demo --out demo",
    )(demo)


def demo(
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="Where recordings, figures and the page go.")] = Path("isocenter-demo"),
    json_to: JsonOption = None,
) -> None:
    """Run, identify, simulate, compare, show."""
    from hil.demo import run_demo

    answer = Answer(json_to)
    folder_can_be_written(out)
    answer.write(run_demo(out, answer))
