"""Recordings as a page to zoom into, with simulations over them; and pictures of results, each as a figure of Matplotlib."""

from __future__ import annotations

import io
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from hil.errors import RecordingError, RequestError, UnusableInputError
from hil.verbs.errors import as_bench_errors
from hil.verbs.verb import EFFECTS, KEPT, NOBODY, Listener, argument, option

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from hil.calibration.use.lookup_table import LookUp
    from hil.identification import FrequencyResponse
    from hil.machine import Machine
    from hil.observing import Estimate
    from hil.pages import Page
    from hil.recording import Recording
    from hil.reports.plot import Plotted
    from hil.shaping.choice import ShaperChoice
    from hil.verbs.recordings import Recordings

    Drawable = Recording | Recordings | FrequencyResponse | ShaperChoice | Estimate | LookUp

DPI = 100
SHOWN = ("position", "command")
"""Kinds of channels drawn of every axis unless some are named."""


@dataclass(frozen=True)
class PlotRequest:
    """Files of recordings, and what a page shows of them."""

    recordings: Sequence[Path] = argument("Recordings (.mf4, .csv, .parquet, .mcap, .mat).", "REC...")
    out: Path = option("Where to write the page (.html).", "PAGE", "-o", "--out", is_needed=True)
    machine: str | None = option("Machine file to simulate, or for a recording that carries none.", "M", "--machine", "-m", kind=str)
    simulate: bool = option("Lay the simulation over it, as `isocenter simulate` makes it.", None, "--simulate", default=False)
    effects: Path | None = option(EFFECTS, "FILE", "--effects")
    png: Path | None = option("Draw a still picture as well.", "FILE", "--png")
    channels: Sequence[str] = option("Only these; * stands for any letters: 'current_*,imu_x'.", "NAME,...", "--channels", default=())
    derive: Sequence[str] = option(
        "A derived channel: 'A - B', 'd(A)' (by time) or 'spectrum(A)'; once for each.",
        "TEXT",
        "--derive",
        kind=str,
        default=(),
        is_several=True,
    )
    align: str = option("Shift recordings in time so that this channel lies best over the first's.", "CHANNEL", "--align", default="")


@dataclass(frozen=True)
class PlotAnswer:
    """The page that was written."""

    page: Path
    """Its file."""
    png: Path | None
    """File of the picture."""
    channels: list[str]
    """What is in the page."""
    verdict: str
    """The sentence on top of it."""
    emulated: bool
    """Whether a recording is of the emulator."""
    shifts_s: Mapping[str, float]
    """By how much each recording is shown later, where they were aligned."""
    shown: Page = field(metadata=KEPT, repr=False)
    plotted: Sequence[Plotted] = field(metadata=KEPT, repr=False)

    @property
    def picture(self) -> Figure:
        """The charts of what moved; RequestError where nothing did."""
        from hil.figures.still import still
        from hil.pages import Charts
        from hil.reports.plot import charts_of, drawn_channels

        drawn = drawn_channels(self.plotted, self.channels)
        if not drawn:
            raise RequestError("{png} {}: no channel changes; there is nothing to draw", self.png)
        return still(Charts(charts_of(self.plotted, drawn), columns=min(2, len(drawn))))


def answer(request: PlotRequest, listener: Listener = NOBODY) -> PlotAnswer:
    """Read recordings, simulate them where that is asked for, and write the page.

    Raises
    ------
    RequestError
        Effects without a simulation by a machine file that is given.
    UnusableInputError, RecordingError
        A file cannot be read or written, there is no such channel, or no machine file to simulate.
    BadAnswerError
        A simulation diverged.
    """
    from hil.files.writable import can_be_written, not_an_input
    from hil.machine.effects_file import load_with_effects
    from hil.pages import write_page
    from hil.recording import read_recording
    from hil.reports.derived import derived_from, shift_to
    from hil.reports.plot import Plotted, channels_of, plot_page

    if request.effects is not None and not (request.simulate and request.machine):
        raise RequestError("{effects}: is physics of a simulation; give {simulate} and {machine} as well")
    can_be_written(request.out, suffixes=(".html", ".htm"))
    can_be_written(request.png, suffixes=(".png", ".svg", ".pdf"))
    for written in filter(None, (request.out, request.png)):
        not_an_input(written, *request.recordings)
    derived = [derived_from(text) for text in request.derive]
    machine = None if request.machine is None else load_with_effects(request.machine, request.effects)
    plotted: list[Plotted] = []
    for path in request.recordings:
        recording = read_recording(path, machine)
        shift_s = shift_to(plotted[0].recording, recording, request.align) if request.align and plotted else None
        plotted.append(Plotted(path, recording, _simulation(path, recording, machine) if request.simulate else None, shift_s))
    channels = channels_of(plotted, request.channels)
    page = plot_page(plotted, channels, derived)
    write_page(page, request.out)
    shifts = {str(each.path): each.shift_s for each in plotted if each.shift_s is not None}
    emulated = any(each.recording.emulated for each in plotted)
    return PlotAnswer(request.out, request.png, channels, page.verdict.text, emulated, shifts, page, plotted)


