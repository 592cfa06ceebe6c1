"""The steps of a diagnosis as a flow chart: `python docs/figures/diagnosis_steps.py`."""

from __future__ import annotations

from pathlib import Path

from matplotlib import pyplot as plt
from matplotlib.axes import Axes

plt.rcParams["svg.hashsalt"] = "isocenter"

STEPS = (
    "machine file, recordings",
    "audit: are recordings and\ncontrollers what they say?",
    "see: motion, missing effort,\nnoise from repeats",
    "re-tune the file's numbers,\nfit friction as an engineer",
    "score every known law\nat every place",
    "fit the best ones with\nthe file's numbers",
    "do stretches left out agree?",
    "weigh rivals in place\nof each finding",
    "verdict, numbers, location",
)
BLUE, ORANGE = "#0072B2", "#D55E00"
LEFT, WIDTH, HEIGHT, PITCH = 0.9, 3.7, 0.74, 1.0


def box(ax: Axes, x: float, y: float, width: float, text: str, colour: str) -> None:
    """Draw a box with text, its upper left corner at x, y."""
    ax.add_patch(plt.Rectangle((x, y - HEIGHT), width, HEIGHT, facecolor="white", edgecolor=colour, lw=1.4))
    ax.text(x + width / 2, y - HEIGHT / 2, text, ha="center", va="center", fontsize=10)


def way(ax: Axes, points: list[tuple[float, float]], colour: str) -> None:
    """Draw a line through points that ends in an arrow."""
    ax.plot(*zip(*points[:-1], strict=True), color=colour, lw=1.4)
    ax.annotate(
        "", xy=points[-1], xytext=points[-2], arrowprops={"arrowstyle": "-|>", "color": colour, "lw": 1.4, "shrinkA": 0, "shrinkB": 0}
    )


def main() -> None:
    """Draw the flow chart beside this file."""
    fig = plt.figure(figsize=(4.6, 6.2))
    ax = fig.add_axes((0.0, 0.0, 1.0, 1.0))
    tops = [-PITCH * k for k in range(len(STEPS))]
    middle = LEFT + WIDTH / 2
    for k, (text, top) in enumerate(zip(STEPS, tops, strict=True)):
        box(ax, LEFT, top, WIDTH, text, "black")
        if k:
            way(ax, [(middle, tops[k - 1] - HEIGHT), (middle, top)], "black")
    half = HEIGHT / 2
    right = LEFT + WIDTH
    way(ax, [(LEFT, tops[6] - half), (0.5, tops[6] - half), (0.5, tops[4] - half), (LEFT, tops[4] - half)], ORANGE)
    ax.text(0.2, tops[5] - half, "one more effect, three at most", color=ORANGE, rotation=90, ha="center", va="center", fontsize=10)
    held = right + 0.7
    ax.text(held, tops[5] - half + 0.15, "held-out\nrecordings", color=BLUE, ha="center", va="bottom", fontsize=10)
    ax.plot([held, held], [tops[5] - half + 0.1, tops[8] - half], color=BLUE, lw=1.4)
    for k in (8,):
        way(ax, [(held, tops[k] - half), (right, tops[k] - half)], BLUE)
    again = right + 1.45
    way(ax, [(right, tops[8] - half), (again, tops[8] - half), (again, tops[0] - half), (right, tops[0] - half)], ORANGE)
    ax.text(
        again + 0.25, tops[4] - half, "ambiguous: run the next experiment", color=ORANGE, rotation=90, ha="center", va="center", fontsize=10
    )
    ax.set(xlim=(0.0, again + 0.45), ylim=(tops[-1] - HEIGHT - 0.05, 0.05))
    ax.axis("off")
    fig.savefig(Path(__file__).with_suffix(".svg"), metadata={"Date": None})


if __name__ == "__main__":
    main()
