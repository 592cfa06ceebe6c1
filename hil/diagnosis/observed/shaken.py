"""What recordings shake: a resonance beyond that may hide, whatever a verdict says."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from hil.recording import Recording

SHARE = 0.99
"""Of the power of what was commanded: what lies beyond shakes no mode enough to be seen beside the noise."""

DRIVEN = ("reference_", "excitation_", "feedforward_")
MEASURED_EFFORT = ("command_", "current_", "effort_")


def shaken_up_to_Hz(recordings: Mapping[str, Recording]) -> float:
    """Return the frequency [Hz] below which 99 % of the power of every commanded acceleration and effort lies; 0 where nothing moves.

    A reference counts by its second difference. Where neither reference nor excitation is recorded, commands and efforts count.
    """
    highest = 0.0
    for recording in recordings.values():
        names = [name for name in recording.channels if name.startswith(DRIVEN)]
        names = names or [name for name in recording.channels if name.startswith(MEASURED_EFFORT)]
        step_s = float(np.median(np.diff(recording.time))) if recording.rows > 1 else 1.0
        for name in names:
            values = recording[name]
            values = values[np.isfinite(values)]
            driven = np.diff(values, 2) if name.startswith("reference_") else values - values.mean() if len(values) else values
            if len(driven) < 4 or np.abs(driven).max() <= 1e-9 * np.abs(values).max(initial=0.0):
                continue
            power = np.cumsum(np.abs(np.fft.rfft(driven * np.hanning(len(driven)))) ** 2)
            highest = max(highest, int(np.searchsorted(power, SHARE * power[-1])) / (len(driven) * step_s))
    return highest


def what_may_hide(recordings: Mapping[str, Recording]) -> str:
    """Return in words what may be there and cannot show."""
    up_to_Hz = shaken_up_to_Hz(recordings)
    if not up_to_Hz:
        return "these recordings shake nothing: any resonance may hide, until a multisine is recorded"
    return (
        f"these recordings shake the machine up to {up_to_Hz:.2g} Hz: a resonance above may hide, until a multisine beyond it is recorded"
    )