def _simulation(path: Path, recording: Recording, machine: Machine | None) -> Recording:
    """Return a recording's simulation by the machine file given, or by its own."""
    from hil.machine import machine_from_text
    from hil.verbs.simulate import simulate

    if machine is None:
        if not recording.machine_text:
            raise RequestError("{}: carries no machine file to simulate; give {machine}", path)
        machine = machine_from_text(recording.machine_text, label=f"{path}: its machine file")
    return simulate(machine, recording)


@as_bench_errors()
def plot(
    result: Drawable,
    simulation: Recording | Recordings | None = None,
    *,
    channels: Sequence[str] = (),
    title: str = "",
    page: str | Path | None = None,
) -> Figure:
    """Draw a result.

    Parameters
    ----------
    result : Recording, FrequencyResponse, ShaperChoice, Estimate or LookUp
    simulation : Recording, optional
        Of a recording: drawn into it, and what is left beneath.
    channels : sequence of str
        Of a recording: names or patterns such as `current_*`; position and command of every axis unless given.
    title : str
    page : str or Path, optional
        Of a recording: the page to zoom into (.html) that `isocenter plot` writes, with all channels unless some are given.

    Returns
    -------
    matplotlib.figure.Figure
        A notebook shows it; `.savefig("a.png")` keeps it.

    Raises
    ------
    UnusableInputError
        Nothing that can be drawn, or no such channel.
    RecordingError
        Several recordings, or simulation and recording differ in length.
    """
    import numpy as np

    from hil.calibration.use.lookup_table import LookUp
    from hil.identification import FrequencyResponse
    from hil.observing import Estimate
    from hil.recording import Recording
    from hil.shaping.choice import ShaperChoice
    from hil.verbs.recordings import Recordings, the_one

    _show_in_notebooks()
    if isinstance(result, Recording | Recordings):
        return _recording(the_one(result), None if simulation is None else the_one(simulation), channels, title, page)
    if simulation is not None or channels or page is not None:
        raise UnusableInputError(f"{type(result).__name__}: a simulation, channels and a page go with a recording")
    if isinstance(result, FrequencyResponse):
        from hil.figures.frf import frf_figure

        return frf_figure(result, title=title)
    if isinstance(result, ShaperChoice):
        from hil.figures.shapers import design_figure

        title = title or f"{result.axis} of {result.machine.name}"
        return design_figure(result.designs, result.subjects.each, result.aim, result.machine.sample_rate_Hz, title=title)
    if isinstance(result, Estimate):
        from hil.figures.observer import observer_figure

        return observer_figure(result)
    if isinstance(result, LookUp):
        from hil.figures.geometry import deviations_figure

        axis = int(np.argmax(np.ptp(result.positions, axis=0)))
        return deviations_figure(
            result.positions[:, axis], f"{result.axes[axis]} [rad or m]", {title or "phantom": (result.deviation, result.covariance)}
        )
    raise UnusableInputError(f"{type(result).__name__}: is not drawn; a recording, response, shaper, estimate or look-up table is")


def _recording(recording: Recording, simulation: Recording | None, channels: Sequence[str], title: str, page: str | Path | None) -> Figure:
    from hil.figures.still import still
    from hil.pages import Charts, write_page
    from hil.reports.plot import Plotted, channels_of, charts_of, plot_page

    if simulation is not None and simulation.rows != recording.rows:
        raise RecordingError(f"{recording.rows} rows recorded, {simulation.rows} simulated; draw a simulation of this recording")
    plotted = [Plotted(Path(title or "recording"), recording, simulation)]
    if page is not None:
        write_page(plot_page(plotted, channels_of(plotted, channels)), Path(page))
    shown = channels or [f"{kind}_{axis}" for axis in recording.axes for kind in SHOWN if f"{kind}_{axis}" in recording]
    return still(Charts(charts_of(plotted, channels_of(plotted, shown)), columns=1), title)


def _show_in_notebooks() -> None:
    """Let a notebook show figures, which it does by itself only for those of Matplotlib's pyplot."""
    shell = getattr(sys.modules.get("IPython"), "get_ipython", lambda: None)()
    if shell is None:
        return
    from matplotlib.figure import Figure

    def png(figure: Figure) -> bytes:
        buffer = io.BytesIO()
        figure.savefig(buffer, format="png", dpi=DPI)
        return buffer.getvalue()

    shell.display_formatter.formatters["image/png"].for_type(Figure, png)
