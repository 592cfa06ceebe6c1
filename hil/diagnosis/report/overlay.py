"""Recorded beside simulated, nominal, re-tuned and with the effects: current beside encoder beside IMU."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure

from hil.diagnosis.report.style import STAGE_COLOURS, STAGE_NAMES
from hil.diagnosis.residuals.mismatch import Mismatch

SHOWN_s = 4.0
"""Length of the stretch that is drawn: a motion there and back, and still its details."""

WIDTH_in, LEFT_in, RIGHT_in = 3.3, 1.0, 0.1
"""Of one channel's axes, and of what stands beside them."""

HEIGHT_in, ABOVE_in, BELOW_in = 5.6, 0.55, 0.85
"""Of the figure, and of what stands above and below its axes."""

LABEL_in = 0.58
"""From the axes to their label: tick numbers of six characters."""

LEAST_ROWS = 50
RECORDED = "0.65"
"""A wide grey line under the coloured ones: what is recorded may be noise from edge to edge."""

KINDS = (("current_", "effort_", "command_"), ("position_", "link_position_", "speed_"), ("imu_", "gyro_"))
"""One column each; of every kind the channel with the largest mismatch."""


def overlay_figure(found: Mismatch, stages: Mapping[str, Sequence[np.ndarray]], title: str) -> Figure:
    """Above, the channel and its simulations; below, what each leaves, with the noise of one repeat as a grey band.

    Parameters
    ----------
    found : Mismatch
    stages : mapping of str to sequence of (N, C) arrays
        Simulated rows per group at "nominal", "retuned" and, where an effect is named, "extended".
    """
    number, rows = _stretch(found, stages)
    group = found.groups[number]
    columns = _columns(found, stages, number)
    figure = Figure(figsize=((LEFT_in + WIDTH_in + RIGHT_in) * len(columns), HEIGHT_in))
    axes = figure.subplots(2, len(columns), sharex=True, squeeze=False, height_ratios=(3, 2), gridspec_kw=_margins(figure))
    time_s = group.time_s[rows]
    for place, c in enumerate(columns):
        above, below = axes[0, place], axes[1, place]
        above.plot(time_s, group.mean[rows, c], color=RECORDED, lw=2.6, label="recorded")
        for stage, simulated in stages.items():
            colour = STAGE_COLOURS[stage]
            above.plot(time_s, simulated[number][rows, c], color=colour, lw=1.0, label=STAGE_NAMES[stage])
            below.plot(time_s, (group.mean - simulated[number])[rows, c], color=colour, lw=0.9)
        sigma = float(found.noise.std[c])
        below.axhspan(-2.0 * sigma, 2.0 * sigma, color="0.85", lw=0, label="noise, ±2 standard deviations")
        above.set_ylabel(f"{found.channels[c]} [{found.units[c]}]")
        below.set_ylabel(f"recorded less\nsimulated [{found.units[c]}]")
        below.set_xlabel("time [s]")
        for each in (above, below):
            each.grid(alpha=0.3, lw=0.5)
            each.tick_params(axis="y", labelsize="small")
            each.ticklabel_format(axis="y", scilimits=(-3, 4))
            each.yaxis.set_label_coords(-LABEL_in / WIDTH_in, 0.5)
    handles, labels = axes[0, 0].get_legend_handles_labels()
    more, names = axes[1, 0].get_legend_handles_labels()
    figure.legend(handles + more, labels + names, loc="lower center", ncols=5 if len(columns) > 1 else 2, fontsize="small", frameon=False)
    of = f", mean of {group.repeats} repeats" if group.repeats > 1 else ""
    figure.suptitle(f"{title}: {group.labels[0]}{of}\n{_window_words(group.time_s, rows)}", fontsize="medium")
    return figure


def _margins(figure: Figure) -> dict[str, float]:
    """Places for axes that leave their labels so much: a layout that is solved takes longer than drawing them."""
    width, height = figure.get_size_inches()
    return {
        "left": LEFT_in / width, "right": 1.0 - RIGHT_in / width, "wspace": (LEFT_in + RIGHT_in) / WIDTH_in,
        "bottom": BELOW_in / height, "top": 1.0 - ABOVE_in / height, "hspace": 0.16,
    }  # fmt: skip


def _window_words(time_s: np.ndarray, rows: slice) -> str:
    """Which part of the record is drawn, and why that one."""
    shown, whole = time_s[rows], float(time_s[-1] - time_s[0])
    if len(shown) == len(time_s):
        return f"all {whole:.3g} s of it"
    return f"{shown[0]:.3g} s to {shown[-1]:.3g} s of {whole:.3g} s: where the simulations differ most"


def _stretch(found: Mismatch, stages: Mapping[str, Sequence[np.ndarray]]) -> tuple[int, slice]:
    """The group and the rows in which the nominal simulation and the last one differ most, in units of noise."""
    best = (-1.0, 0, slice(0, 1))
    first, *_, last = stages["nominal"], *stages.values()
    for number, group in enumerate(found.groups):
        width = max(LEAST_ROWS, round(SHOWN_s * found.noise.rate_Hz))
        change = np.sum(((last[number] - first[number]) / found.noise.std) ** 2, axis=1)
        if not np.isfinite(change).all():
            change = np.zeros(len(group.time_s))
        width = min(width, len(change))
        sums = np.concatenate([[0.0], np.cumsum(change)])
        power = sums[width:] - sums[:-width]
        start = int(np.argmax(power))
        if power[start] > best[0]:
            best = (float(power[start]), number, slice(start, start + width))
    return best[1], best[2]


def _columns(found: Mismatch, stages: Mapping[str, Sequence[np.ndarray]], number: int) -> list[int]:
    """One channel of every kind there is."""
    residual = found.groups[number].mean - stages["nominal"][number]
    size = np.sqrt(np.mean(residual**2, axis=0)) / found.noise.std
    chosen = []
    for kind in KINDS:
        of_kind = [c for c, name in enumerate(found.channels) if name.startswith(kind)]
        if of_kind:
            chosen.append(max(of_kind, key=lambda c: size[c]))
    return chosen
