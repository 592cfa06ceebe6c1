"""Which numbers the recordings can tell apart: cosines between the free-run sensitivities of tuned numbers and effects' parameters."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

LEGIBLE = 24
"""Numbers shown at most: those with the largest sensitivity."""

LEAST_SAID = 0.1
"""Below it a colour is enough."""


def cosines(columns: np.ndarray) -> np.ndarray:
    """(P, P) absolute cosines between the columns (M, P) of a Jacobian; 0 for a column of zeros."""
    norm = np.linalg.norm(columns, axis=0)
    unit = columns / np.where(norm > 0.0, norm, 1.0)
    return np.abs(unit.T @ unit)


def matrix_figure(columns: np.ndarray, names: Sequence[str]) -> Figure | None:
    """Draw the matrix as an image, with numbers below its diagonal; None with fewer than two numbers."""
    changed = np.flatnonzero(np.linalg.norm(columns, axis=0) > 0.0)
    if len(changed) < 2:
        return None
    order = np.sort(changed[np.argsort(-np.linalg.norm(columns[:, changed], axis=0))][:LEGIBLE])
    values = cosines(columns[:, order])
    size = 0.42 * len(order) + 2.8
    figure = Figure(figsize=(size + 0.8, size), layout="constrained")
    axes = figure.subplots()
    image = axes.imshow(values, vmin=0.0, vmax=1.0, cmap="cividis")
    labels = [names[k] for k in order]
    axes.set_xticks(range(len(order)), labels, rotation=90, fontsize="small")
    axes.set_yticks(range(len(order)), labels, fontsize="small")
    for i, j in np.argwhere(np.tril(values, -1) >= LEAST_SAID):
        colour = "white" if values[i, j] < 0.6 else "black"
        axes.text(j, i, f"{values[i, j]:.2f}", ha="center", va="center", fontsize=6, color=colour, in_layout=False)
    figure.colorbar(image, ax=axes, label="|cos| of sensitivities\n1: cannot be told apart")
    return figure
