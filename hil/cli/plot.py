"""isocenter plot: recordings as a page to look around in."""

from __future__ import annotations

from collections.abc import Callable

import typer

from hil.cli.asking import ask, by_options
from hil.cli.emulated import say_emulated
from hil.cli.shared import asks
from hil.errors import UnusableInputError
from hil.terminal.output import Answer, JsonOption, save_figure
from hil.verbs import plot as verb


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command(
        short_help="Recordings as a page to zoom into.",
        help="Recordings as one self-contained page: all channels over time, zoomed together, with the machine file's simulation over them "
        "and beneath what it leaves."
        "\n\nExample:  isocenter plot run.mf4 --simulate -o run.html"
        "\n\nExample:  isocenter plot first.mf4 second.mf4 --channels 'position_*,current_*' -o both.html --png both.png",
    )(plot)


@asks
def plot(request: Callable[..., verb.PlotRequest], json_to: JsonOption = None) -> None:
    """Read, simulate, write the page."""
    answer = Answer(json_to)
    asked = request()
    found = ask(verb.answer, asked, answer, told_as=UnusableInputError)
    answer.say(found.verdict)
    for shifted, by_s in found.shifts_s.items():
        way = "later" if by_s >= 0.0 else "earlier"
        answer.say(f"{shifted}: shown {abs(by_s):.4g} s {way}, where {asked.align} lies best over that of {asked.recordings[0]}")
    say_emulated(answer, {each.path: each.recording for each in found.plotted})
    answer.say(f"{found.page}: {len(found.channels)} channels; open it in a browser")
    if found.png is not None:
        with by_options(told_as=UnusableInputError):
            save_figure(found.picture, found.png)
        answer.say(f"{found.png}: picture")
    if found.shown.next_command:
        answer.say(f"next: {found.shown.next_command}")
    answer.write(found)
