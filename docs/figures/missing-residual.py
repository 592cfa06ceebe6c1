"""What the turntable's simulation leaves out, before and after the diagnosis: `python docs/figures/missing-residual.py FOLDER`.

FOLDER is where the commands of the tutorial "Find what a simulation leaves out" were run.
"""

from __future__ import annotations

import sys
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib import pyplot as plt

from hil.recording import read_recording

mpl.rcParams.update({"svg.hashsalt": "isocenter", "svg.fonttype": "none", "font.family": "sans-serif", "font.size": 12})
BLUE, ORANGE = "#0072B2", "#D55E00"


def main(folder: Path) -> None:
    """Draw recorded less simulated position over the table's position, beside this file."""
    recorded = read_recording(folder / "held-out.mf4")
    fig, ax = plt.subplots(figsize=(6.4, 3.4), layout="constrained")
    for name, colour, style, label in (
        ("plain", ORANGE, "-", "machine file alone"),
        ("explained", BLUE, "--", "re-tuned, with the cogging"),
    ):
        simulated = read_recording(folder / f"{name}.mf4")
        difference = recorded["link_position_turn"] - simulated["link_position_turn"]
        ax.plot(recorded.time, 1e6 * difference, color=colour, ls=style, label=label)
    ax.set(xlabel="Time [s]", ylabel="Recorded less simulated\nposition [µrad]", xlim=(0.0, float(np.max(recorded.time))))
    ax.grid(alpha=0.25)
    ax.legend(loc="upper center", ncols=2, bbox_to_anchor=(0.5, 1.2), frameon=False)
    fig.savefig(Path(__file__).with_suffix(".svg"), metadata={"Date": None})


if __name__ == "__main__":
    main(Path(sys.argv[1]))
