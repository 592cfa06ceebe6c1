"""Overlay errors of the calibrations on one unseen scan of two machines: `python docs/figures/calibration_comparison.py`.

Reads benchmarks/results/calibration_side_by_side.json.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from matplotlib import pyplot as plt

plt.rcParams["svg.hashsalt"] = "isocenter"

RESULTS = Path(__file__).resolve().parents[2] / "benchmarks" / "results" / "calibration_side_by_side.json"

SHOWN = {
    "nominal": "drawing alone",
    "phantom look-up": "look-up table",
    "model-based": "kinematic model",
    "quasi-static parameters alone": "filter, no observer",
    "data-driven, no image since the tour": "filter, no new image",
    "data-driven, images withdrawn after 20": "filter, 20 new images",
    "data-driven, images": "filter, 61 new images",
}
"""Rows of the result file, and what they are called in the figure."""

MACHINES = {"repeatable": ("repeats itself", "#0072B2", "o"), "not_repeatable": ("shaken, mount moved", "#D55E00", "^")}


def main() -> None:
    """Draw the figure beside this file."""
    results = json.loads(RESULTS.read_text(encoding="utf-8"))
    fig, ax = plt.subplots(figsize=(4.4, 3.3), layout="constrained")
    places = np.arange(len(SHOWN))
    for name, (label, colour, marker) in MACHINES.items():
        rows = results[name]["rows"]
        ax.plot([rows[row]["overlay_mm"]["centre"]["mean"] for row in SHOWN], places, marker, color=colour, ms=8, label=label)
    ax.set_yticks(places, list(SHOWN.values()))
    ax.invert_yaxis()
    ax.set(xscale="log", xlim=(1e-3, 10.0), xlabel="mean overlay error [mm]")
    ax.grid(axis="x", color="#dddddd")
    ax.set_axisbelow(True)
    fig.legend(loc="outside upper center", ncols=2, frameon=False)
    fig.savefig(Path(__file__).with_suffix(".svg"), metadata={"Date": None})


if __name__ == "__main__":
    main()
