"""Figure of a recording over time, with its simulation and what is left between them."""

from __future__ import annotations

from collections.abc import Sequence

from matplotlib.figure import Figure

from hil.errors import RecordingError
from hil.recording import Recording

BLUE, VERMILION, GREY = "#0072B2", "#D55E00", "#777777"
"""Okabe and Ito's palette: told apart by colour-blind readers and in grey."""

SHOWN = ("position", "command")
"""Kinds of channels drawn of every axis unless some are named."""

ROW_IN, RESIDUAL_IN, WIDTH_IN = 1.9, 1.1, 9.0


def recording_figure(recording: Recording, simulation: Recording | None = None, channels: Sequence[str] = (), title: str = "") -> Figure:
    """Draw channels over time; with a simulation, it too, and simulation minus recording beneath each.

    Parameters
    ----------
    recording : Recording
    simulation : Recording, optional
        Of the same rows.
    channels : sequence of str
        Position and command of every axis unless given.
    title : str

    Raises
    ------
    RecordingError
        No such channel, or simulation and recording differ in length.
    """
    names = list(channels) or [f"{kind}_{axis}" for axis in recording.axes for kind in SHOWN if f"{kind}_{axis}" in recording]
    names = names or [name for name in recording.channels if name != "time"]
    if simulation is not None and simulation.rows != recording.rows:
        raise RecordingError(f"{recording.rows} rows recorded, {simulation.rows} simulated; draw a simulation of this recording")
    heights = [ROW_IN] * len(names) if simulation is None else [ROW_IN, RESIDUAL_IN] * len(names)
    figure = Figure(figsize=(WIDTH_IN, sum(heights) + 0.6), layout="constrained")
    rows = figure.subplots(len(heights), 1, sharex=True, squeeze=False, height_ratios=heights)[:, 0]
    for place, name in enumerate(names):
        axes = rows[place * (1 if simulation is None else 2)]
        unit = recording.channel(name).unit
        axes.plot(recording.time, recording[name], color=BLUE, linewidth=0.9, label="recorded")
        axes.set_ylabel(f"{name}\n[{unit or '-'}]")
        if simulation is not None and name in simulation:
            axes.plot(recording.time, simulation[name], color=VERMILION, linewidth=0.9, linestyle="--", label="simulated")
            beneath = rows[2 * place + 1]
            beneath.plot(recording.time, simulation[name] - recording[name], color=GREY, linewidth=0.8)
            beneath.set_ylabel(f"sim − rec\n[{unit or '-'}]")
        axes.grid(alpha=0.3, linewidth=0.5)
    rows[0].legend(loc="upper right", ncols=2)
    rows[-1].set_xlabel("time [s]")
    figure.align_ylabels()
    if title:
        figure.suptitle(title)
    return figure
