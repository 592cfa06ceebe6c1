"""Pictures of results, each as a figure of Matplotlib."""

from __future__ import annotations

import io
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from hil.calibration.use.lookup_table import LookUp
from hil.errors import RecordingError, UnusableInputError
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

Drawable = Recording | Recordings | FrequencyResponse | ShaperChoice | Estimate | LookUp


@as_bench_errors()
def plot(result: Drawable, simulation: Recording | Recordings | None = None, *, channels: Sequence[str] = (), title: str = "") -> Figure:
    """Draw a result.

    Parameters
    ----------
    result : Recording, FrequencyResponse, ShaperChoice, Estimate or LookUp
    simulation : Recording, optional
        Of a recording: drawn into it, and what is left beneath.
    channels : sequence of str
        Of a recording: which ones; position and command of every axis unless given.
    title : str

    Returns
    -------
    matplotlib.figure.Figure
        A notebook shows it; `.savefig("a.png")` keeps it.

    Raises
    ------
    UnusableInputError
        Nothing that can be drawn.
    RecordingError
        No such channel, or several recordings.
    """
    _show_in_notebooks()
    if isinstance(result, Recording | Recordings):
        return _recording(the_one(result), None if simulation is None else the_one(simulation), channels, title)
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


def _recording(recording: Recording, simulation: Recording | None, channels: Sequence[str], title: str) -> Figure:
    """Draw channels over time, with what a simulation leaves of each beneath it: the charts of `isocenter plot`."""
    from hil.figures.still import still
    from hil.pages import Charts
    from hil.reports.plot import Plotted, charts_of

    if simulation is not None and simulation.rows != recording.rows:
        raise RecordingError(f"{recording.rows} rows recorded, {simulation.rows} simulated; draw a simulation of this recording")
    names = list(channels) or [f"{kind}_{axis}" for axis in recording.axes for kind in SHOWN if f"{kind}_{axis}" in recording]
    names = names or [name for name in recording.channels if name != "time"]
    for name in names:
        recording.channel(name)
    return still(Charts(charts_of([Plotted(Path(), recording, simulation)], names)), title)


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
