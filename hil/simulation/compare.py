"""Comparison of a recording with its simulation, channel by channel."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from hil.errors import RecordingError
from hil.files.frames import data_frame
from hil.recording import Recording
from hil.simulation.noise import Noise, channel_noise, noise_source

if TYPE_CHECKING:
    import pandas as pd

STANDSTILL = 1e-12
"""A channel that varies by less than this share of its largest value counts as constant: the rest is rounding."""

HOMED_BY = "link_position_"
"""Channels whose mean difference is left out beside a motor encoder: homing sets its zero by the link encoder and the windup that the file
says, so that their mean distance says nothing of the machine."""

INPUTS = ("time", "reference_", "excitation_", "feedforward_", "damping_")
LARGEST_LAG = 5
"""Rows on either side within which a lag is searched: enough for an error of one row in timing, too few for the phase of a wrong model."""

LAG_GAIN = 0.02
"""A lag is reported when it lowers the rms difference by more than this share."""


AGREES = 2.0
"""Difference in units of the noise up to which a simulation agrees: an error as large as the noise itself makes it 1.41, and noise that is
assumed is known no better than to a half."""

WIDTH = 100
"""Columns of the table."""

STILL = 1.5
"""Multiple of its noise up to which what a channel does counts as standing still: a motion as large as the noise makes it 1.41."""


@dataclass(frozen=True)
class ChannelComparison:
    """Comparison of one channel."""

    name: str = field(metadata={"json": False})
    unit: str
    """Of rms, largest and noise."""
    rms: float
    """Root mean square of simulation minus recording."""
    largest: float
    """Largest difference."""
    noise: float
    """Standard deviation of the recording's noise in one row."""
    in_noise: float
    """rms over noise."""
    still: bool
    """Whether the recording does no more than its noise."""
    nrmse: float
    """rms over the rms of the recording about its mean; null for a channel that is still."""
    lag_rows: int
    """By how many rows the recording is later, where that explains a difference beyond noise better; 0 otherwise."""
    rows: int
    """Rows compared: both have a value."""

    @property
    def agrees(self) -> bool:
        """Whether the difference is no more than noise."""
        return self.in_noise <= AGREES

    @property
    def nrmse_text(self) -> str:
        """Return the NRMSE in words."""
        return "still" if self.still else f"{self.nrmse:.2%}"


@dataclass(frozen=True)
class Comparison:
    """The differences between a recording and a simulation."""

    channels: tuple[ChannelComparison, ...]
    only_recorded: tuple[str, ...]
    only_simulated: tuple[str, ...]
    noise: Noise

    def __getitem__(self, name: str) -> ChannelComparison:
        """Return the comparison of a channel."""
        for channel in self.channels:
            if channel.name == name:
                return channel
        raise KeyError(name)

    @property
    def agrees(self) -> bool:
        """Whether no channel differs by more than its noise."""
        return all(channel.agrees for channel in self.channels)

    @property
    def verdict(self) -> str:
        """Return the answer in a sentence."""
        count = len(self.channels)
        channels = f"{count} channel{'s' if count > 1 else ''}"
        if not any(channel.rms for channel in self.channels):
            return f"The simulation equals the recording in every value of {channels}."
        worst = max(self.channels, key=lambda channel: channel.in_noise)
        if self.agrees:
            return (
                f"The simulation agrees with the recording: none of {channels} differs by more than twice its noise"
                f" (at most {worst.in_noise:.2g} times, in {worst.name})."
            )
        differ = [channel for channel in self.channels if not channel.agrees]
        moved = "it stands still" if worst.still else f"{worst.nrmse:.2%} of its motion"
        late = f", which is {_rows_late(worst.lag_rows)}" if worst.lag_rows else ""
        return (
            f"The simulation differs from the recording in {len(differ)} of {channels}: most in {worst.name}{late},"
            f" by {worst.rms:.3g} {worst.unit} rms, {_times(worst.in_noise).removesuffix(' x')} times its noise ({moved})."
        )

    def document(self) -> dict[str, Any]:
        """Return plain values for JSON; an NRMSE that does not exist is None."""
        channels: dict[str, Mapping[str, Any]] = {}
        for channel in self.channels:
            table = asdict(channel)
            table["nrmse"] = channel.nrmse if np.isfinite(channel.nrmse) else None
            channels[table.pop("name")] = table
        return {
            "verdict": self.verdict,
            "agrees": self.agrees,
            "noise": self.noise.source,
            "channels": channels,
            "only_recorded": list(self.only_recorded),
            "only_simulated": list(self.only_simulated),
        }

    def frame(self) -> pd.DataFrame:
        """Return one row per channel with the fields of `ChannelComparison`; UnusableInputError without pandas, an extra."""
        fields = [asdict(channel) for channel in self.channels]
        columns = {name: [each[name] for each in fields] for name in fields[0] if name != "name"}
        return data_frame(columns, index=[channel.name for channel in self.channels], index_name="channel")

    def table(self) -> str:
        """Return the comparison as lines of text: the channels that differ most, in units of their noise, first."""
        width = max(len("channel"), *(len(channel.name) for channel in self.channels))
        lines = [f"{'channel':<{width}}  {'rms':>10}  {'largest':>10}  {'unit':<6}  {'noise':>10}  {'rms/noise':>9}  {'NRMSE':>8}  lag"]
        for channel in sorted(self.channels, key=lambda each: -each.in_noise):
            lag = f"{channel.lag_rows:+d} row{'' if abs(channel.lag_rows) == 1 else 's'}" if channel.lag_rows else ""
            lines.append(
                f"{channel.name:<{width}}  {channel.rms:10.4g}  {channel.largest:10.4g}  {channel.unit:<6}  {channel.noise:10.3g}"
                f"  {_times(channel.in_noise):>9}  {channel.nrmse_text:>8}  {lag}".rstrip()
            )
        lines.append(f"noise: {self.noise.said}")
        if self.only_recorded:
            lines += textwrap.wrap("only recorded: " + ", ".join(self.only_recorded), WIDTH, subsequent_indent="  ")
        return "\n".join(lines)


