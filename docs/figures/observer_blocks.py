"""The observer beside the machine as a block diagram: `python docs/figures/observer_blocks.py`."""

from __future__ import annotations

from pathlib import Path

import matplotlib as mpl
from matplotlib import pyplot as plt
from matplotlib.axes import Axes

mpl.rcParams.update({"svg.hashsalt": "isocenter", "svg.fonttype": "none", "font.family": "sans-serif", "font.size": 11})

BLUE, ORANGE, GREEN = "#0072B2", "#D55E00", "#009E73"


def box(ax: Axes, x: float, y: float, width: float, height: float, text: str, colour: str = "black") -> None:
    """Draw a box with text, its lower left corner at x, y."""
    ax.add_patch(plt.Rectangle((x, y), width, height, facecolor="white", edgecolor=colour, lw=1.5))
    ax.text(x + width / 2, y + height / 2, text, ha="center", va="center", fontsize=10)


def way(ax: Axes, points: list[tuple[float, float]], colour: str = "black", style: str = "-") -> None:
    """Draw a line through points that ends in an arrow."""
    ax.plot(*zip(*points, strict=True), color=colour, lw=1.5, ls=style)
    ax.annotate(
        "",
        xy=points[-1],
        xytext=points[-2],
        arrowprops={"arrowstyle": "-|>", "color": colour, "lw": 1.5, "shrinkA": 0, "shrinkB": 0, "ls": "-"},
    )


def main() -> None:
    """Draw the diagram beside this file."""
    fig, ax = plt.subplots(figsize=(6.6, 4.6))
    box(ax, 1.3, 4.0, 4.0, 0.9, "machine")
    box(ax, 1.3, 1.85, 4.0, 1.4, "predict axes, modes,\ndisturbances,\nsensor biases", BLUE)
    box(ax, 6.3, 2.0, 2.0, 1.1, "update", BLUE)
    box(ax, 1.3, 0.1, 4.0, 0.9, "modal model", BLUE)
    way(ax, [(-1.3, 4.45), (1.3, 4.45)])
    ax.text(-1.3, 4.55, "command", ha="left", va="bottom")
    way(ax, [(1.0, 4.45), (1.0, 2.55), (1.3, 2.55)])
    ax.plot(1.0, 4.45, "o", color="black", ms=4)
    way(ax, [(5.3, 4.45), (7.0, 4.45), (7.0, 3.1)])
    ax.text(5.4, 4.55, "encoders,\nIMU", ha="left", va="bottom")
    way(ax, [(5.3, 2.55), (6.3, 2.55)], BLUE)
    ax.text(5.75, 2.65, r"$\hat z$", ha="center", va="bottom", color=BLUE)
    way(ax, [(8.3, 2.55), (10.2, 2.55)], GREEN)
    ax.text(8.5, 2.4, "detector's pose\nand speed, with\ndeviations; NIS", ha="left", va="top", color=GREEN)
    way(ax, [(7.3, 2.0), (7.3, 0.55), (5.3, 0.55)], BLUE)
    ax.text(7.4, 0.65, "pose,\nspeeds", ha="left", va="bottom", color=BLUE)
    way(ax, [(3.3, 1.0), (3.3, 1.85)], BLUE)
    ax.text(3.45, 1.42, "scheduled", ha="left", va="center", color=BLUE)
    way(ax, [(7.9, 3.1), (7.9, 5.6), (0.85, 5.6), (0.85, 4.5)], ORANGE, "--")
    ax.text(4.4, 5.68, "active damping (optional)", ha="center", va="bottom", color=ORANGE)
    ax.set(xlim=(-1.4, 11.0), ylim=(0.0, 6.2))
    ax.axis("off")
    fig.savefig(Path(__file__).with_suffix(".svg"), metadata={"Date": None}, bbox_inches="tight", pad_inches=0.03)


if __name__ == "__main__":
    main()
