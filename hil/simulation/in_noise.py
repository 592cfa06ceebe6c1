"""Differences of a recording and its simulation in units of what repeats of one experiment do not have in common."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hil.errors import RecordingError
from hil.recording import Recording
from hil.simulation.compare import Comparison


def repeat_noise(repeats: Sequence[Recording]) -> dict[str, float]:
    """Return the noise of each channel, by which repeats of one experiment differ: its standard deviation, in the channel's unit.

    Parameters
    ----------
    repeats : sequence of Recording
        Two or more; a channel that all of them have alike has none.

    Raises
    ------
    RecordingError
        Fewer than two, or of different lengths.
    """
    if len(repeats) < 2 or len({each.rows for each in repeats}) > 1:
        rows = ", ".join(str(each.rows) for each in repeats)
        raise RecordingError(f"{len(repeats)} repeats with {rows or 'no'} rows; two or more of equal length are right")
    noise = {}
    for name in repeats[0].channels:
        if name == "time" or not all(name in each for each in repeats):
            continue
        values = np.stack([each[name] for each in repeats])
        values = values[:, np.isfinite(values).all(axis=0)]
        if values.size and (spread := float(np.sqrt(np.mean(np.var(values, axis=0, ddof=1))))) > 0.0:
            noise[name] = spread
    return noise


def in_units_of_noise(comparison: Comparison, noise: dict[str, float]) -> dict[str, float]:
    """Return the rms difference of each channel over its noise: 1 where nothing but noise is between recording and simulation."""
    return {channel.name: channel.rms / noise[channel.name] for channel in comparison.channels if channel.name in noise}
