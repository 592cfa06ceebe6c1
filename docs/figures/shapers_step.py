"""A lightly damped mode after a step, with and without shapers: `python docs/figures/shapers_step.py`."""

from __future__ import annotations

from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib import pyplot as plt

from controllers.shapers.delays import DelayFilter
from controllers.shapers.dynamics import Dynamics
from controllers.shapers.harmonic_time_delay import harmonic, harmonic_conditions
from controllers.shapers.point_to_point import zv

mpl.rcParams.update({"svg.hashsalt": "isocenter", "svg.fonttype": "none", "font.family": "sans-serif", "font.size": 11})

BLUE, ORANGE, GREY = "#0072B2", "#D55E00", "#666666"
MODE_Hz, DAMPING, DELAY_s = 8.0, 0.01, 0.035


def response(shaper: DelayFilter, frequency_Hz: float, time_s: np.ndarray) -> np.ndarray:
    """Step response of a mode behind a shaper: a sum of delayed step responses."""
    mode = 2.0 * np.pi * frequency_Hz
    damped = mode * np.sqrt(1.0 - DAMPING**2)
    moved = np.zeros_like(time_s)
    for delay, gain in zip(shaper.delays_s, shaper.gains, strict=True):
        t = np.maximum(time_s - delay, 0.0)
        swing = np.exp(-DAMPING * mode * t) * (np.cos(damped * t) + DAMPING * mode / damped * np.sin(damped * t))
        moved += gain * (1.0 - swing) * (time_s >= delay)
    return moved


def main() -> None:
    """Design, respond and draw beside this file."""
    mode = 2.0 * np.pi * MODE_Hz
    plant = Dynamics.from_polynomials(np.array([mode**2]), np.array([1.0, 2.0 * DAMPING * mode, mode**2]))
    conditions = harmonic_conditions(plant, [0.0], robust_poles=plant.poles, robust_forcing_rad_s=[0.0])
    shapers = (
        (DelayFilter(np.zeros(1), np.ones(1)), GREY, "-", 1.0, "no shaper"),
        (zv(mode, DAMPING), ORANGE, "--", 1.8, "ZV"),
        (harmonic(conditions, DELAY_s), BLUE, "-", 2.0, "hTDF robust"),
    )
    time_s = np.linspace(-0.02, 0.6, 1200)
    fig, axes = plt.subplots(2, 1, figsize=(5.4, 4.6), sharex=True, layout="constrained")
    for ax, factor, text in zip(axes, (1.0, 1.1), ("as designed", "mode 10 % faster"), strict=True):
        for shaper, colour, style, width, name in shapers:
            ax.plot(time_s, response(shaper, factor * MODE_Hz, time_s), color=colour, ls=style, lw=width, label=name)
        ax.set(ylabel="position / step", ylim=(-0.1, 2.1))
        ax.set_title(text, fontsize=11)
        ax.spines[["top", "right"]].set_visible(False)
    axes[0].legend(frameon=False, ncols=3, loc="upper right", fontsize=10, borderaxespad=0.0, handlelength=1.6)
    axes[0].set_ylim(-0.1, 2.5)
    axes[1].set(xlabel="time [s]", xlim=(-0.02, 0.6))
    fig.savefig(Path(__file__).with_suffix(".svg"), metadata={"Date": None})


if __name__ == "__main__":
    main()
