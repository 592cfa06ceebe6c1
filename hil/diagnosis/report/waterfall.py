"""Where the mismatch went: re-tuning, the named effects, and what is unexplained."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from hil.diagnosis.report.style import GREEN, ORANGE, SKY, VERMILION
from hil.diagnosis.result import EffectAt, Fit, Stages


def left_above_noise(stages: Stages) -> list[float] | None:
    """Return what is left of the nominal mismatch above noise after re-tuning and with the effects; None where nothing is above noise."""
    misfits = (stages.nominal, stages.retuned, stages.extended)
    known = [value for value in misfits if value is not None]
    if stages.noise_floor is None or len(known) < len(misfits) or not np.isfinite(known).all():
        return None
    nominal, *left = (max(value**2 - stages.noise_floor**2, 0.0) for value in known)
    return [value / nominal for value in left] if nominal > 0.0 else None


def waterfall_figure(fit: Fit, effects: Sequence[EffectAt] = ()) -> Figure | None:
    """Bars that start where the one before ended, `effects` one of them; None where nothing is above noise."""
    left = left_above_noise(fit.held_out or fit.train)
    if left is None:
        return None
    levels = [1.0, *left]
    names = [" and\n".join(str(effect).replace(" at ", "\nat ") for effect in effects) or "effects\n(none simulated)"]
    bars = [("nominal\nabove noise", 0.0, 1.0, ORANGE)]
    for name, before, after in zip(("re-tuning", *names), levels[:-1], levels[1:], strict=True):
        bars.append((name, after, before - after, SKY if name == "re-tuning" else GREEN))
    bars.append(("unexplained", 0.0, levels[-1], VERMILION))
    figure = Figure(figsize=(max(7.2, 1.6 * len(bars)), 3.8), layout="constrained")
    axes = figure.subplots()
    for place, (_, bottom, height, colour) in enumerate(bars):
        axes.bar(place, 100.0 * height, 0.62, bottom=100.0 * bottom, color=colour)
        top = 100.0 * max(bottom, bottom + height)
        axes.annotate(f"{100.0 * height:.1f} %", (place, top), (0, 3), textcoords="offset points", ha="center", fontsize="small")
    for place, level in enumerate(levels):
        axes.plot([place + 0.31, place + 0.69], [100.0 * level] * 2, color="0.4", lw=0.8)
    axes.set_xticks(range(len(bars)), [name for name, *_ in bars], fontsize="small")
    axes.axhline(0.0, color="black", lw=0.8)
    axes.set_ylabel("share of the mismatch above noise [%]")
    axes.set_title("held-out recordings" if fit.held_out is not None else "training recordings", fontsize="medium")
    axes.margins(y=0.12)
    return figure
