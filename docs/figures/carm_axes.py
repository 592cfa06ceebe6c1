"""The C-arm's axes, bodies and elastic joints in two views: `python docs/figures/carm_axes.py`."""

from __future__ import annotations

from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib import pyplot as plt
from matplotlib.axes import Axes

mpl.rcParams.update({"svg.hashsalt": "isocenter", "svg.fonttype": "none", "font.family": "sans-serif", "font.size": 11})

BLUE, ORANGE, GREY, LIGHT = "#0072B2", "#D55E00", "#666666", "#BBBBBB"
RADIUS = 0.9  # m, of the arc: the sleeve stands so far behind the isocentre
SOURCE, DETECTOR = -0.81, 0.35  # m above the isocentre, as in carm.toml
MOUNT, ARM = 1.5, 1.0  # m, heights of the mount's and the arm's origin


def elastic(ax: Axes, x: float, z: float, number: int, dx: float, dz: float) -> None:
    """Draw an elastic joint with its number beside it."""
    ax.plot(x, z, "o", color=ORANGE, ms=8, zorder=5)
    ax.text(x + dx, z + dz, str(number), color=ORANGE, ha="center", va="center", fontweight="bold")


def turn(ax: Axes, x: float, z: float, radius: float, start: float, end: float, text: str, dx: float, dz: float) -> None:
    """Draw a driven axis seen along itself, with an arrow round it."""
    at = np.radians(np.linspace(start, end, 40))
    ax.plot(x + radius * np.cos(at[:-2]), z + radius * np.sin(at[:-2]), color=BLUE, lw=1.8)
    tip, before = ((x + radius * np.cos(a), z + radius * np.sin(a)) for a in (at[-1], at[-4]))
    ax.annotate("", xy=tip, xytext=before, arrowprops={"arrowstyle": "-|>", "color": BLUE, "lw": 1.8, "shrinkA": 0, "shrinkB": 0})
    ax.text(x + dx, z + dz, text, color=BLUE, ha="center", va="center")


def head(ax: Axes, half_width: float) -> None:
    """Draw tube and detector with the beam between them."""
    for edge in (-half_width, half_width):
        ax.plot([0.0, edge], [SOURCE, DETECTOR], color=LIGHT, lw=0.9)
    ax.add_patch(plt.Rectangle((-half_width, DETECTOR), 2 * half_width, 0.12, facecolor="white", edgecolor="black", lw=1.4, zorder=3))
    ax.add_patch(plt.Rectangle((-0.14, SOURCE - 0.12), 0.28, 0.2, facecolor="white", edgecolor="black", lw=1.4, zorder=3))
    ax.plot(0.0, 0.0, "+", color="black", ms=12, mew=1.5)


def main() -> None:
    """Draw both views beside this file."""
    fig, (side, front) = plt.subplots(1, 2, figsize=(7.0, 4.8), gridspec_kw={"width_ratios": (1.3, 1.0), "wspace": 0.02})
    angle = np.radians(np.linspace(78.0, 282.0, 80))
    side.plot(RADIUS * np.cos(angle), RADIUS * np.sin(angle), color=GREY, lw=7, solid_capstyle="butt")
    side.plot([0.0, 0.0], [DETECTOR + 0.12, 0.86], color=GREY, lw=3)
    side.plot([-1.2, -1.2, -1.0], [MOUNT, 0.0, 0.0], color="black", lw=4, solid_joinstyle="miter")
    side.plot([-1.75, -0.4], [MOUNT, MOUNT], color="black", lw=2)
    side.add_patch(plt.Rectangle((-1.0, -0.16), 0.2, 0.32, facecolor="white", edgecolor="black", lw=1.4, zorder=3))
    side.plot([-1.45, 0.55], [0.0, 0.0], color=BLUE, lw=1.0, ls="-.")
    side.text(0.58, 0.0, "propeller\n(x)", color=BLUE, va="center")
    head(side, 0.19)
    turn(side, 0.0, 0.0, 0.2, 200.0, -80.0, "roll (y)", 0.5, -0.3)
    elastic(side, -1.2, MOUNT, 1, 0.0, 0.17)
    elastic(side, -1.2, ARM, 2, -0.17, 0.0)
    elastic(side, -1.1, 0.0, 3, -0.02, -0.2)
    elastic(side, -0.9, 0.0, 4, 0.22, 0.16)
    elastic(side, 0.0, DETECTOR + 0.12, 5, 0.16, 0.12)
    side.text(0.24, DETECTOR + 0.02, "detector", va="center")
    side.text(0.2, SOURCE - 0.02, "tube", va="center")
    side.set_title("from the side", fontsize=11)
    front.plot([0.0, 0.0], [-0.86, 0.86], color=GREY, lw=7, solid_capstyle="butt", zorder=0)
    front.plot([0.0, 0.0], [0.9, MOUNT], color="black", lw=4)
    front.plot([-0.55, 0.55], [MOUNT, MOUNT], color="black", lw=2)
    front.plot([-0.62, 0.62], [0.0, 0.0], color=BLUE, lw=1.0, ls="-.")
    front.text(0.66, 0.0, "roll\n(y)", color=BLUE, va="center")
    head(front, 0.15)
    turn(front, 0.0, 0.0, 0.3, 150.0, 420.0, "propeller (x)", 0.66, -0.4)
    elastic(front, 0.0, MOUNT, 1, 0.0, 0.17)
    elastic(front, 0.0, ARM, 2, -0.17, 0.0)
    elastic(front, 0.0, DETECTOR + 0.12, 5, 0.24, 0.1)
    front.set_title("from the feet", fontsize=11)
    for ax, limits in ((side, (-1.75, 1.15)), (front, (-0.75, 1.3))):
        ax.set(xlim=limits, ylim=(-1.1, 1.85), aspect="equal")
        ax.axis("off")
    fig.savefig(Path(__file__).with_suffix(".svg"), metadata={"Date": None}, bbox_inches="tight", pad_inches=0.03)


if __name__ == "__main__":
    main()
