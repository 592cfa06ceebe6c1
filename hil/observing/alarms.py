"""Where and why an observer's estimates may be worse than stated: its alarms in words, and poses outside those of its design."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import signal

from hil.observing.estimate import Estimate
from hil.recording import Recording

APART_s = 0.5
"""Alarms nearer to each other than this are told as one: the shortest window is half as long."""

OFFSET_SHARE = 0.7
"""Share of a channel's mean square innovation that its mean makes, from which the reading is off rather than shaken."""

PEAKED = 0.3
"""Share of an innovation's power near one frequency, from which it swings at that frequency."""

NEAR_Hz = 1.0
"""Half width of what is near, or two lines of the alarm's spectrum."""

SLOW_Hz = 2.5
"""Frequency below which no mode of such a structure swings: what is off there is off with the motion."""

QUIET_SHARE = 0.25
"""Share of rows without an alarm from which they say what is usual of a channel; with fewer, the design's noise does."""

OUTSIDE_rad = 0.02
"""How far beyond the design's poses, in rad or m, an axis may stand: the jog of its experiments."""


@dataclass(frozen=True)
class Alarm:
    """A time in which sensors surprise more than a sound machine's, or move the estimate by more than its variances allow."""

    from_s: float
    """Its begin, in the recording's time."""
    to_s: float
    """Its end."""
    rows: int
    """Rows with an alarm."""
    channel: str
    """Whose innovations exceed the usual most."""
    times: float
    """By how much they do."""
    unit: str
    """Of the channel."""
    kind: str
    """`offset`, `swing` or `noise`."""
    offset: float
    """Mean innovation, measured less predicted, in `unit`."""
    frequency_Hz: float
    """At which it swings; no number unless `kind` is `swing`."""
    low: np.ndarray
    """(n_axes,) range of the measured positions meanwhile, its lower ends [rad or m]."""
    high: np.ndarray
    """Its upper ends."""
    outside: tuple[str, ...]
    """Axes that were outside the design's poses meanwhile."""

    @property
    def reason(self) -> str:
        """Return what it looks like, in words."""
        if self.kind == "offset":
            seen = (
                f"reads {self.offset:+.2g} {self.unit} beside what the model predicts: an offset, or a force that the model does not have"
            )
        elif self.kind == "swing" and self.frequency_Hz < SLOW_Hz:
            seen = f"is off with the motion, at {self.frequency_Hz:.3g} Hz: inertia, friction or a load that the model does not have"
        elif self.kind == "swing":
            seen = f"swings at {self.frequency_Hz:.3g} Hz beside the model: a mode that it lacks or has elsewhere"
        else:
            seen = "scatters more than the design's noise: a disturbed sensor, or shocks"
        return f"{self.channel} {seen} ({self.times:.2g} times the usual)"


def alarms(estimate: Estimate, recording: Recording, noise: np.ndarray, poses: np.ndarray) -> tuple[Alarm, ...]:
    """Return every alarm of an estimate with its place and its likeliest reason, in order of time.

    Parameters
    ----------
    estimate : Estimate
    recording : Recording
        Of the same rows.
    noise : (measurements,) array
        Standard deviation of each measured channel in the design.
    poses : (P, n_axes) array
        At which the design was measured [rad or m]; empty where it does not say.
    """
    flagged = estimate["estimate_alarm"] > 0.0
    if not flagged.any():
        return ()
    size = np.abs(estimate.innovation)
    quiet = ~flagged & np.isfinite(estimate["estimate_nis_window"])
    usual = np.asarray(noise, float).copy()
    if quiet.mean() >= QUIET_SHARE:
        seen = np.sqrt(np.nanmean(np.where(np.isfinite(size[quiet]), size[quiet], np.nan) ** 2, axis=0, where=np.isfinite(size[quiet])))
        usual = np.where(np.isfinite(seen) & (seen > 0.0), seen, usual)
    time_s = estimate.time_s
    positions = _positions(recording)
    found = []
    for first, last in _spans(flagged, time_s):
        rows = slice(first, last + 1)
        power = np.array(
            [np.mean(part**2) if (part := column[np.isfinite(column)]).size else 0.0 for column in estimate.innovation[rows].T]
        )
        worst = int(np.argmax(power / usual**2))
        low, high = np.nanmin(positions[rows], axis=0), np.nanmax(positions[rows], axis=0)
        name = estimate.measured_names[worst]
        kind, offset, frequency_Hz = _likeness(estimate.innovation[rows, worst], 1.0 / float(np.median(np.diff(time_s))))
        found.append(
            Alarm(
                float(time_s[first]),
                float(time_s[last]),
                int(flagged[rows].sum()),
                name,
                float(np.sqrt(power[worst]) / usual[worst]),
                recording.channel(name).unit,
                kind,
                offset,
                frequency_Hz,
                low,
                high,
                outside(low, high, poses, recording.axes),
            )
        )
    return tuple(found)


