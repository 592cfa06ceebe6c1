"""Ticks of a run that are missing in its recording, because the loop skipped them or their rows were lost; time shows which."""

from __future__ import annotations

import numpy as np

from hil.recording.recording import CAN_FRAMES, Channel, Recording
from hil.recording.steps import LOST, is_even, is_on_raster, usual_step

PLANNED = ("reference_", "excitation_", "feedforward_", "damping_")
"""Channels that drive a simulation. Damping was not planned, but is an input of the simulation as well."""


def gap_words(recording: Recording) -> str:
    """Return one line on the missing ticks of a run, or the missing rows of another recording; '' where none is missing."""
    if "bench" not in recording.metadata:
        return _lost_words(recording.time) if recording.metadata.get("kind") != CAN_FRAMES else ""
    steps = np.diff(recording.ticks)
    gaps = np.flatnonzero(steps > 1)
    if not gaps.size:
        return ""
    row = int(gaps[0])
    ticks = int((steps - 1).sum())
    missing = f"{ticks} tick{' is' if ticks == 1 else 's are'} missing in {gaps.size} place{'' if gaps.size == 1 else 's'}"
    return f"{missing}, first after row {row} ({recording.time[row]:.6g} s): the drives held their command there"


def _lost_words(time_s: np.ndarray) -> str:
    """Return one line on the gaps in rows that else come at one rate, or at whole multiples of its step."""
    steps, step = np.diff(time_s), usual_step(time_s)
    gaps = np.flatnonzero(steps > LOST * step)
    if not gaps.size or not (is_even(time_s) or (is_on_raster(time_s) and not _is_pattern(gaps, steps.size))):
        return ""
    row, rows = int(gaps[0]), int(np.rint(steps[gaps] / step).sum()) - gaps.size
    places = f"{gaps.size} place{'' if gaps.size == 1 else 's'}, first {steps[row]:.6g} s after row {row} ({time_s[row]:.6g} s)"
    return f"about {rows} row{'' if rows == 1 else 's'} of {step:.6g} s missing in {places}: lost, or the clock was set on there"


def _is_pattern(gaps: np.ndarray, steps: int) -> bool:
    """Return whether gaps come behind every so many rows throughout, as of a logger that writes several at once."""
    apart = np.diff(gaps)
    return bool(apart.size and np.ptp(apart) == 0 and gaps.size * apart[0] > steps - 2 * apart[0])


def on_every_tick(recording: Recording) -> Recording:
    """Return a recording with a row for every tick: planned channels are filled in, measured ones are missing.

    The excitation is that of the same tick in another period, where there is one; reference, feedforward and damping are smooth and
    are interpolated.
    """
    ticks = recording.ticks
    rows = int(ticks[-1]) + 1
    if rows == recording.rows:
        return recording
    channels = {}
    for name, channel in recording.channels.items():
        values = np.full(rows, np.nan)
        values[ticks] = channel.values
        if name == "time":
            values = recording.time[0] + np.arange(rows) / recording.sample_rate_Hz
            values[ticks] = channel.values
        elif name.startswith(PLANNED):
            values = planned(recording, name, ticks, channel.values, rows)
        channels[name] = Channel(channel.unit, values)
    return Recording(channels, recording.metadata)


def planned(recording: Recording, name: str, ticks: np.ndarray, values: np.ndarray, rows: int) -> np.ndarray:
    """Return a planned channel (rows,) on every tick from its values (N,) at some; NaN stays NaN."""
    every, whole = np.arange(rows), np.full(rows, np.nan)
    whole[ticks] = values
    missing = np.isnan(whole)
    missing[ticks] = False
    period = recording.experiment.get("period_samples")
    if name.startswith("excitation_") and isinstance(period, int) and 0 < period < rows:
        whole[missing] = _elsewhere(whole, missing, period)[every[missing] % period]
        missing &= np.isnan(whole)
    whole[missing] = np.interp(every[missing], ticks, values)
    return whole


def _elsewhere(values: np.ndarray, missing: np.ndarray, period: int) -> np.ndarray:
    """Return the first available value (period,) at each tick of the period; NaN where it is missing in all periods."""
    found = np.full(period, np.nan)
    for start in range(0, len(values), period):
        part = values[start : start + period]
        use = np.isnan(found[: len(part)]) & ~missing[start : start + period]
        found[: len(part)][use] = part[use]
    return found
