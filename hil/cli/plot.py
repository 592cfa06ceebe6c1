"""isocenter plot: recordings as a page to look around in."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hil.cli.emulated import say_emulated
from hil.cli.options import EffectsOption, can_be_written, load, not_an_input
from hil.cli.paged import check_page
from hil.errors import UnusableInputError
from hil.terminal.output import Answer, JsonOption, save_figure

if TYPE_CHECKING:
    from hil.machine import Machine
    from hil.recording import Recording


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command(
        short_help="Recordings as a page to zoom into.",
        help="Recordings as one self-contained page: all channels over time, zoomed together, with the machine file's simulation over them "
        "and beneath what it leaves."
        "\n\nExample:  isocenter plot run.mf4 --simulate -o run.html"
        "\n\nExample:  isocenter plot first.mf4 second.mf4 --channels 'position_*,current_*' -o both.html --png both.png",
    )(plot)


def plot(
    recordings: Annotated[list[Path], typer.Argument(metavar="REC...", help="Recordings (.mf4, .csv, .parquet, .mcap, .mat).")],
    out: Annotated[Path, typer.Option("-o", "--out", metavar="PAGE", help="Where to write the page (.html).")],
    machine_name: Annotated[
        str | None, typer.Option("--machine", "-m", metavar="M", help="Machine file to simulate, or for a recording that carries none.")
    ] = None,
    simulated: Annotated[bool, typer.Option("--simulate", help="Lay the simulation over it, as `isocenter simulate` makes it.")] = False,
    effects: EffectsOption = None,
    png: Annotated[Path | None, typer.Option("--png", metavar="FILE", help="Draw a still picture as well.")] = None,
    channels: Annotated[
        str, typer.Option("--channels", metavar="NAME,...", help="Only these; * stands for any letters: 'current_*,imu_x'.")
    ] = "",
    derive: Annotated[
        list[str] | None,
        typer.Option("--derive", metavar="TEXT", help="A derived channel: 'A - B', 'd(A)' (by time) or 'spectrum(A)'; once for each."),
    ] = None,
    align: Annotated[
        str, typer.Option("--align", metavar="CHANNEL", help="Shift recordings in time so that this channel lies best over the first's.")
    ] = "",
    json_to: JsonOption = None,
) -> None:
    """Read, simulate, write the page."""
    from hil.pages import Charts, write_page
    from hil.recording import read_recording
    from hil.reports.derived import derived_from, shift_to
    from hil.reports.plot import Plotted, channels_of, charts_of, drawn_channels, plot_page

    if effects is not None and not (simulated and machine_name):
        raise UnusableInputError("--effects: is physics of a simulation; give --simulate and --machine as well")
    answer = Answer(json_to)
    check_page(out)
    can_be_written(png, suffixes=(".png", ".svg", ".pdf"))
    for written in filter(None, (out, png)):
        not_an_input(written, *recordings)
    derived = [derived_from(text) for text in derive or []]
    machine = None if machine_name is None else load(machine_name, effects)
    plotted: list[Plotted] = []
    for path in recordings:
        recording = read_recording(path, machine)
        shift_s = shift_to(plotted[0].recording, recording, align) if align and plotted else None
        plotted.append(Plotted(path, recording, _simulation(path, recording, machine) if simulated else None, shift_s))
    names = channels_of(plotted, [name.strip() for name in channels.split(",") if name.strip()])
    page = plot_page(plotted, names, derived)
    write_page(page, out)
    answer.say(page.verdict.text)
    shifts = {str(each.path): each.shift_s for each in plotted if each.shift_s is not None}
    for shifted, by_s in shifts.items():
        way = "later" if by_s >= 0.0 else "earlier"
        answer.say(f"{shifted}: shown {abs(by_s):.4g} s {way}, where {align} lies best over that of {recordings[0]}")
    emulated = say_emulated(answer, {each.path: each.recording for each in plotted})
    answer.say(f"{out}: {len(names)} channels; open it in a browser")
    if png is not None:
        from hil.figures.still import still

        drawn = drawn_channels(plotted, names)
        if not drawn:
            raise UnusableInputError(f"--png {png}: no channel changes; there is nothing to draw")
        save_figure(still(Charts(charts_of(plotted, drawn), columns=min(2, len(drawn)))), png)
        answer.say(f"{png}: picture")
    if page.next_command:
        answer.say(f"next: {page.next_command}")
    answer.write({"page": out, "png": png, "channels": names, "verdict": page.verdict.text, "emulated": emulated, "shifts_s": shifts})


def _simulation(path: Path, recording: Recording, machine: Machine | None) -> Recording:
    """Return a recording's simulation by the machine file given, or by its own."""
    from hil.machine.load import machine_from_text
    from hil.simulation import simulate

    if machine is None:
        if not recording.machine_text:
            raise UnusableInputError(f"{path}: carries no machine file to simulate; give --machine")
        machine = machine_from_text(recording.machine_text, label=f"{path}: its machine file")
    return simulate(machine, recording)
