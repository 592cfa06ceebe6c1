"""isocenter observe: the observer of Chapter 5, replayed over a recording."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hil.cli.asking import ask
from hil.cli.emulated import say_emulated
from hil.cli.options import MachineArgument, load
from hil.cli.paged import PageOption, check_drawn, write_paged
from hil.terminal.output import Answer, JsonOption, save_figure
from hil.verbs import observe as verb

OPTIONS = {"responses": "frf", "multisines": "multisine", "sweeps": "sweep", "tuned_on": "tune", "adapted": "adapt"}
ObserverOption = Annotated[
    Path | None,
    typer.Option("--observer", metavar="FILE", help="Observer design to run along: estimates join the recording (isocenter observe)."),
]
DampingOption = Annotated[
    float,
    typer.Option(
        "--damping", metavar="RATIO", help="With --observer: damping ratio that feedback from its estimate gives the lowest mode."
    ),
]


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command(
        short_help="The observer replayed over a recording.",
        help="Where the detector really was: the observer replayed over a recording, the same numbers as live."
        "\n\nExample:  isocenter observe carm run.mf4 -o run.est.npz --design carm.observer.npz"
        "\n\nA design is made from measurements: isocenter observe carm run.mf4 -o run.est.npz --multisine a.mf4 --multisine b.mf4"
        " --standing still.mf4 --tune scan.mf4 --save-design carm.observer.npz",
    )(observe)


def observe(
    machine_name: MachineArgument,
    recording_path: Annotated[Path, typer.Argument(metavar="REC", help="Recording (.mf4, .csv, .parquet, .mcap, .mat).")],
    out: Annotated[Path, typer.Option("-o", "--out", metavar="EST", help="Estimates (.npz), or the recording with them (.mf4, .csv).")],
    design_path: Annotated[Path | None, typer.Option("--design", metavar="FILE", help="Observer design to use.")] = None,
    frf: Annotated[
        list[Path] | None, typer.Option("--frf", metavar="FRF", help="Frequency response to design from; once per pose.")
    ] = None,
    multisine: Annotated[
        list[Path] | None,
        typer.Option("--multisine", metavar="REC", help="Recording of a multisine to identify for the design; all poses."),
    ] = None,
    standing: Annotated[
        list[Path] | None, typer.Option("--standing", metavar="REC", help="Recording at rest, for noise, gravity and biases; repeatable.")
    ] = None,
    sweep: Annotated[
        list[Path] | None,
        typer.Option("--sweep", metavar="REC", help="Recording of a sweep there and back, for what turning axes push; repeatable."),
    ] = None,
    tune: Annotated[
        list[Path] | None, typer.Option("--tune", metavar="REC", help="Recording of ordinary operation to tune on; repeatable.")
    ] = None,
    save_design: Annotated[Path | None, typer.Option("--save-design", metavar="FILE", help="Write the design as well.")] = None,
    modes: Annotated[int, typer.Option("--modes", min=1, help="Modes of the model.")] = verb.DEFAULT_MODES,
    filter_name: Annotated[str, typer.Option("--filter", help="kf, ekf or ukf.")] = "ukf",
    adapt: Annotated[str, typer.Option("--adapt", metavar="N,N,...", help="Modes (from 1) whose frequency is a state.")] = "",
    data: Annotated[
        Path | None, typer.Option("--data", metavar="FILE", help="Replay the live calibration too: what it went on from (run --data).")
    ] = None,
    images: Annotated[Path | None, typer.Option("--images", metavar="DIR", help="With --data: the folder of that run's images.")] = None,
    figure: Annotated[Path | None, typer.Option("--figure", metavar="PNG", help="Draw it as well.")] = None,
    page: PageOption = None,
    json_to: JsonOption = None,
) -> None:
    """Design or read, replay, write."""
    machine = load(machine_name)
    answer = Answer(json_to)
    measured = verb.Measured(frf or (), multisine or (), standing or (), sweep or (), tune or (), modes)
    files = {"data": data, "images": images, "out": out, "save_design": save_design}
    request = verb.ObserveRequest(machine, recording_path, design_path, measured, filter_name, _modes(adapt), **files)
    check_drawn(figure, page, request.inputs)
    found = ask(verb.answer, request, answer, OPTIONS)
    replayed = found.replayed
    if figure is not None:
        from hil.figures.observer import observer_figure

        save_figure(observer_figure(replayed.estimate), figure)
        answer.say(f"{figure}: figure")
    answer.say(found.sentence)
    say_emulated(answer, {recording_path: replayed.recording})
    for line in found.lines:
        answer.say(line)
    if page is not None:
        from hil.reports.observed import observed_page

        files_shown, design_file = (recording_path, out), design_path or save_design
        write_paged(answer, observed_page(machine, replayed.estimate, replayed.recording, files_shown, design_file, answer.said), page)
    answer.write(found)


def _modes(text: str) -> tuple[int, ...]:
    try:
        return tuple(int(part) - 1 for part in text.split(",") if part.strip())
    except ValueError:
        raise typer.BadParameter(f"--adapt {text}: must be mode numbers, such as 1,2") from None
