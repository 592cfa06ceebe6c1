"""Who sees what in the concealed benchmark: `python docs/figures/proof_separation.py`."""

from __future__ import annotations

from pathlib import Path

from matplotlib import pyplot as plt
from matplotlib.axes import Axes

plt.rcParams["svg.hashsalt"] = "isocenter"

BLUE, ORANGE = "#0072B2", "#D55E00"
WIDTH, HEIGHT = 2.6, 0.95


def box(ax: Axes, x: float, y: float, text: str, colour: str, width: float = WIDTH) -> None:
    """Draw a box with text around x, y."""
    ax.add_patch(plt.Rectangle((x - width / 2, y - HEIGHT / 2), width, HEIGHT, facecolor="white", edgecolor=colour, lw=1.4))
    ax.text(x, y, text, ha="center", va="center", fontsize=10)


def way(ax: Axes, start: tuple[float, float], end: tuple[float, float], colour: str) -> None:
    """Draw an arrow."""
    ax.annotate("", xy=end, xytext=start, arrowprops={"arrowstyle": "-|>", "color": colour, "lw": 1.4, "shrinkA": 0, "shrinkB": 0})


def main() -> None:
    """Draw the chart beside this file."""
    fig = plt.figure(figsize=(4.6, 4.4))
    ax = fig.add_axes((0.0, 0.0, 1.0, 1.0))
    left, right, half = 1.5, 4.6, HEIGHT / 2
    box(ax, 3.05, 5.4, "truth generator: MuJoCo, other\nequations, hidden effects, noise", ORANGE, 4.9)
    box(ax, left, 3.7, "truth and oracle's\njudgement, sealed", ORANGE)
    box(ax, right, 3.7, "recordings, nominal\nmachine file", BLUE)
    box(ax, right, 2.1, "isocenter diagnose", BLUE)
    box(ax, right, 0.5, "answer, with the\ntruth's SHA-256", BLUE)
    box(ax, left, 0.5, "scorer", "black")
    way(ax, (left, 5.4 - half), (left, 3.7 + half), ORANGE)
    way(ax, (right, 5.4 - half), (right, 3.7 + half), BLUE)
    way(ax, (right, 3.7 - half), (right, 2.1 + half), BLUE)
    way(ax, (right, 2.1 - half), (right, 0.5 + half), BLUE)
    way(ax, (right - WIDTH / 2, 0.5), (left + WIDTH / 2, 0.5), BLUE)
    way(ax, (left, 3.7 - half), (left, 0.5 + half), ORANGE)
    ax.text(left - 0.1, 2.1, "opened after\nthe answer", color=ORANGE, ha="right", va="center", fontsize=10)
    ax.set(xlim=(0.1, 6.0), ylim=(-0.05, 5.95))
    ax.axis("off")
    fig.savefig(Path(__file__).with_suffix(".svg"), metadata={"Date": None})


if __name__ == "__main__":
    main()