def compare(recording: Recording, simulation: Recording, repeats: Sequence[Recording] = ()) -> Comparison:
    """Compare a recording with its simulation, row by row.

    A link encoder's mean difference is left out where its axis has a motor encoder, whose zero homing set by it.

    Parameters
    ----------
    recording, simulation : Recording
        Of the same rows.
    repeats : sequence of Recording
        Of the same experiment, which show the noise; without any it is from the recording's periods, or assumed.

    Raises
    ------
    RecordingError
        Numbers of rows, times or units differ, no channel is common to both, or a repeat is of another experiment.
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
    noise = noise_source(recording, repeats)
    return Comparison(
        channels=tuple(_compare_channel(name, recording, simulation, noise, repeats) for name in common),
        only_recorded=tuple(name for name in recording.channels if name not in simulation),
        only_simulated=tuple(name for name in simulation.channels if name not in recording),
        noise=noise,
    )


def _rows_of_both(name: str, recording: Recording, simulation: Recording) -> np.ndarray:
    """Return the rows (N,) bool in which both have a value."""
    both: np.ndarray = np.isfinite(recording[name]) & np.isfinite(simulation[name])
    return both


def _compare_channel(
    name: str, recording: Recording, simulation: Recording, noise: Noise, repeats: Sequence[Recording]
) -> ChannelComparison:
    recorded, simulated = recording.channel(name), simulation.channel(name)
    if recorded.unit != simulated.unit:
        raise RecordingError(f"{name}: recorded in [{recorded.unit}], simulated in [{simulated.unit}]; units must agree")
    y, s = recorded.values, simulated.values
    both = _rows_of_both(name, recording, simulation)
    difference = s[both] - y[both]
    if name.startswith(HOMED_BY) and name.removeprefix("link_") in recording:
        difference = difference - difference.mean()
    rms = _rms(difference)
    spread = _rms(y[both] - y[both].mean())
    sigma = channel_noise(name, recording, s, noise, repeats)
    still = spread <= max(STANDSTILL * np.abs(y[both]).max(), STILL * sigma)
    return ChannelComparison(
        name=name,
        unit=recorded.unit,
        rms=rms,
        largest=float(np.abs(difference).max()),
        noise=sigma,
        in_noise=rms / sigma,
        still=still,
        nrmse=float("nan") if still else rms / spread,
        lag_rows=0 if still or rms <= AGREES * sigma else _lag(y, s),
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


def _times(in_noise: float) -> str:
    """Return a multiple of the noise; beyond a thousand only its size says something."""
    return f"{in_noise:.3g} x" if in_noise < 1000.0 else f"{in_noise:.0e} x".replace("e+0", "e")


def _rows_late(rows: int) -> str:
    return f"{abs(rows)} row{'s' if abs(rows) > 1 else ''} {'later' if rows > 0 else 'earlier'}"