def outside(low: np.ndarray, high: np.ndarray, poses: np.ndarray, axes: Sequence[str]) -> tuple[str, ...]:
    """Return the axes whose positions from `low` to `high` (n_axes,) leave the range of a design's poses (P, n_axes)."""
    if not poses.size:
        return ()
    left = (low < poses.min(axis=0) - OUTSIDE_rad) | (high > poses.max(axis=0) + OUTSIDE_rad)
    return tuple(axis for axis, is_out in zip(axes, left, strict=True) if is_out)


def outside_lines(recording: Recording, poses: np.ndarray) -> list[str]:
    """Return a warning per axis that was outside the design's poses: where, for how long, and where the design was measured."""
    if not poses.size:
        return []
    lines = []
    positions = _positions(recording)
    for number, axis in enumerate(recording.axes):
        at = positions[:, number]
        low, high = poses[:, number].min(), poses[:, number].max()
        out = (at < low - OUTSIDE_rad) | (at > high + OUTSIDE_rad)
        if out.any():
            unit, scale = _shown(recording, axis)
            lines.append(
                f"warning: {axis} is outside the design's poses in {out.mean():.0%} of rows: it goes from {scale * np.nanmin(at):.4g} to"
                f" {scale * np.nanmax(at):.4g} {unit}, the design was measured from {scale * low:.4g} to {scale * high:.4g} {unit};"
                " the model is a guess there"
            )
    return lines


def alarm_lines(found: Sequence[Alarm], recording: Recording, most: int = 8) -> list[str]:
    """Return alarms in words, the longest `most` of them."""
    told = sorted(sorted(found, key=lambda alarm: -alarm.rows)[:most], key=lambda alarm: alarm.from_s)
    lines = []
    for alarm in told:
        places = []
        for axis, low, high in zip(recording.axes, alarm.low, alarm.high, strict=True):
            unit, scale = _shown(recording, axis)
            low, high = scale * low, scale * high
            at = f"{0.5 * (low + high):.1f}" if high - low < 0.5 else f"{low:.1f} to {high:.1f}"
            places.append(f"{axis} {at} {unit}")
        where = f"{alarm.from_s:.2f} to {alarm.to_s:.2f} s at {', '.join(places)}"
        out = f"; {', '.join(alarm.outside)} is outside the design's poses" if alarm.outside else ""
        lines.append(f"alarm {where}: {alarm.reason}{out}")
    if len(found) > len(told):
        lines.append(f"and {len(found) - len(told)} shorter alarms")
    return lines


def _positions(recording: Recording) -> np.ndarray:
    return recording.matrix([f"position_{axis}" for axis in recording.axes])


def _shown(recording: Recording, axis: str) -> tuple[str, float]:
    """Return the unit in which people read a position, and its factor."""
    return ("deg", 180.0 / np.pi) if recording.channel(f"position_{axis}").unit == "rad" else ("mm", 1e3)


def _spans(flagged: np.ndarray, time_s: np.ndarray) -> list[tuple[int, int]]:
    """Return first and last row of each alarm, near ones together."""
    rows = np.flatnonzero(flagged)
    breaks = np.flatnonzero(np.diff(time_s[rows]) > APART_s)
    firsts, lasts = np.concatenate(([0], breaks + 1)), np.concatenate((breaks, [len(rows) - 1]))
    return [(int(rows[a]), int(rows[b])) for a, b in zip(firsts, lasts, strict=True)]


def _likeness(innovation: np.ndarray, rate_Hz: float) -> tuple[str, float, float]:
    """Return what an innovation (N,) looks like, its mean, and the frequency at which it swings."""
    known = innovation[np.isfinite(innovation)]
    mean = float(known.mean())
    if mean**2 > OFFSET_SHARE * float(np.mean(known**2)):
        return "offset", mean, float("nan")
    if len(known) >= 32:
        at_Hz, power = signal.periodogram(known - mean, rate_Hz, window="hann")
        top = int(np.argmax(power))
        near = np.abs(at_Hz - at_Hz[top]) <= max(NEAR_Hz, 2.0 * at_Hz[1])
        if power[near].sum() > PEAKED * power.sum() and at_Hz[top] > 2.0 * at_Hz[1]:
            return "swing", mean, float(at_Hz[top])
    return "noise", mean, float("nan")
