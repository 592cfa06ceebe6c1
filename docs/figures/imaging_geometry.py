"""The geometry of one exposure, as a sketch: `python docs/figures/imaging_geometry.py`."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib import pyplot as plt
from matplotlib.axes import Axes

plt.rcParams["svg.hashsalt"] = "isocenter"

BLUE, ORANGE, GREEN, GREY = "#0072B2", "#D55E00", "#009E73", "#666666"


def arrow(ax: Axes, start: np.ndarray, end: np.ndarray, colour: str, width: float = 1.6) -> None:
    """Draw an arrow from start to end."""
    ax.annotate(
        "", xy=tuple(end), xytext=tuple(start), arrowprops={"arrowstyle": "-|>", "color": colour, "lw": width, "shrinkA": 0, "shrinkB": 0}
    )


def main() -> None:
    """Draw the sketch beside this file."""
    fig = plt.figure(figsize=(4.4, 4.6))
    ax = fig.add_axes((0.0, 0.0, 1.0, 1.0))
    panel, source, phantom = np.array([0.0, 0.0]), np.array([-0.35, 5.0]), np.array([0.5, 2.0])
    for edge in (-2.3, 2.3):
        ax.plot([source[0], edge], [source[1], 0.0], color=GREY, lw=0.8, ls="--")
    ax.plot([-2.3, 2.3], [0.0, 0.0], color="#bbbbbb", lw=7, solid_capstyle="butt")
    ax.plot([-1.15, 0.45], [3.85, 3.85], color=GREY, lw=3, solid_capstyle="butt")
    ax.add_patch(plt.Circle(tuple(phantom), 0.62, fill=False, color=GREEN, lw=1.4))
    turn = np.radians(24.0)
    for direction in (np.array([np.cos(turn), np.sin(turn)]), np.array([-np.sin(turn), np.cos(turn)])):
        arrow(ax, phantom, phantom + 0.55 * direction, GREEN, 1.2)
    ax.plot(*source, "o", color=ORANGE, ms=8)
    arrow(ax, panel, source, ORANGE)
    arrow(ax, panel, phantom, BLUE)
    arrow(ax, panel, np.array([1.3, 0.0]), "black")
    arrow(ax, panel, np.array([0.0, -1.0]), "black")
    ax.plot(*panel, "o", color="white", mec="black", ms=9, zorder=5)
    ax.plot(*panel, "o", color="black", ms=3, zorder=6)
    said = (
        (0.75, -0.35, "$u$ (columns)", "black", "left"),
        (0.12, -1.0, "$w$ (panel's normal)", "black", "left"),
        (-0.15, -0.62, "$v$ (rows)", "black", "right"),
        (-2.3, -0.3, "detector", GREY, "left"),
        (-0.6, 5.0, "focal spot", ORANGE, "right"),
        (0.6, 3.77, "marker plate\non the tube", GREY, "left"),
        (1.6, 2.3, "phantom, turned\nby $R_d^{ph}$", GREEN, "left"),
        (-0.42, 2.6, r"$\nu_s^d$", ORANGE, "right"),
        (0.42, 0.95, r"$\nu_{ph}^d$", BLUE, "left"),
    )
    for x, y, text, colour, side in said:
        ax.text(x, y, text, color=colour, ha=side, va="center", fontsize=11)
    ax.set(xlim=(-2.45, 3.3), ylim=(-1.25, 5.3), aspect="equal")
    ax.axis("off")
    fig.savefig(Path(__file__).with_suffix(".svg"), metadata={"Date": None})


if __name__ == "__main__":
    main()
