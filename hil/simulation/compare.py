"""Comparison of a recording with its simulation, channel by channel."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from hil.errors import RecordingError
from hil.files.frames import data_frame
from hil.recording import Recording

if TYPE_CHECKING:
    import pandas as pd

STANDSTILL = 1e-12
"""A channel that varies by less than this share of its largest value counts as constant: the rest is rounding."""

INPUTS = ("time", "reference_", "excitation_", "feedforward_", "damping_")
LARGEST_LAG = 5
"""Rows on either side within which a lag is searched: enough for an error of one row in timing, too few for the phase of a wrong model."""

LAG_GAIN = 0.02
"""A lag is reported when it lowers the rms difference by more than this share."""


@dataclass(frozen=True)
class ChannelComparison:
    """Comparison of one channel. rms, largest and noise are in `unit`."""

    name: str
    unit: str
    rms: float  # of simulation minus recording
    largest: float  # |simulation - recording|
    nrmse: float  # rms over the rms of the recording about its mean; NaN for a recording that does not move
    lag_rows: int  # delay of the recording behind the simulation, where it explains the difference better; 0 otherwise
    rows: int  # rows compared: both have a value


@dataclass(frozen=True)
class Comparison:
    """The differences between a recording and a simulation."""

    channels: tuple[ChannelComparison, ...]
    only_recorded: tuple[str, ...]
    only_simulated: tuple[str, ...]

    def __getitem__(self, name: str) -> ChannelComparison:
        """Return the comparison of a channel."""
        for channel in self.channels:
            if channel.name == name:
                return channel
        raise KeyError(name)

    def document(self) -> dict[str, Any]:
        """Return plain values for JSON; an NRMSE that does not exist is None."""
        channels: dict[str, Mapping[str, Any]] = {}
        for channel in self.channels:
            table = asdict(channel)
            table["nrmse"] = channel.nrmse if np.isfinite(channel.nrmse) else None
            channels[table.pop("name")] = table
        return {"channels": channels, "only_recorded": list(self.only_recorded), "only_simulated": list(self.only_simulated)}

    def frame(self) -> pd.DataFrame:
        """Return one row per channel with the fields of `ChannelComparison`; UnusableInputError without pandas, an extra."""
        fields = [asdict(channel) for channel in self.channels]
        columns = {name: [each[name] for each in fields] for name in fields[0] if name != "name"}
        return data_frame(columns, index=[channel.name for channel in self.channels], index_name="channel")

    def table(self) -> str:
        """Return the comparison as lines of text."""
        width = max(len(channel.name) for channel in self.channels)
        lines = [f"{'channel':<{width}}  {'rms':>10}  {'largest':>10}  {'unit':<6}  {'NRMSE':>8}  lag"]
        for channel in self.channels:
            nrmse = f"{channel.nrmse:8.2%}" if np.isfinite(channel.nrmse) else "     n/a"
            lag = f"{channel.lag_rows:+d} row{'' if abs(channel.lag_rows) == 1 else 's'}" if channel.lag_rows else ""
            lines.append(
                f"{channel.name:<{width}}  {channel.rms:10.4g}  {channel.largest:10.4g}  {channel.unit:<6}  {nrmse}  {lag}".rstrip()
            )
        if self.only_recorded:
            lines.append("only recorded: " + ", ".join(self.only_recorded))
        return "\n".join(lines)


def compare(recording: Recording, simulation: Recording) -> Comparison:
    """Compare a recording with its simulation, row by row.

    Parameters
    ----------
    recording, simulation : Recording
        Of the same rows.

    Raises
    ------
    RecordingError
        Numbers of rows, times or units differ, or no channel is common to both.
    """
    if recording.rows != simulation.rows:
        raise RecordingError(f"{recording.rows} rows recorded, {simulation.rows} simulated; compare a simulation of this recording")
    period = np.median(np.diff(recording.time)) if recording.rows > 1 else np.inf
    shift = float(np.abs((recording.time - recording.time[0]) - (simulation.time - simulation.time[0])).max())
    if shift > 0.5 * period:
        raise RecordingError(f"times differ by up to {shift:.4g} s; compare a simulation of this recording")
    common = [name for name in simulation.channels if name in recording and not name.startswith(INPUTS)]
    common = [name for name in common if _rows_of_both(name, recording, simulation).any()]  # a channel may stay empty, as work times do
    if not common:
        raise RecordingError("no channel in common besides the inputs; compare a recording with its simulation")
    return Comparison(
        channels=tuple(_compare_channel(name, recording, simulation) for name in common),
        only_recorded=tuple(name for name in recording.channels if name not in simulation),
        only_simulated=tuple(name for name in simulation.channels if name not in recording),
    )


def _rows_of_both(name: str, recording: Recording, simulation: Recording) -> np.ndarray:
    """Return the rows (N,) bool in which both have a value."""
    both: np.ndarray = np.isfinite(recording[name]) & np.isfinite(simulation[name])
    return both


def _compare_channel(name: str, recording: Recording, simulation: Recording) -> ChannelComparison:
    recorded, simulated = recording.channel(name), simulation.channel(name)
    if recorded.unit != simulated.unit:
        raise RecordingError(f"{name}: recorded in [{recorded.unit}], simulated in [{simulated.unit}]; units must agree")
    y, s = recorded.values, simulated.values
    both = _rows_of_both(name, recording, simulation)
    difference = s[both] - y[both]
    rms = _rms(difference)
    spread = _rms(y[both] - y[both].mean())
    moves = spread > STANDSTILL * np.abs(y[both]).max()
    return ChannelComparison(
        name=name,
        unit=recorded.unit,
        rms=rms,
        largest=float(np.abs(difference).max()),
        nrmse=rms / spread if moves else float("nan"),
        lag_rows=_lag(y, s),
        rows=int(both.sum()),
    )


def _lag(y: np.ndarray, s: np.ndarray) -> int:
    """Return the shift of the simulation, in rows, that best matches the recording; 0 unless it is clearly better than no shift."""
    if len(y) <= 4 * LARGEST_LAG:
        return 0
    middle = slice(LARGEST_LAG, len(y) - LARGEST_LAG)
    errors = {}
    for lag in range(-LARGEST_LAG, LARGEST_LAG + 1):
        difference = s[LARGEST_LAG - lag : len(s) - LARGEST_LAG - lag] - y[middle]
        errors[lag] = _rms(difference[np.isfinite(difference)])
    best = min(errors, key=lambda lag: (errors[lag], abs(lag)))
    return best if errors[best] < (1.0 - LAG_GAIN) * errors[0] else 0


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2))) if values.size else float("nan")
