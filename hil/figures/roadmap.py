"""Figure of overlay errors (thesis Table 2.3): every calibration's at three places of the image."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import Locator, LogLocator, MaxNLocator, NullFormatter, StrMethodFormatter

from hil.calibration.use.roadmap import PLACES, Overlay
from hil.figures.geometry import COLOURS

MANY_TIMES, FEW_TIMES = 50.0, 5.0
"""Where errors differ by more, numbers of powers of ten alone have room on the axis; where by less, 1, 2 and 5 may come once."""


def roadmap_figure(overlays: Mapping[str, Overlay], title: str) -> Figure:
    """Draw the share of the poses below an overlay error, by place and calibration."""
    figure = Figure(figsize=(10.0, 3.8), layout="constrained")
    panels = figure.subplots(1, len(PLACES), sharey=True)
    for k, (panel, place) in enumerate(zip(panels, PLACES, strict=True)):
        for colour, (name, result) in zip(COLOURS, overlays.items(), strict=False):
            errors = 1e3 * np.sort(result.errors_m[k])
            panel.step(errors, np.arange(1, len(errors) + 1) / len(errors), where="post", color=colour, label=name)
        panel.axhline(0.9, color="0.6", linewidth=0.8, linestyle="--")
        panel.set_xscale("log")
        low, high = panel.get_xlim()
        panel.xaxis.set_major_locator(_places(high / low))
        panel.xaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
        panel.xaxis.set_minor_formatter(NullFormatter())
        panel.set_title(place if place == "centre" else f"{place} of the way to the border", fontsize=10)
        panel.set_xlabel("overlay error on the panel [mm]")
        panel.grid(alpha=0.3, which="both")
    panels[0].set_ylabel("share of poses below")
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=len(overlays), fontsize=8)
    figure.suptitle(title, fontsize=10)
    return figure


def _places(times: float) -> Locator:
    """Return tick places on a logarithmic axis whose ends are so many times apart."""
    if times < FEW_TIMES:
        return MaxNLocator(4)
    return LogLocator(subs=(1.0,) if times > MANY_TIMES else (1.0, 2.0, 5.0))
