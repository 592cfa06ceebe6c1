"""isocenter doctor: whether this computer can run the sample loop, and what to change."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hil.cli.options import load
from hil.terminal.output import Answer, JsonOption

SECONDS = 60.0
"""At 256 Hz 15 ticks of a minute are beyond the 99.9th percentile, and those of one stall count as one: shorter trials say little of it."""


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command(
        short_help="Can this computer run the loop?",
        help="Check this computer, measure how punctual it is, and predict the ticks that ten minutes will lose; say what to change."
        "\n\nThe loop is tried against an emulated machine on a bus of its own. The bus of --bus is not opened, and nothing is sent on it;"
        " where something runs on it, or a bench on this computer, nothing is measured. Status 1 when something is bad."
        "\n\nExample:  isocenter doctor"
        "\n\nExample:  isocenter doctor --machine carm --bus socketcan:can0 --json doctor.json",
    )(doctor)


def doctor(
    machine_name: Annotated[
        str, typer.Option("--machine", "-m", metavar="M", help="Machine file, or the name of a shipped one (isocenter machine list).")
    ] = "carm",
    bus: Annotated[str, typer.Option("--bus", "-b", metavar="URL", help="Bus of the machine; udp: is an emulated one.")] = "udp:",
    seconds: Annotated[float, typer.Option("--seconds", help="Length of the loop's trial; bare wake-ups take a quarter of it.")] = SECONDS,
    json_to: JsonOption = None,
) -> None:
    """Print yes or no in a sentence, then one line per finding."""
    from rich.console import Console

    from hil.doctor.examine import examine, least_seconds
    from hil.errors import UnusableInputError

    machine = load(machine_name)
    if not least_seconds(machine) <= seconds <= 3600.0:
        raise UnusableInputError(f"--seconds {seconds:g}: must be {least_seconds(machine):.2g} to 3600")
    answer = Answer(json_to)
    doing = Console(stderr=True, highlight=False, soft_wrap=True)
    found = examine(machine, bus, seconds, Path.cwd(), lambda text: doing.print(f"{text} ...", markup=False))
    answer.say(found.sentence(machine))
    for finding in found.findings:
        answer.say(str(finding))
    answer.write({"machine": machine.name, "bus": bus, "ok": not found.of("bad"), "says": found.sentence(machine), **vars(found)})
    if found.of("bad"):
        raise typer.Exit(1)
