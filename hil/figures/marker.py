"""Figures of a scan with a marker plate on its tube."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from hil.calibration.marker.scan import MarkerScan
from hil.imaging.markers.projection import PARAMETERS

BLUE, GREY = "#0072B2", "#777777"


def marker_figure(along: np.ndarray, label: str, result: MarkerScan, title: str) -> Figure:
    """Draw the deviation from nominal of each fitted parameter [mm, mrad] with bands of two standard deviations.

    It is drawn over a position or time.
    """
    columns = [PARAMETERS.index(name) for name in result.free]
    wide = min(3, len(columns))
    high = -(-len(columns) // wide)
    figure = Figure(figsize=(3.7 * wide, 2.7 * high + 0.5), layout="constrained")
    panels = figure.subplots(high, wide, sharex=True, squeeze=False)
    order = np.argsort(along)[result.good[np.argsort(along)]]
    for panel, k in zip(panels.flat, columns, strict=False):
        values = 1e3 * (result.values - result.nominal)[order, k]
        half = 2e3 * np.sqrt(result.covariance[order, k, k])
        panel.fill_between(along[order], values - half, values + half, color=BLUE, alpha=0.25, linewidth=0)
        panel.plot(along[order], values, color=BLUE, linewidth=1.2)
        panel.axhline(0.0, color=GREY, linewidth=0.6)
        panel.set_title(PARAMETERS[k].replace("_", " "), fontsize=10)
        panel.set_ylabel("mrad" if 3 <= k < 6 else "mm")
        panel.grid(alpha=0.3)
    for panel in panels.flat[len(columns) :]:
        panel.set_axis_off()
    for panel in panels[-1]:
        panel.set_xlabel(label)
    figure.suptitle(f"{title}: deviation from nominal; bands: two standard deviations", fontsize=11)
    return figure
