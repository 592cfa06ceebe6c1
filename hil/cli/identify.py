"""isocenter identify: frequency responses from recordings, and the resonances in them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, cast

import typer

from hil.cli.asking import ask
from hil.cli.emulated import say_emulated
from hil.cli.options import load
from hil.cli.paged import PageOption, check_drawn, write_paged
from hil.cli.shared import asks
from hil.terminal.output import Answer, JsonOption, save_figure
from hil.verbs import identify as verb


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command(
        short_help="Frequency responses from recordings.",
        help="Identify the frequency response matrix, with covariances, from recordings of one pose or, pose by pose, of several; and the"
        " resonances that it supports: frequency, damping ratio and 95 % bounds."
        "\n\nExample:  isocenter identify run_*.mf4 -o carm.frf.npz --figure carm.png"
        "\n\nNeighbouring poses helping:  isocenter identify pose*.mf4 --method nd_lrm --orders 3,2,1 --over-poses 1,1,2 -o carm.frf.npz",
    )(identify)


@asks
def identify(
    request: Callable[..., verb.IdentifyRequest],
    figure: Annotated[Path | None, typer.Option("--figure", metavar="PNG", help="Draw it as well; of several poses the first.")] = None,
    machine_name: Annotated[
        str | None, typer.Option("--machine", "-m", metavar="M", help="Machine file, for a recording that carries none.")
    ] = None,
    page: PageOption = None,
    json_to: JsonOption = None,
) -> None:
    """Estimate frequency response, noise and nonlinear variance."""
    answer = Answer(json_to)
    asked = request(machine=None if machine_name is None else load(machine_name))
    recordings = cast("list[Path]", asked.recordings)
    check_drawn(figure, page, recordings)
    found = ask(verb.answer, asked, answer)
    first, paths = found.poses[0], [each.frf for each in found.poses if each.frf is not None]
    say_emulated(answer, dict(zip(recordings, found.recordings, strict=True)))
    for line in found.lines:
        answer.say(line)
    if figure is not None:
        from hil.figures.frf import frf_figure

        save_figure(frf_figure(first.response, modes=first.resonances.found, title=first.title), figure)
        answer.say(f"{figure}: figure")
    if page is not None:
        from hil.reports.identified import identified_page

        responses, modes = [each.response for each in found.poses], [each.resonances for each in found.poses]
        write_paged(answer, identified_page(responses, modes, paths, recordings, found.recordings), page)
    answer.write(found.document)
