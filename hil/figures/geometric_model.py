"""Figure of a model-based calibration: measured poses less the nominal geometry and less the model (thesis Fig. 2.8)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from hil.figures.geometry import COLOURS
from hil.imaging.geometry import DEVIATIONS


def residual_figure(names: Sequence[str], nominal: Sequence[np.ndarray], model: Sequence[np.ndarray], held_out: Sequence[bool]) -> Figure:
    """Draw nine panels over the exposures of all scans, one after the other.

    Parameters
    ----------
    names : sequence of str
        Of the scans.
    nominal, model : sequences of (n, 9) arrays
        Phantom-calibrated pose less the nominal one, and less the model's [m, rad].
    held_out : sequence of bool
        Scans the model was not fitted to; shaded.
    """
    figure = Figure(figsize=(11.0, 7.5), layout="constrained")
    panels = figure.subplots(3, 3, sharex=True)
    ends = np.cumsum([0, *(len(each) for each in nominal)])
    for k, panel in enumerate(panels.flat):
        spreads: list[str] = []
        for colour, label, parts in zip(COLOURS, ("less nominal", "less model"), (nominal, model), strict=False):
            values = 1e3 * np.concatenate(parts)[:, k]
            spreads.append(f"{np.std(values):.3f}")
            panel.plot(values, color=colour, linewidth=1.0, label=label)
        for begin, end, held in zip(ends[:-1], ends[1:], held_out, strict=True):
            panel.axvline(begin, color="0.7", linewidth=0.6)
            if held:
                panel.axvspan(begin, end, color="0.92", zorder=0)
        panel.set_title(f"{DEVIATIONS[k].replace('_', ' ')}   {' to '.join(spreads)}", fontsize=10)
        panel.set_ylabel("mm" if k < 6 else "mrad")
        panel.grid(alpha=0.3)
    for panel in panels[-1]:
        panel.set_xlabel("exposure")
    panels[0, 0].legend(fontsize=8, loc="lower left")
    scans = ", ".join(f"{name} (held out)" if held else name for name, held in zip(names, held_out, strict=True))
    figure.suptitle(f"Phantom-calibrated pose less nominal, less model; above: standard deviations of both\n{scans}", fontsize=10)
    return figure
