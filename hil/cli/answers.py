"""isocenter simulate | compare | convert: results computed from recordings."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hil.cli.asking import ask
from hil.cli.emulated import say_emulated
from hil.cli.options import EffectsOption, MachineArgument, can_be_written, load, not_an_input
from hil.cli.shared import asks
from hil.terminal.output import Answer, JsonOption
from hil.verbs import compare as comparing
from hil.verbs import simulate as simulating

if TYPE_CHECKING:
    from hil.recording.naming import Target as NameTarget

OptionalMachine = Annotated[
    str | None, typer.Option("--machine", "-m", metavar="M", help="Machine file, for a recording that carries none.")
]


def register(app: typer.Typer) -> None:
    """Add the commands."""
    app.command(
        short_help="Simulate a recording, noise off.",
        help="Simulate a recording, noise off: its reference and excitation and the machine file go in, everything else comes out."
        "\n\nExample:  isocenter simulate carm run.mf4 -o sim.mf4",
    )(simulate)
    app.command(
        short_help="A recording against its simulation.",
        help="Whether a simulation agrees with its recording, and what differs: per channel, in units, in multiples of the noise and as"
        " NRMSE. The noise is the scatter between repeats or periods; with neither it is assumed, and said to be."
        "\n\nExample:  isocenter compare run.mf4 sim.mf4",
    )(compare)
    app.command(
        short_help="Convert between recording formats.",
        help="Convert between .mf4, .csv, .parquet, .mcap and (reading) MDF 3 (.mdf, .dat), .mat, CAN logs (.log, .blf, .asc, .trc, and"
        " python-can's .csv, .db, .mf4) and ROS 2 bags."
        "\n\nExample:  isocenter convert run.mf4 run.csv"
        "\n\nExample:  isocenter convert lab.mat lab.mf4 --machine carm --map t=time --map 'q=position_roll [deg]'",
    )(convert)


@asks
def simulate(
    machine_name: MachineArgument,
    request: Callable[..., simulating.SimulateRequest],
    effects: EffectsOption = None,
    json_to: JsonOption = None,
) -> None:
    """Simulate a free run in closed loop."""
    answer = Answer(json_to)
    asked = request(machine=load(machine_name, effects))
    found = ask(simulating.answer, asked, answer)
    say_emulated(answer, {asked.recording: found.recorded})
    answer.say(found.sentence)
    answer.write(found)


@asks
def compare(request: Callable[..., comparing.CompareRequest], machine_name: OptionalMachine = None, json_to: JsonOption = None) -> None:
    """Say whether the simulation agrees, then rms and largest difference, in units and of the noise, and NRMSE per channel."""
    answer = Answer(json_to)
    asked = request(machine=None if machine_name is None else load(machine_name))
    found = ask(comparing.answer, asked, answer)
    answer.say(found.verdict)
    say_emulated(answer, {asked.recording: found.recorded})
    answer.say(found.comparison.table())
    answer.write(found)


def convert(
    source: Annotated[Path, typer.Argument(metavar="A", help="What to read: a recording, log, bag or FRF.")],
    target: Annotated[
        Path, typer.Argument(metavar="B", help="What to write: .mf4, .csv, .parquet or .mcap; of an FRF .mat, .uff or .unv.")
    ],
    mapping: Annotated[
        list[str] | None,
        typer.Option(
            "--map",
            metavar="NAME=CHANNEL|FILE",
            help="Which signal of another tool's file is which channel, `q=position_roll [deg]`, once for each; or a TOML file of names.",
        ),
    ] = None,
    machine_name: OptionalMachine = None,
    json_to: JsonOption = None,
) -> None:
    """Write the same channels, or the same frequency response, to another file."""
    from hil.recording import convert as convert_recording

    not_an_input(target, source)
    if source.suffix.lower() == ".npz":
        _convert_frf(source, target, Answer(json_to))
        return
    machine = None if machine_name is None else load(machine_name)
    answer = Answer(json_to)
    recording = convert_recording(source, target, machine, _channel_names(mapping or []))
    answer.say(f"{target}: {len(recording.time)} rows, {len(recording.channels)} channels")
    said = recording.metadata.get("source", {})
    said = said if said.get("file") == source.name else {}  # of this file, not of the one that it was made from
    answer.write(
        {
            "target": target,
            "rows": len(recording.time),
            "channels": {name: c.unit for name, c in recording.channels.items()},
            "names": said.get("names", {}),
            "not_taken": said.get("not_taken", []),
            "notes": said.get("notes", []),
        }
    )


def _convert_frf(source: Path, target: Path, answer: Answer) -> None:
    from hil.identification.exchange import convert_frf

    can_be_written(target)
    response = convert_frf(source, target)
    lines, outputs, inputs = response.G.shape
    answer.say(f"{target}: frequency response of {lines} lines, {outputs} outputs, {inputs} inputs")
    answer.write({"target": target, "lines": lines, "outputs": response.output_names, "inputs": response.input_names})


def _channel_names(mapping: list[str]) -> dict[str, NameTarget]:
    """Read `["t=time", "q=position_roll [deg]", "names.toml"]` as a table."""
    from hil.recording.naming import read_names, target

    names: dict[str, NameTarget] = {}
    for entry in mapping:
        name, _, channel = entry.rpartition("=")
        if "=" not in entry:
            if not Path(entry).exists():
                raise typer.BadParameter(f"--map {entry}: neither NAME=CHANNEL, such as t=time, nor a file")
            added = read_names(Path(entry))
        elif not name or not channel:
            raise typer.BadParameter(f"--map {entry}: must be NAME=CHANNEL, such as t=time")
        else:
            added = {name: target(channel, f"--map {entry}")}
        if twice := [name for name in added if name in names]:
            raise typer.BadParameter(f"--map {entry}: {twice[0]} is named already")
        names |= added
    return names
