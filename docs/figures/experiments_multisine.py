"""The lines of a multisine under jog, and its signals over time: `python docs/figures/experiments_multisine.py`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib import pyplot as plt

from hil.experiments import Multisine
from hil.machine import load_machine

mpl.rcParams.update({"svg.hashsalt": "isocenter", "svg.fonttype": "none", "font.family": "sans-serif", "font.size": 11})

BLUE, ORANGE, GREEN, PINK = "#0072B2", "#D55E00", "#009E73", "#CC79A7"
SHOWN_Hz = 1.53


def main() -> None:
    """Draw lines above and signals below, beside this file."""
    machine = load_machine("carm")
    settings = Multisine()
    plan = replace(settings, lines=replace(settings.lines, one_free_in=3), periods=1, amplitude_A=0.8).plans(machine)[0]
    excited = np.array(plan.metadata["excited_lines"])
    jog_line = plan.metadata["jog"]["line"]
    step_Hz = machine.sample_rate_Hz / plan.metadata["period_samples"]
    every = np.arange(1, int(SHOWN_Hz / step_Hz) + 1)
    free = np.setdiff1d(every[every > excited[0]], excited)
    fig, (top, middle, bottom) = plt.subplots(
        3, 1, figsize=(5.6, 5.4), gridspec_kw={"height_ratios": (1.5, 1.0, 1.0)}, layout="constrained"
    )
    for lines, height, colour, marker, text in (
        (np.array([jog_line]), 1.0, ORANGE, "D", "jog (reference)"),
        (excited[excited * step_Hz < SHOWN_Hz], 0.8, BLUE, "o", "excited"),
        (free[free % 2 == 1], 0.4, GREEN, "s", "free, odd: detects odd distortion"),
        (free[free % 2 == 0], 0.25, PINK, "^", "free, even: detects even distortion"),
    ):
        top.vlines(lines * step_Hz, 0.0, height, color=colour, lw=1.6)
        top.plot(lines * step_Hz, np.full(len(lines), height), marker, color=colour, ms=6, ls="none", label=text)
    top.set(xlim=(0.0, SHOWN_Hz + 0.02), ylim=(0.0, 1.95), yticks=[], xlabel="frequency [Hz]")
    top.legend(loc="upper right", ncols=2, frameon=False, fontsize=9.5, handletextpad=0.2, columnspacing=0.8, borderaxespad=0.1)
    time = np.arange(plan.rows) / machine.sample_rate_Hz
    axis = machine.axis_index("roll")
    middle.plot(time, np.degrees(plan.reference[:, axis]), color=ORANGE, lw=1.6)
    middle.set(ylabel="reference\n[deg]", xticklabels=[], yticks=(-2, 0, 2), ylim=(-2.6, 2.6))
    bottom.plot(time, plan.excitation[:, axis], color=BLUE, lw=0.4)
    bottom.set(ylabel="excitation\n[A]", xlabel="time [s]", yticks=(-2, 0, 2))
    for ax in (middle, bottom):
        ax.axvline(20.0, color="black", lw=1.0, ls="--")
        ax.set_xlim(0.0, 40.0)
    middle.text(10.0, -2.3, "settles", ha="center")
    middle.text(30.0, -2.3, "kept", ha="center")
    for ax in (top, middle, bottom):
        ax.spines[["top", "right"]].set_visible(False)
    fig.savefig(Path(__file__).with_suffix(".svg"), metadata={"Date": None})


if __name__ == "__main__":
    main()
