"""Charts of a page as a still picture, for reports on paper."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from hil.pages import Chart, Charts

WIDTH_in, STACK_WIDTH_in = 9.0, 6.5
PIXELS_per_in = 96.0
ROOM_in = 0.85
"""Above and below the axes of a chart, for its title, numbers and label."""

FORMS = {"circle": "o", "cross": "x", "square": "s", "triangle": "^", "plus": "+", "diamond": "D", "ring": "o"}
HOLLOW = ("square", "triangle", "diamond", "ring")


def still(charts: Charts, title: str = "") -> Figure:
    """Draw charts as they stand on a page, without what only a screen can do."""
    stacks = charts.stacks()
    columns = min(charts.columns, len(stacks))
    lines = [stacks[start : start + columns] for start in range(0, len(stacks), columns)]
    heights = [max(sum(chart.height / PIXELS_per_in + ROOM_in for chart in stack) for stack in line) for line in lines]
    width = WIDTH_in if columns == 1 else STACK_WIDTH_in * columns
    figure = Figure(figsize=(width, sum(heights) + (0.4 if title else 0.0)), layout="constrained")
    rows = np.atleast_1d(np.array(figure.subfigures(len(lines), columns, squeeze=False, height_ratios=heights)))
    for line, places in zip(lines, rows, strict=True):
        for stack, place in zip(line, places, strict=False):
            axes = place.subplots(len(stack), squeeze=False, sharex=True, height_ratios=[chart.height for chart in stack])[:, 0]
            for chart, one in zip(stack, axes, strict=True):
                _draw(one, chart)
            axes[-1].set_xlabel(stack[-1].x.label)
    if title:
        figure.suptitle(title)
    return figure


def _draw(axes: Axes, chart: Chart) -> None:
    for band in chart.bands:
        axes.fill_between(band.x, band.low, band.high, color="0.8", linewidth=0, label=band.label)
    for one, style in zip(chart.series, chart.styles(), strict=True):
        if style.marker:
            face = "none" if style.marker in HOLLOW else style.colour
            axes.plot(one.x, one.y, FORMS[style.marker], color=style.colour, markerfacecolor=face, markersize=3, label=one.label)
        else:
            dashes = (0, tuple(0.75 * length for length in style.dash)) if style.dash else "-"
            axes.plot(one.x, one.y, color=style.colour, linestyle=dashes, linewidth=1.0, label=one.label)
    if chart.x.is_log:
        axes.set_xscale("log")
    if chart.y.is_log:
        axes.set_yscale("log")
    if chart.x.ends:
        axes.set_xlim(chart.x.ends)
    if chart.y.ends:
        axes.set_ylim(chart.y.ends)
    _mark(axes, chart)
    axes.set_ylabel(chart.y.label, fontsize="small")
    axes.set_title(chart.title + (f" · {chart.pose}" if chart.pose else ""), fontsize="small", loc="left")
    axes.grid(alpha=0.3, linewidth=0.5)
    axes.tick_params(labelsize="small")
    if len(chart.series) + len(chart.bands) > 1:
        axes.legend(fontsize="x-small", loc="upper right", framealpha=0.85, edgecolor="none")


def _mark(axes: Axes, chart: Chart) -> None:
    for place, mark in enumerate(chart.marks):
        axes.axvline(mark.x, color="0.3", linewidth=0.7, linestyle=":")
        axes.annotate(
            mark.label, (mark.x, 0.97 - 0.12 * (place % 4)), xycoords=("data", "axes fraction"), xytext=(3, 0),
            textcoords="offset points", fontsize=7, va="top",
        )  # fmt: skip
