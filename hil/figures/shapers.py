"""Figures of reference shapers: their taps, their frequency responses, and the map of delays they were chosen from."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from controllers.errors import DesignError
from controllers.shapers.harmonic_time_delay import harmonic_conditions
from hil.shaping.aim import Aim
from hil.shaping.in_time import SETTLED, InTime
from hil.shaping.shaper_design import Design, delay_map
from hil.shaping.verdict import Subject

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#E69F00", "#56B4E9", "#CC79A7")
"""Okabe and Ito's palette: distinguishable for colour-blind readers and in grey."""

SHOWN_s = 4.0
"""Longest time drawn: beyond it a lightly damped mode only grows fainter."""

SHOWN = 5
"""Designs drawn: more lines than this cannot be told apart."""


def design_figure(
    designs: Sequence[Design],
    subjects: Sequence[Subject],
    aim: Aim,
    sample_rate_Hz: float,
    in_time: Mapping[str, InTime] | None = None,
    title: str = "",
) -> Figure:
    """Draw taps, |G| and |H| over frequency at the first pose, and the map of delays of the harmonic filter, as Figs 7.4 and 7.12.

    Parameters
    ----------
    in_time : responses to a step by name of the design, "none" without a shaper; drawn below where given.
    """
    figure = Figure(figsize=(11.0, 10.5 if in_time else 7.5), layout="constrained")
    panels = figure.subplots(3 if in_time else 2, 2)
    taps, passes, tracks, gains = panels[:2].reshape(-1)
    frequencies = np.geomspace(0.05, sample_rate_Hz / 4.0, 2000)
    s = 2j * np.pi * frequencies
    plant = subjects[0].dynamics.response(s)
    tracks.loglog(frequencies, np.abs(plant), color="black", linewidth=1.0, label="no shaper")
    for design, colour in zip([each for each in designs if each.name != "none"][:SHOWN], COLOURS, strict=False):
        shaper, first = design.filters[0], design is designs[0]
        name = f"{design.name} (recommended)" if first else design.name
        taps.plot(shaper.delays_s, shaper.gains, "o-", color=colour, markersize=3, linewidth=1.6 if first else 0.7, label=name)
        through = np.abs(shaper.response(s))
        passes.loglog(frequencies, through, color=colour, linewidth=1.6 if first else 0.8, label=name)
        tracks.loglog(frequencies, np.abs(plant) * through, color=colour, linewidth=1.6 if first else 0.8, label=name)
    for mode in subjects[0].ringing:
        passes.axvline(mode.frequency_rad_s / (2.0 * np.pi), color="grey", linewidth=0.5, linestyle=":")
    for axes, text in ((passes, "|G|"), (tracks, "|H| = |P G|")):
        axes.set(xlabel="Frequency [Hz]", ylabel=text, ylim=(1e-4, 10.0))
        axes.grid(alpha=0.3, linewidth=0.5)
    taps.set(xlabel="Delay [s]", ylabel="Gain")
    taps.grid(alpha=0.3, linewidth=0.5)
    taps.legend(fontsize="small")
    _draw_map(gains, designs, subjects, aim, sample_rate_Hz)
    for axes, text in ((taps, "taps"), (passes, "shaper"), (tracks, "closed loop behind it"), (gains, "map of delays")):
        axes.set_title(text, fontsize="medium")
    if in_time:
        _draw_in_time(panels[2, 0], panels[2, 1], in_time)
    if title:
        figure.suptitle(title)
    return figure


def _draw_in_time(step: Axes, ringing: Axes, in_time: Mapping[str, InTime]) -> None:
    """Draw what the loop does after a step, and how its lightly damped modes ring, without a shaper and with the one that is written."""
    ends = [each.settled_s(SETTLED * in_time["none"].left) for each in in_time.values()]
    shown_s = min(max(1.2 * max(end for end in ends if np.isfinite(end)), 1.0), SHOWN_s) if np.isfinite(ends).any() else SHOWN_s
    for (name, each), colour, style in zip(in_time.items(), ("black", COLOURS[0]), ("--", "-"), strict=False):
        first = each.time_s <= shown_s
        label = "without shaper" if name == "none" else name
        step.plot(each.time_s[first], each.output[first], style, color=colour, linewidth=1.0, label=label)
        ringing.plot(each.time_s[first], 100.0 * each.ringing[first], style, color=colour, linewidth=1.0, label=label)
    step.set(xlabel="Time after a step of the reference [s]", ylabel="Output / step")
    ringing.set(xlabel="Time after a step of the reference [s]", ylabel="Ringing modes [% of the step]")
    step.set_title("before and after: output", fontsize="medium")
    ringing.set_title("before and after: ringing", fontsize="medium")
    for axes in (step, ringing):
        axes.grid(alpha=0.3, linewidth=0.5)
        axes.legend(fontsize="small")


def _draw_map(axes: Axes, designs: Sequence[Design], subjects: Sequence[Subject], aim: Aim, sample_rate_Hz: float) -> None:
    """Draw the sum of |A_k| and vibration at 10 percent over T, the chosen delay marked."""
    cancelled = designs[0].cancelled
    for robust, name, colour in ((False, "hTDF", COLOURS[0]), (True, "hTDF robust", COLOURS[1])):
        try:
            conditions = [
                harmonic_conditions(
                    each.dynamics,
                    aim.forcing_rad_s,
                    poles,
                    robust_poles=poles if robust else (),
                    robust_forcing_rad_s=aim.without_slope_rad_s,
                )
                for each, poles in zip(subjects, cancelled, strict=True)
            ]
        except DesignError:
            continue
        rows = delay_map(conditions, subjects, 1.0 / sample_rate_Hz, aim.longest_transient_s)
        if not rows:
            continue
        delays = [row.delay_s for row in rows]
        axes.semilogy(delays, [row.gain_sum for row in rows], ".-", color=colour, linewidth=0.8, label=f"{name}: sum of |A|")
        axes.semilogy(delays, [row.vibration_at_10 for row in rows], ":", color=colour, label=f"{name}: vibration at ±10 %")
        chosen = next((design for design in designs if design.name == name), None)
        if chosen is not None:
            axes.axvline(chosen.filters[0].delays_s[1], color=colour, linewidth=0.6)
    axes.set(xlabel="Delay T [s]")
    axes.grid(alpha=0.3, linewidth=0.5)
    axes.legend(fontsize="small")
