"""isocenter simulate | compare | identify | convert: what is computed from recordings."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hil.cli.options import EffectsOption, MachineArgument, load
from hil.cli.output import Answer, JsonOption

RecordingArgument = Annotated[Path, typer.Argument(metavar="REC", help="Recording (.mf4, .csv, .mat).")]
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
        help="What differs between a recording and its simulation, per channel, in units and as NRMSE."
        "\n\nExample:  isocenter compare run.mf4 sim.mf4",
    )(compare)
    app.command(
        short_help="Frequency responses from recordings.",
        help="Identify the frequency response matrix, with covariances, from recordings of one pose."
        "\n\nExample:  isocenter identify run_*.mf4 -o carm.frf.npz --figure carm.png",
    )(identify)
    app.command(
        short_help="Convert between recording formats.",
        help="Convert between .mf4, .csv and (reading) .mat, .blf, .log.\n\nExample:  isocenter convert run.mf4 run.csv",
    )(convert)


def simulate(
    machine_name: MachineArgument,
    recording: RecordingArgument,
    out: Annotated[Path, typer.Option("-o", "--out", metavar="SIM", help="Where to write the simulation.")],
    effects: EffectsOption = None,
    json_to: JsonOption = None,
) -> None:
    """Free run in closed loop."""
    from hil.recording import read_recording, write_recording
    from hil.simulation import simulate as run_simulation

    machine = load(machine_name, effects)
    measured = read_recording(recording, machine)
    simulated = run_simulation(machine, measured)
    write_recording(simulated, out)
    answer = Answer(json_to)
    added = ", ".join(f"{effect.name} at {effect.at}" for effect in machine.plant.effects) or "nothing"
    answer.say(f"{out}: {len(simulated.time)} rows of {machine.name}, added to the machine file: {added}")
    answer.write({"simulation": out, "rows": len(simulated.time), "effects": [vars(effect) for effect in machine.plant.effects]})


def compare(
    recording: RecordingArgument,
    simulation: Annotated[Path, typer.Argument(metavar="SIM", help="Its simulation.")],
    machine_name: OptionalMachine = None,
    json_to: JsonOption = None,
) -> None:
    """Per channel: rms and largest difference in units, and NRMSE."""
    from hil.recording import read_recording
    from hil.simulation import compare as compare_recordings

    machine = None if machine_name is None else load(machine_name)
    comparison = compare_recordings(read_recording(recording, machine), read_recording(simulation, machine))
    answer = Answer(json_to)
    answer.say(comparison.table())
    answer.write(comparison.document())


def identify(
    recordings: Annotated[list[Path], typer.Argument(metavar="REC...", help="All experiments and realisations of one pose.")],
    out: Annotated[Path, typer.Option("-o", "--out", metavar="FRF", help="Where to write the frequency response (.npz).")],
    method: Annotated[str, typer.Option("--method", help="Estimator; robust_bla is the BLA by averaging of Sec. 3.4.1.")] = "robust_bla",
    figure: Annotated[Path | None, typer.Option("--figure", metavar="PNG", help="Draw it as well.")] = None,
    machine_name: OptionalMachine = None,
    json_to: JsonOption = None,
) -> None:
    """Frequency response, noise and nonlinear variance."""
    from hil.identification import identify as run_identification
    from hil.identification import write_frf
    from hil.identification.report import response_document, response_lines
    from hil.recording import read_recording

    machine = None if machine_name is None else load(machine_name)
    response = run_identification([read_recording(path, machine) for path in recordings], method)
    write_frf(response, out)
    answer = Answer(json_to)
    answer.say(f"{out}: {response.method} from {len(recordings)} recordings")
    for line in response_lines(response):
        answer.say(line)
    if figure is not None:
        from hil.figures.frf import frf_figure

        frf_figure(response).savefig(figure, dpi=130)
        answer.say(f"{figure}: figure")
    answer.write({"frf": out, **response_document(response)})


def convert(
    source: Annotated[Path, typer.Argument(metavar="A", help="What to read: .mf4, .csv, .mat, .blf or candump .log.")],
    target: Annotated[Path, typer.Argument(metavar="B", help="What to write: .mf4 or .csv.")],
    machine_name: OptionalMachine = None,
    json_to: JsonOption = None,
) -> None:
    """Same channels, another file."""
    from hil.recording import convert as convert_recording

    machine = None if machine_name is None else load(machine_name)
    recording = convert_recording(source, target, machine)
    answer = Answer(json_to)
    answer.say(f"{target}: {len(recording.time)} rows, {len(recording.channels)} channels")
    answer.write({"target": target, "rows": len(recording.time), "channels": {name: c.unit for name, c in recording.channels.items()}})
