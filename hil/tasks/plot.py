"""Pictures of results, each as a figure of Matplotlib."""

from __future__ import annotations

import io
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from hil.calibration.use.lookup_table import LookUp
from hil.errors import UnusableInputError
from hil.identification import FrequencyResponse
from hil.observing import Estimate
from hil.recording import Recording
from hil.shaping.choice import ShaperChoice
from hil.tasks.errors import as_bench_errors
from hil.tasks.recordings import Recordings, the_one

if TYPE_CHECKING:
    from matplotlib.figure import Figure

DPI = 100
SHOWN = ("position", "command")
"""Kinds of channels drawn of every axis unless some are named."""

SHOWN = ("position", "command")
"""Kinds of channels drawn of every axis unless some are named."""

Drawable = Recording | Recordings | FrequencyResponse | ShaperChoice | Estimate | LookUp


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
        Several recordings.
    """
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
