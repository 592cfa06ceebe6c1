"""One sample of the emulated machine and one plant step in it: `python docs/figures/plant_step.py`."""

from __future__ import annotations

from pathlib import Path

import matplotlib as mpl
from matplotlib import pyplot as plt

mpl.rcParams.update({"svg.hashsalt": "isocenter", "svg.fonttype": "none", "font.family": "sans-serif", "font.size": 11})

BLUE, ORANGE, GREEN, GREY = "#0072B2", "#D55E00", "#009E73", "#666666"
STEPS, INNER = 4, 3


def main() -> None:
    """Draw the sketch beside this file."""
    fig, ax = plt.subplots(figsize=(5.6, 4.0))
    ax.plot([0.0, 4.0], [3.6, 3.6], color=BLUE, lw=3)
    ax.text(2.0, 3.75, "drive effort, constant over the sample", color=BLUE, ha="center", va="bottom")
    ax.plot([0.0, 4.0], [2.8, 2.8], color="black", lw=1.4)
    for k in range(STEPS + 1):
        ax.plot([k, k], [2.68, 2.92], color="black", lw=2.4 if k in (0, STEPS) else 1.4)
    for k in (0, STEPS):
        ax.text(k, 2.98, f"SYNC {'k' if k == 0 else 'k+1'}", ha="center", va="bottom")
    ax.text(1.5, 2.5, "plant step h", ha="center", va="top")
    for near, far in ((1.0, 0.0), (2.0, 4.0)):
        ax.plot([near, far], [2.65, 1.55], color=GREY, lw=0.9, ls="--")
    ax.plot([0.0, 4.0], [1.4, 1.4], color="black", lw=1.4)
    for k in range(INNER + 1):
        x = 4.0 * k / INNER
        ax.plot([x, x], [1.28, 1.52], color="black", lw=1.4)
    ax.plot(2.0, 1.4, "D", color=ORANGE, ms=9, zorder=5)
    ax.text(2.0, 1.62, "M and b evaluated here, then held", color=ORANGE, ha="center", va="bottom")
    for k in range(INNER):
        ax.annotate(
            "",
            xy=(4.0 * (k + 1) / INNER - 0.06, 1.05),
            xytext=(4.0 * k / INNER + 0.06, 1.05),
            arrowprops={"arrowstyle": "-|>", "color": GREEN, "lw": 1.6},
        )
    ax.text(
        2.0,
        0.9,
        "inner steps: flow of springs\nand dampers, order 8; friction,\none constant effort each",
        color=GREEN,
        ha="center",
        va="top",
    )
    for x in (0.0, 4.0):
        ax.plot(x, 1.4, "o", mfc="white", mec=BLUE, mew=1.8, ms=9, zorder=4)
        ax.text(x, 0.9, "IMU\ninput", color=BLUE, ha="center", va="top")
    ax.set(xlim=(-0.45, 4.45), ylim=(-0.15, 4.1))
    ax.axis("off")
    fig.savefig(Path(__file__).with_suffix(".svg"), metadata={"Date": None}, bbox_inches="tight", pad_inches=0.03)


if __name__ == "__main__":
    main()
