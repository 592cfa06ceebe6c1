"""The focal spot over time, and its spectrum."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from hil.calibration.marker.focal_spot import SpotTrack
from hil.figures.geometry import COLOURS


def spot_figure(track: SpotTrack, anode_Hz: float | None, title: str) -> Figure:
    """Draw displacement along columns and rows [um] over time [s], and amplitudes over frequency [Hz] with the anode's alias."""
    figure = Figure(figsize=(9.0, 6.0), layout="constrained")
    above, below = figure.subplots(2, 1)
    frequencies, amplitudes = track.spectrum()
    for k, name in enumerate(("along columns", "along rows")):
        above.plot(track.time_s, 1e6 * track.spot_m[:, k], color=COLOURS[k], linewidth=1.0, label=name)
        below.plot(frequencies, 1e6 * amplitudes[:, k], color=COLOURS[k], linewidth=1.0, label=name)
    half = 2e6 * float(np.median(track.sigma_m))
    above.axhspan(-half, half, color="#777777", alpha=0.2, linewidth=0, label="two standard deviations of one exposure")
    above.set_xlabel("time [s]")
    above.set_ylabel("displacement [um]")
    below.set_xlabel("frequency among the frames [Hz]")
    below.set_ylabel("amplitude [um]")
    if anode_Hz is not None:
        below.axvline(track.line(anode_Hz)[0], color=COLOURS[2], linestyle="--", linewidth=1.0, label=f"alias of {anode_Hz:g} Hz")
    for panel in (above, below):
        panel.grid(alpha=0.3)
        panel.legend(fontsize=8)
    figure.suptitle(title)
    return figure
