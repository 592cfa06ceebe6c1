"""Residuals in units of repeat noise over pose and speed, and over pose and frequency; cells that nothing visited are hatched."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.signal
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.ticker import MaxNLocator

from hil.diagnosis.residuals.mismatch import Mismatch
from hil.diagnosis.residuals.whitened import InNoiseUnits, in_noise_units

POSE_CELLS = 16
SPEED_CELLS = 12
LEAST_ROWS = 5
"""A cell with fewer rows was not visited."""

WINDOW_s = 1.0
"""Of the spectra over pose: its inverse is the width of a line."""

BANDS = 14
SIDE_BY_SIDE = 6
BRIGHTEST = 100.0
"""In units of noise: the colour scale ends there."""

PLAIN = "{x:g}"
"""Powers of ten as numbers: to set a formula takes longer than all ticks of an axis."""


@dataclass(frozen=True, eq=False)
class HeatMap:
    """Mean power of cells (x cells, y cells) in units of noise; NaN where nothing was."""

    x_edges: np.ndarray
    y_edges: np.ndarray
    power: np.ndarray


def residuals(found: Mismatch) -> list[InNoiseUnits]:
    """What each group's simulation leaves, in units of noise."""
    return [in_noise_units(found.noise, group.mean - group.simulated) for group in found.groups]


def over_pose_and_speed(found: Mismatch, left: Sequence[InNoiseUnits], axis: int, channel: int) -> HeatMap | None:
    """Of one axis's position and speed; `left` is the groups' `residuals`. None for an axis that does not move."""
    x_edges = _pose_edges(found, left, axis)
    y = np.concatenate([group.speed[each.first_row :, axis] for group, each in zip(found.groups, left, strict=True)])
    if x_edges is None or not np.ptp(y) > 0.0:
        return None
    x = np.concatenate([group.position[each.first_row :, axis] for group, each in zip(found.groups, left, strict=True)])
    power = np.concatenate([each.rows[:, channel] ** 2 for each in left])
    y_edges = np.linspace(y.min(), y.max(), SPEED_CELLS + 1)
    return HeatMap(x_edges, y_edges, _mean_in_cells(x, y, power, x_edges, y_edges))


def over_pose_and_frequency(found: Mismatch, left: Sequence[InNoiseUnits], axis: int, channel: int) -> HeatMap | None:
    """Of one axis's position; a row of a recording has the spectrum of the window whose middle is nearest."""
    rate_Hz = found.noise.rate_Hz
    width = round(WINDOW_s * rate_Hz)
    seen = []
    for group, each in zip(found.groups, left, strict=True):
        if len(each.rows) < 2 * width or width < 8:
            continue
        lines_Hz, times_s, spectrum = scipy.signal.spectrogram(
            each.rows[:, channel], rate_Hz, window="hann", nperseg=width, noverlap=width // 2, detrend=False, scaling="density", mode="psd"
        )
        position = group.position[each.first_row :, axis]
        window = np.searchsorted(0.5 * (times_s[1:] + times_s[:-1]), np.arange(len(position)) / rate_Hz)
        seen.append((position, window, spectrum[1:] * rate_Hz / 2.0))  # white noise of unit variance has density 2 / rate
    x_edges = _pose_edges(found, left, axis)
    if x_edges is None or not seen:
        return None
    y_edges = _edges_between_lines(lines_Hz[1:])
    first_line = np.searchsorted(lines_Hz[1:], y_edges[:-1])
    rows, sums = np.zeros((POSE_CELLS, 1)), np.zeros((POSE_CELLS, len(first_line)))
    for position, window, spectrum in seen:
        bands = np.add.reduceat(spectrum, first_line) / np.diff(first_line, append=len(spectrum))[:, None]
        visits = np.histogram2d(position, window, bins=(x_edges, np.arange(bands.shape[1] + 1) - 0.5))[0]
        rows += visits.sum(axis=1, keepdims=True)
        sums += visits @ bands.T
    return HeatMap(x_edges, y_edges, np.where(rows >= LEAST_ROWS, sums / np.maximum(rows, 1.0), np.nan))


def _pose_edges(found: Mismatch, left: Sequence[InNoiseUnits], axis: int) -> np.ndarray | None:
    """(POSE_CELLS + 1,) the same for every map of an axis; None where it does not move."""
    positions = [group.position[each.first_row :, axis] for group, each in zip(found.groups, left, strict=True)]
    lowest, highest = min(each.min() for each in positions), max(each.max() for each in positions)
    return np.linspace(lowest, highest, POSE_CELLS + 1) if highest > lowest else None


