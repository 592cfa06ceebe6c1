"""Figure of an observer's estimates over a recording: the detector's displacement with its deviation, and the consistency."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure
from scipy import stats

from hil.observing.estimate import Estimate

BAND = 0.95


def observer_figure(estimate: Estimate) -> Figure:
    """Draw shift, turn, and NIS beside its 95 % band, over time."""
    figure = Figure(figsize=(9.0, 7.5), layout="constrained")
    shift, turn, consistency = figure.subplots(3, 1, sharex=True)
    time = estimate.time_s
    for axes, prefix, unit in ((shift, "estimate_detector_", "mm"), (turn, "estimate_detector_r", "mrad")):
        for name, colour in zip("xyz", ("C0", "C1", "C2"), strict=True):
            value = 1e3 * estimate[prefix + name]
            deviation = 2e3 * np.sqrt(estimate[f"{prefix}{name}_variance"])
            axes.plot(time, value, color=colour, linewidth=0.9, label=name)
            axes.fill_between(time, value - deviation, value + deviation, color=colour, alpha=0.2, linewidth=0.0)
        axes.set_ylabel(f"detector's {'shift' if unit == 'mm' else 'turn'} [{unit}]")
        axes.legend(loc="upper right", ncols=3, title="in its own frame, with two standard deviations")
    nis, measured = estimate["estimate_nis"], np.maximum(estimate["estimate_measured"], 1.0)
    consistency.semilogy(time, np.maximum(nis / measured, 1e-3), ".", color="0.6", markersize=2.0, label="each row")
    consistency.semilogy(time, estimate["estimate_nis_window"], color="C3", label="window")
    for tail in ((1.0 - BAND) / 2.0, (1.0 + BAND) / 2.0):
        consistency.semilogy(time, stats.chi2.ppf(tail, measured) / measured, color="k", linewidth=0.7, linestyle="--")
    alarm = estimate["estimate_alarm"] > 0.0
    consistency.fill_between(
        time, 0.0, 1.0, where=alarm, transform=consistency.get_xaxis_transform(), color="C3", alpha=0.15, label="alarm"
    )
    consistency.set_ylabel("NIS per measurement")
    consistency.set_xlabel("time [s]")
    consistency.legend(loc="upper right", ncols=3)
    return figure
