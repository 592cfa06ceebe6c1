"""isocenter observe: the observer of Chapter 5, replayed over a recording."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, cast

import typer

from hil.cli.asking import ask
from hil.cli.emulated import say_emulated
from hil.cli.options import MachineArgument, load
from hil.cli.paged import PageOption, check_drawn, write_paged
from hil.cli.shared import asks
from hil.terminal.output import Answer, JsonOption, save_figure
from hil.verbs import observe as verb

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


@asks
def observe(
    machine_name: MachineArgument,
    request: Callable[..., verb.ObserveRequest],
    figure: Annotated[Path | None, typer.Option("--figure", metavar="PNG", help="Draw it as well.")] = None,
    page: PageOption = None,
    json_to: JsonOption = None,
) -> None:
    """Design or read, replay, write."""
    asked = request(machine=load(machine_name))
    answer = Answer(json_to)
    check_drawn(figure, page, asked.inputs)
    found = ask(verb.answer, asked, answer)
    replayed, files = found.replayed, cast("tuple[Path, Path]", (asked.recording, asked.out))
    if figure is not None:
        from hil.figures.observer import observer_figure

        save_figure(observer_figure(replayed.estimate), figure)
        answer.say(f"{figure}: figure")
    answer.say(found.sentence)
    say_emulated(answer, {files[0]: replayed.recording})
    for line in found.lines:
        answer.say(line)
    if page is not None:
        from hil.reports.observed import observed_page

        design = cast("Path | None", asked.design or asked.save_design)
        write_paged(answer, observed_page(asked.machine, replayed.estimate, replayed.recording, files, design, answer.said), page)
    answer.write(found)