def _edges_between_lines(lines_Hz: np.ndarray) -> np.ndarray:
    """Edges of at most BANDS bands, wider with frequency, with a line in every one."""
    numbers = np.unique(np.round(np.geomspace(1, len(lines_Hz), BANDS + 1)).astype(int))
    step = lines_Hz[1] - lines_Hz[0] if len(lines_Hz) > 1 else lines_Hz[0]
    return np.concatenate([lines_Hz[numbers[:-1] - 1], [lines_Hz[-1] + step]]) - 0.5 * step


def _mean_in_cells(x: np.ndarray, y: np.ndarray, power: np.ndarray, x_edges: np.ndarray, y_edges: np.ndarray) -> np.ndarray:
    edges = (x_edges, y_edges)
    rows = np.histogram2d(x, y, bins=edges)[0]
    sums = np.histogram2d(x, y, bins=edges, weights=power)[0]
    return np.where(rows >= LEAST_ROWS, sums / np.maximum(rows, 1.0), np.nan)


def heat_map_figures(found: Mismatch, axis: int, stage: str) -> list[Figure]:
    """Of every channel, some side by side in each figure; none for an axis that does not move."""
    left = residuals(found)
    parts = [range(start, min(start + SIDE_BY_SIDE, len(found.channels))) for start in range(0, len(found.channels), SIDE_BY_SIDE)]
    figures = (_figure(found, left, axis, stage, channels) for channels in parts)
    return [figure for figure in figures if figure is not None]


def _figure(found: Mismatch, left: Sequence[InNoiseUnits], axis: int, stage: str, channels: Sequence[int]) -> Figure | None:
    """A row for each kind of map that there is; None for an axis that does not move."""
    units = found.machine.units[axis]
    kinds = [
        (f"speed [{units.position}/s]", "linear", [over_pose_and_speed(found, left, axis, c) for c in channels]),
        ("frequency [Hz]", "log", [over_pose_and_frequency(found, left, axis, c) for c in channels]),
    ]
    kinds = [kind for kind in kinds if any(heat_map is not None for heat_map in kind[2])]
    if not kinds:
        return None
    figure = Figure(figsize=(2.9 * len(channels) + 1.2, 2.5 * len(kinds) + 0.8))
    axes = figure.subplots(len(kinds), len(channels), squeeze=False, sharey="row", gridspec_kw=_margins(figure))
    drawn = []
    for row, (label, scale, maps) in enumerate(kinds):
        axes[row, 0].set(yscale=scale, ylabel=label)
        if scale == "log":
            axes[row, 0].yaxis.set_major_formatter(PLAIN)
        for place, heat_map in zip(axes[row], maps, strict=True):
            if heat_map is None:
                place.set_axis_off()
                continue
            drawn.append(_draw(place, heat_map))
            place.xaxis.set_visible(row == len(kinds) - 1)  # all have the same
            place.yaxis.set_visible(place is axes[row, 0])  # of a figure's time most is ticks
    for place, c in zip(axes[0], channels, strict=True):
        place.set_title(found.channels[c], fontsize="medium")
    for place in axes[-1]:
        place.set_xlabel(f"position of {units.axis} [{units.position}]")
    top, last, width = axes[0, -1].get_position(), axes[-1, -1].get_position(), figure.get_figwidth()
    bar = figure.add_axes((last.x1 + 0.2 / width, last.y0, 0.15 / width, top.y1 - last.y0))
    figure.colorbar(drawn[-1], cax=bar, extend="max", format=PLAIN, label="rms of the residual\nin units of one repeat's noise")
    figure.suptitle(f"Residual over the pose of {units.axis}, {stage}\nhatched: not visited", fontsize="medium")
    return figure


def _margins(figure: Figure) -> dict[str, float]:
    """Places for axes, from what stands beside them in inches: a layout solved for thirteen axes takes longer than drawing them."""
    width, height = figure.get_size_inches()
    return {
        "left": 0.75 / width, "right": 1.0 - 1.2 / width, "wspace": 0.12,
        "bottom": 0.55 / height, "top": 1.0 - 0.75 / height, "hspace": 0.2,
    }  # fmt: skip


def _draw(axes: Axes, heat_map: HeatMap):  # type: ignore[no-untyped-def]
    x, y = heat_map.x_edges, heat_map.y_edges
    size = np.sqrt(np.ma.masked_invalid(heat_map.power.T))
    axes.add_patch(Rectangle((x[0], y[0]), x[-1] - x[0], y[-1] - y[0], hatch="////", fill=False, edgecolor="0.7", lw=0, zorder=0))
    drawn = axes.pcolormesh(x, y, size, norm=LogNorm(0.5, BRIGHTEST, clip=True), cmap="cividis", zorder=1)
    axes.set(xlim=(x[0], x[-1]), ylim=(y[0], y[-1]))
    axes.tick_params(labelsize="small")
    axes.xaxis.set_major_locator(MaxNLocator(4))  # or their numbers run into each other
    return drawn
