"""Detection and naming over detectability, drawn."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib
import numpy as np

from concealed.intervals import clopper_pearson

matplotlib.use("Agg")
import matplotlib.pyplot as plt

COLOURS = {"detected": "#0072B2", "named": "#D55E00"}
LABELS = {"detected": "detected, over its distance from nothing", "named": "named, over its distance from the nearest other name"}


def draw_curves(curve: list[dict[str, Any]], path: Path) -> None:
    """Shares with 95 % intervals per bin of distance."""
    figure, axis = plt.subplots(figsize=(6.4, 4.0), layout="constrained")
    for shift, key in ((-0.12, "detected"), (0.12, "named")):
        rows = [(i, *row[key]) for i, row in enumerate(curve) if row[key][1]]
        x = np.array([row[0] for row in rows]) + shift
        share = np.array([hits / n for _, hits, n in rows])
        spread = np.array([clopper_pearson(hits, n) for _, hits, n in rows]).reshape(-1, 2)
        errors = np.abs(np.column_stack([share - spread[:, 0], spread[:, 1] - share])).T
        axis.errorbar(x, share, errors, fmt="o-", color=COLOURS[key], label=LABELS[key], capsize=3)
    labels = [f"{row['from']:g}–{row['to']:g}" if row["to"] is not None else f"> {row['from']:g}" for row in curve]
    axis.set_xticks(range(len(curve)), labels, rotation=30)
    axis.set(xlabel="distance [standard deviations of the noise]", ylabel="share of single effects [–]", ylim=(-0.03, 1.03))
    figure.legend(loc="outside upper center")
    axis.grid(alpha=0.3)
    figure.savefig(path)
    plt.close(figure)
