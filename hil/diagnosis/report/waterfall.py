"""Where the mismatch went: re-tuning, the named effects, and what is unexplained."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from hil.diagnosis.report.style import GREEN, ORANGE, SKY, VERMILION
from hil.diagnosis.result import Diagnosis, Stages


def explained_shares(stages: Stages) -> tuple[float, float, float] | None:
    """Shares of the nominal mismatch above noise that re-tuning and effects remove and that stays; None where there is none."""
    if stages.nominal is None or stages.retuned is None or stages.extended is None or stages.noise_floor is None:
        return None
    nominal, retuned, extended = (max(value**2 - stages.noise_floor**2, 0.0) for value in (stages.nominal, stages.retuned, stages.extended))
    if not nominal > 0.0 or not np.isfinite([nominal, retuned, extended]).all():
        return None
    return (nominal - retuned) / nominal, (retuned - extended) / nominal, extended / nominal


def waterfall_figure(diagnosis: Diagnosis) -> Figure | None:
    """Bars that start where the one before ended; None where nothing is above noise."""
    judged = diagnosis.fit.held_out or diagnosis.fit.train
    shares = explained_shares(judged)
    if shares is None:
        return None
    by_retuning, by_effects, unexplained = shares
    names = " and\n".join(str(finding.effect) for finding in diagnosis.findings) or "effects\n(none named)"
    bars = [
        ("nominal\nabove noise", 0.0, 1.0, ORANGE),
        ("re-tuning", 1.0 - by_retuning, by_retuning, SKY),
        (names, unexplained, by_effects, GREEN),
        ("unexplained", 0.0, unexplained, VERMILION),
    ]
    figure = Figure(figsize=(7.2, 3.8), layout="constrained")
    axes = figure.subplots()
    for place, (_, bottom, height, colour) in enumerate(bars):
        axes.bar(place, 100.0 * height, 0.62, bottom=100.0 * bottom, color=colour)
        top = 100.0 * max(bottom, bottom + height)
        axes.annotate(f"{100.0 * height:.1f} %", (place, top), (0, 3), textcoords="offset points", ha="center", fontsize="small")
    for place, level in ((0, 1.0), (1, 1.0 - by_retuning), (2, unexplained)):
        axes.plot([place + 0.31, place + 0.69], [100.0 * level] * 2, color="0.4", lw=0.8)
    axes.set_xticks(range(len(bars)), [name for name, *_ in bars], fontsize="small")
    axes.axhline(0.0, color="black", lw=0.8)
    axes.set_ylabel("share of the mismatch above noise [%]")
    axes.set_title("held-out recordings" if diagnosis.fit.held_out is not None else "training recordings", fontsize="medium")
    axes.margins(y=0.12)
    return figure
