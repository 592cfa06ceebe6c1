"""Figures of geometric calibration: deviations of the nine parameters over a scan."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure

from hil.imaging.geometry import DEVIATIONS

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")  # Okabe and Ito


def deviations_figure(along: np.ndarray, label: str, curves: Mapping[str, tuple[np.ndarray, np.ndarray | None]]) -> Figure:
    """Draw nine panels of deviation from the nominal geometry [mm, mrad].

    Parameters
    ----------
    along : (N,) array
        What to draw over, an axis position or time.
    label : str
        Its name and unit.
    curves : mapping
        Name to deviation (N, 9) [m, rad] and, where there is one, covariance (N, 9, 9), drawn as a band of two standard deviations.
    """
    figure = Figure(figsize=(11.0, 7.5), layout="constrained")
    panels = figure.subplots(3, 3, sharex=True)
    order = np.argsort(along)
    for k, panel in enumerate(panels.flat):
        ends = []
        for colour, (name, (deviation, covariance)) in zip(COLOURS, curves.items(), strict=False):
            values = 1e3 * deviation[order, k]
            panel.plot(along[order], values, color=colour, label=name, linewidth=1.2)
            margin = 0.0
            if covariance is not None:
                half = 2e3 * np.sqrt(covariance[order, k, k])
                panel.fill_between(along[order], values - half, values + half, color=colour, alpha=0.25, linewidth=0)
                margin = 1.5 * float(np.median(half))
            ends += [values.min() - margin, values.max() + margin]
        if min(ends) < max(ends):  # a band that is wide at a few samples, before the first image, is cut off
            panel.set_ylim(min(ends), max(ends))
        panel.set_title(DEVIATIONS[k].replace("_", " "), fontsize=10)
        panel.set_ylabel("mm" if k < 6 else "mrad")
        panel.grid(alpha=0.3)
    for panel in panels[-1]:
        panel.set_xlabel(label)
    panels[0, 0].legend(fontsize=8)
    figure.suptitle("Deviation from the nominal geometry, in the detector's frame; bands: two standard deviations")
    return figure
