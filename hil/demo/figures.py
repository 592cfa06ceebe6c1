"""Figures of the demo."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from hil.demo.told import Story
from hil.figures.frf import frf_figure

# Okabe and Ito's palette: told apart by colour-blind readers and in grey
BLUE, VERMILION, ORANGE, GREY = "#0072B2", "#D55E00", "#E69F00", "#999999"
EXCERPT_S = 1.5


def experiment_figure(story: Story) -> Figure:
    """Draw reference and position, excitation and current of both axes over the last period."""
    recording = story.recording
    period = recording.experiment["period_samples"]
    last = slice(recording.rows - period, recording.rows)
    time_s = recording.time[last] - recording.time[last][0]
    figure = Figure(figsize=(10.0, 5.2), layout="constrained")
    grid = figure.subplots(2, len(story.machine.axes), sharex=True, squeeze=False)
    for column, axis in enumerate(story.machine.axes):
        above, below = grid[0, column], grid[1, column]
        above.plot(time_s, np.degrees(recording.channel(f"position_{axis}").values[last]), color=BLUE, lw=1.4, label="position")
        above.plot(
            time_s, np.degrees(recording.channel(f"reference_{axis}").values[last]), color="black", lw=0.9, ls="--", label="reference"
        )
        below.plot(time_s, recording.channel(f"current_{axis}").values[last], color=BLUE, lw=0.5, label="current")
        below.plot(time_s, recording.channel(f"excitation_{axis}").values[last], color=ORANGE, lw=0.4, label="excitation")
        above.set_title(axis)
        below.set_xlabel("Time in the period [s]")
        above.legend(frameon=False, loc="upper right")
        below.legend(frameon=False, ncols=2, loc="lower center", bbox_to_anchor=(0.5, 1.0), fontsize="small")
    grid[0, 0].set_ylabel("Angle [deg]")
    grid[1, 0].set_ylabel("Motor current [A]")
    return figure


def response_figure(story: Story) -> Figure:
    """Draw the frequency response matrix with its variances and the machine file's plant."""
    model = ("machine file, linearised", story.response.frequencies_Hz, story.linearisation)
    return frf_figure(story.response, compared=[model])


def friction_figure(story: Story) -> Figure:
    """Draw roll current recorded and simulated, and the error of the nominal simulation over the speed."""
    recording, rate = story.recording, story.machine.sample_rate_Hz
    time_s = recording.time
    reference = recording.channel("reference_roll").values
    speed = np.degrees(np.gradient(reference) * rate)
    reversal = np.flatnonzero(np.diff(np.sign(speed[recording.rows // 2 :])))[0] + recording.rows // 2
    half = round(EXCERPT_S / 2 * rate)
    shown = slice(max(0, reversal - half), reversal + half)
    figure = Figure(figsize=(10.0, 4.0), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=[1.7, 1.0])
    name = "current_roll"
    for label, source, colour, width in (
        ("recorded", recording, "black", 2.4),
        ("simulated, machine file as it is", story.nominal, VERMILION, 0.9),
        ("simulated with the friction", story.with_friction, BLUE, 0.9),
    ):
        left.plot(time_s[shown], source.channel(name).values[shown], color=colour, lw=width, label=label)
    left.axvline(time_s[reversal], color=GREY, lw=0.8, ls=":")
    left.set_xlabel("Time [s], dotted: the jog reverses")
    left.set_ylabel("Roll current [A]")
    left.legend(frameon=False, fontsize="small", ncols=3, loc="lower center", bbox_to_anchor=(0.5, 1.0))
    for label, source, colour in (("machine file as it is", story.nominal, VERMILION), ("with the friction", story.with_friction, BLUE)):
        missed = _smoothed(recording.channel(name).values - source.channel(name).values, round(rate / 4.0))
        right.plot(speed[::8], missed[::8], ".", ms=1.5, color=colour, label=label)
    right.set_xlabel("Reference speed of roll [deg/s]")
    right.set_ylabel("Recorded minus simulated [A]\n(0.25 s mean)")
    right.locator_params(axis="x", nbins=5)
    right.legend(frameon=False, fontsize="small", markerscale=6)
    return figure


def nrmse_figure(story: Story) -> Figure:
    """Draw NRMSE of every channel, without and with the friction."""
    names = [channel.name for channel in story.nominal_comparison.channels]
    figure = Figure(figsize=(10.0, 3.2), layout="constrained")
    axes = figure.subplots()
    at = np.arange(len(names))
    for offset, label, comparison, colour in (
        (-0.2, "machine file as it is", story.nominal_comparison, VERMILION),
        (0.2, "with the friction", story.friction_comparison, BLUE),
    ):
        axes.bar(at + offset, [100.0 * comparison[name].nrmse for name in names], 0.4, color=colour, label=label)
    axes.set_yscale("log")
    axes.set_xticks(at, names, rotation=35, ha="right", fontsize="small")
    axes.set_ylabel("NRMSE [%]")
    axes.legend(frameon=False, ncols=2, loc="lower center", bbox_to_anchor=(0.5, 1.0))
    return figure


def _smoothed(values: np.ndarray, rows: int) -> np.ndarray:
    return np.convolve(values, np.full(rows, 1.0 / rows), mode="same")
