"""Figure of parameters that converge over images (thesis Fig. 5.8)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure

UNITS = {"m": ("mm", 1e3), "rad": ("mrad", 1e3), "-": ("1e-3", 1e3)}


def convergence_figure(names: Sequence[str], units: Sequence[str], curves: Sequence[Mapping[str, Sequence[float]]]) -> Figure:
    """Draw the error of each parameter over images: mean and scatter of the runs, and what is stated.

    Parameters
    ----------
    names, units : sequences of str
    curves : sequence of mappings
        Each with `error_mean`, `error_std` and `stated` after every image.
    """
    figure = Figure(figsize=(9.0, 6.0), layout="constrained")
    for panel, name, unit, curve in zip(figure.subplots(2, 2, sharex=True).flat, names, units, curves, strict=True):
        label, factor = UNITS[unit]
        mean, scatter, stated = (factor * np.array(curve[key]) for key in ("error_mean", "error_std", "stated"))
        images = np.arange(len(mean))
        panel.fill_between(images, mean - scatter, mean + scatter, color="0.8", linewidth=0, label="scatter of the runs")
        panel.plot(images, mean, color="#0072B2", label="mean of the runs")
        for sign in (-1.0, 1.0):
            panel.plot(images, sign * stated, color="#D55E00", linestyle=":", label="stated deviation" if sign > 0.0 else None)
        panel.set_yscale("symlog", linthresh=max(3.0 * float(stated[-1]), 1e-6), linscale=2.0)
        panel.set_title(name, fontsize=10)
        panel.set_ylabel(f"error [{label}]")
        panel.grid(alpha=0.3)
    for panel in figure.axes[2:]:
        panel.set_xlabel("images")
    figure.axes[0].legend(fontsize=8)
    return figure
