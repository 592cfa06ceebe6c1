"""Predicted performance of a shaper in one line: residual vibration, transient, gains, sensitivity to 10 percent, omitted poles."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.signal

from controllers.shapers.delays import DelayFilter
from controllers.shapers.dynamics import Dynamics, Mode
from controllers.shapers.harmonic_time_delay import UNIT_GAIN
from controllers.shapers.sampled import sections_of
from hil.shaping.aim import Aim

VARIATION = np.linspace(-0.1, 0.1, 21)
"""Relative changes of poles and forcing frequencies for the worst case: the thesis's 10 percent."""

GAIN_LIMIT = 3.0
"""Largest sum of |A_k| of a recommended shaper; with more, the raw reference would have to stay within a third of the limits."""

LAG_s = 1e-3
"""Ramp lag that counts as zero: a quarter of a sample at 256 Hz."""

LISTED = 1e-4
"""Smallest share of a step from which omitted poles are listed."""


@dataclass(frozen=True)
class LeftOut:
    """A pole that is not cancelled, and its residual of a unit step when the transient is over."""

    frequency_Hz: float
    """Of the pole."""
    damping: float
    """Its damping ratio."""
    residual: float
    """Its share of the step."""


@dataclass(frozen=True)
class Residual:
    """Share of the vibration that a shaper leaves as simulated: least, median and greatest of drawn moves.

    1 is as much as they leave without a shaper, all together: `rms`, an acceleration in `unit`. The next move of the same kind lies between
    least and greatest with (n - 1) / (n + 1).
    """

    low: float
    """Least share left of a move."""
    likely: float
    """The median."""
    high: float
    """The greatest."""
    moves: int
    """How many were drawn."""
    rms: float
    """Of the vibration that they leave without a shaper."""
    unit: str
    """Of `rms`."""


@dataclass(frozen=True)
class Verdict:
    """Numbers of one design, the worst over the poses at which it was judged.

    Vibration and tracking error are shares: 1 is as much as without a shaper, or as the reference itself.
    """

    name: str
    """Of the design."""
    vibration: float
    """Share that is left."""
    vibration_at_10: float
    """The same with modes 10 % off, the worst."""
    tracking: float
    """Tracking error, as a share of the reference."""
    tracking_at_10: float
    """The same with modes 10 % off, the worst."""
    lag_s: float
    """By which a ramp is trailed."""
    transient_s: float
    """How long the shaper takes."""
    largest_gain: float
    """Over all frequencies."""
    gain_sum: float
    """By which a shaped reference may exceed the raw one at most: the sum of its taps without their signs."""
    static_gain: float
    """From the reference to the output at rest."""
    left_out: tuple[LeftOut, ...]
    """Poles that are not cancelled."""
    against: str
    """Why it is not recommended, or empty."""
    residual: Residual | None = None
    """As simulated; null where nothing was, as of a frequency response."""

    def simulated(self, residual: Residual) -> Verdict:
        """Return the verdict with what is left as simulated; as much as without a shaper, in the median, speaks against the design."""
        worse = f"as simulated it leaves {_percent(residual.likely)} of the vibration in the median"
        return replace(self, residual=residual, against=self.against or (worse if residual.likely >= 1.0 else ""))

    @property
    def row(self) -> dict[str, str | float]:
        """Return what a table has of it: all but the poles left out, and the residual's parts, NaN where nothing was simulated."""
        found = {name: value for name, value in vars(self).items() if name not in ("left_out", "residual")}
        names = "low", "likely", "high", "rms"
        parts = {part: float("nan") if self.residual is None else getattr(self.residual, part) for part in names}
        return found | {f"residual_{part}": value for part, value in parts.items()}

    @property
    def cost(self) -> float:
        """Return the criterion of the recommendation: vibration plus tracking error, both as shares.

        The vibration is that of simulated moves in the median, else that of the linear loop at +-10 %.
        """
        return (self.vibration_at_10 if self.residual is None else self.residual.likely) + self.tracking

    @property
    def line(self) -> str:
        """Return the verdict as a line of text."""
        parts = [
            f"vibration {_percent(self.vibration)} ({_percent(self.vibration_at_10)} at ±10 %) in the linear loop",
            *([] if self.residual is None else [f"{_percent(self.residual.low)} to {_percent(self.residual.high)} as simulated"]),
            f"transient {self.transient_s:.3f} s",
            f"largest gain {self.largest_gain:.3g} (sum {self.gain_sum:.2f})",
            f"tracking error {_percent(self.tracking)} ({_percent(self.tracking_at_10)} at ±10 %)",
            f"ramp lag {1e3 * self.lag_s:.1f} ms",
        ]
        text = f"{self.name:12s} " + ", ".join(parts)
        return text + (f"; against it: {self.against}" if self.against else "")


@dataclass(frozen=True)
class Subject:
    """One pose for judging a shaper: the path that shall track, and the modes that shall not ring, with their weights."""

    dynamics: Dynamics
    ringing: tuple[Mode, ...]


def judge(shapers: Sequence[DelayFilter], subjects: Sequence[Subject], aim: Aim, cancelled: Sequence[Sequence[complex]]) -> Verdict:
    """Return the verdict of a shaper, one filter per subject (or the same filter for all)."""
    pairs = list(zip(shapers, subjects, strict=True))
    vibration = max(vibration_left(shaper, subject.ringing) for shaper, subject in pairs)
    at_10 = max(vibration_left(shaper, subject.ringing, share) for shaper, subject in pairs for share in VARIATION)
    through = [complex(subject.dynamics.response(0.0) * shaper.response(0.0)).real for shaper, subject in pairs]
    static_gain = through[int(np.argmax(np.abs(np.array(through) - 1.0)))]
    lag = max((_lag(shaper, subject.dynamics) for shaper, subject in pairs), key=abs)
    transient = max(shaper.settled_s for shaper in shapers)
    gain_sum = max(most_demanded(shaper) for shaper in shapers)
    against = ""
    if abs(static_gain - 1.0) > UNIT_GAIN:
        against = f"H(0) = {static_gain:.4g}, no filter for a reference with a mean"
    elif transient >= aim.longest_transient_s:
        against = f"the scan has time for {aim.longest_transient_s:.3g} s"
    elif gain_sum > GAIN_LIMIT:
        against = f"gains sum to more than {GAIN_LIMIT:g}"
    elif 0.0 in aim.without_slope_rad_s and abs(lag) > LAG_s:
        against = "a ramp lags"
    return Verdict(
        shapers[0].name,
        vibration,
        at_10,
        max(tracking_error(shaper, subject.dynamics, aim) for shaper, subject in pairs),
        max(tracking_error(shaper, subject.dynamics, aim, share) for shaper, subject in pairs for share in VARIATION),
        lag,
        transient,
        max(shaper.largest_gain for shaper in shapers),
        gain_sum,
        static_gain,
        left_out(shapers[0], subjects[0].dynamics, cancelled[0]),
        against,
    )


def vibration_left(shaper: DelayFilter, modes: Sequence[Mode], share: float = 0.0) -> float:
    """Return the amplitude of all modes after the transient over that without a shaper, poles moved by a share of their frequency.

    |sum A_k exp(p (L T - d_k))| for each mode, weighted with the acceleration its mode contributes to the response to a step.
    """
    if not modes:
        return 0.0
    poles = np.array([mode.pole for mode in modes]) * (1.0 + share)
    weight = np.array([mode.step_share for mode in modes]) * np.abs(poles) ** 2
    left = np.abs(shaper.ending(poles))
    return float(np.sqrt(np.sum((weight * left) ** 2) / np.sum(weight**2)))


def most_demanded(shaper: DelayFilter) -> float:
    """Return the factor by which a shaped reference may exceed the raw one at most: sum |A_k|, with the tail's impulse response."""
    if shaper.tail is None or shaper.tail.sample_period_s is None or not np.isfinite(shaper.settled_s):
        return shaper.gain_sum
    count = 2 * int((shaper.settled_s - shaper.transient_s) / shaper.tail.sample_period_s) + 2
    impulse = scipy.signal.sosfilt(sections_of(shaper.tail), np.eye(1, count)[0])
    return float(np.abs(shaper.gains[:-1]).sum() + abs(shaper.gains[-1]) * np.abs(impulse).sum())


def tracking_error(shaper: DelayFilter, dynamics: Dynamics, aim: Aim, share: float = 0.0) -> float:
    """Return the largest |H - 1| over the forcing frequencies, moved by a share."""
    s = 1j * np.array(aim.forcing_rad_s) * (1.0 + share)
    return float(np.abs(dynamics.response(s) * shaper.response(s) - 1.0).max())


def left_out(shaper: DelayFilter, dynamics: Dynamics, cancelled: Sequence[complex]) -> tuple[LeftOut, ...]:
    """Return the poles that are not cancelled, largest residual first."""
    found = []
    for mode in dynamics.modes:
        if any(abs(mode.pole - pole) < 1e-6 * abs(pole) for pole in cancelled):
            continue
        residual = mode.step_share * float(np.abs(shaper.ending(np.array(mode.pole))))
        if residual > LISTED:
            found.append(LeftOut(mode.frequency_rad_s / (2.0 * np.pi), mode.damping, float(residual)))
    return tuple(sorted(found, key=lambda each: -each.residual))


def _lag(shaper: DelayFilter, dynamics: Dynamics) -> float:
    """Return -d(PG)/ds at 0, the lag of a ramp."""
    return -complex(dynamics.slope(0.0) * shaper.response(0.0) + dynamics.response(0.0) * shaper.slope(0.0)).real


def _percent(share: float) -> str:
    return "0 %" if share < 5e-10 else f"{100.0 * share:.3g} %"
