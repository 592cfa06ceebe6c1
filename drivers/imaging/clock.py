"""The panel's clock in loop time, from the exposures' pulses.

A pulse is seen at the next tick of the loop, so the exposure began within the period before it. The line with the smallest largest distance
from the middles of these periods is the panel's clock in loop time. The frame period is no multiple of the loop's, so N exposures leave an
error of about 1/N of a period, where least squares would leave 1/sqrt(N). The line's rate is the ratio of two quartz clocks. A rate far
from 1, or a line that misses a period, means that the time stamps belong to other exposures.
"""

from __future__ import annotations

import numpy as np

from drivers.errors import DriverError

RATE_TRUST = 100e-6
"""Largest relative difference of two quartz clocks; a larger one, beyond the uncertainty of the pulses, is refused."""

SLACK = 0.25
"""Share of a period by which a pulse may appear to lie outside of its period because of the line's own error."""

FEWEST = 3

SETTLED_s = 1e-12


class ClocksDisagreeError(DriverError):
    """A panel's time stamps and the loop's pulses do not agree.

    Example scenarios
    -----------------
    - The panel's clock was set during the run, or runs at another rate than stated.
    - Frames were lost without their numbers, so that stamps and pulses belong to different exposures.
    """


class PanelClock:
    """The line from the panel's time to the loop's.

    Parameters
    ----------
    panel_s, pulse_s : (N,) arrays
        Starts by the panel's clock; ticks of the loop at which they were first seen.
    period_s : float
        Period of the loop.
    exposure_id : (N,) array of int, optional
        Numbers of the exposures in error messages; without it they are counted from 0.
    fewest : int
        Pulses that it takes. Fewer than `FEWEST` do not check the rate, and one pulse alone tells its exposure's time to half a period,
        with a rate of 1: for who will not wait for more.

    Attributes
    ----------
    rate : float
        Loop seconds per second of the panel.
    rate_doubt : float
        Four standard deviations of a rate from this number of pulses, at most twice `RATE_TRUST`.
    residual_s : float
        Root mean square of the pulses about the line; period / sqrt(12) where they agree.
    doubt_s : float
        Standard deviation of a time: the shift of the line that would put a pulse outside of its period, over sqrt(3).

    Raises
    ------
    ClocksDisagreeError
        There are too few pulses, or they do not lie on a line with a rate near 1.
    """

    def __init__(
        self, panel_s: np.ndarray, pulse_s: np.ndarray, period_s: float, exposure_id: np.ndarray | None = None, fewest: int = FEWEST
    ) -> None:
        panel, middles = np.asarray(panel_s, float), np.asarray(pulse_s, float) - 0.5 * period_s
        if len(panel) < fewest:
            raise ClocksDisagreeError(
                f"{len(panel)} exposures; the panel's clock needs {fewest} pulses at least to be known in the loop's time"
            )
        self._origin, self.rate_doubt = float(panel.mean()), 2.0 * RATE_TRUST
        if len(panel) >= FEWEST:
            self._check_rate(panel - self._origin, middles, period_s)
        self._at, self.rate = _narrowest(panel - self._origin, middles) if np.ptp(panel) > 0.0 else (float(np.median(middles)), 1.0)
        error = middles - self.to_loop(panel)
        self.residual_s = float(np.sqrt(np.mean(error**2)))
        worst = int(np.argmax(np.abs(error)))
        if abs(error[worst]) > (0.5 + SLACK) * period_s:
            called = worst if exposure_id is None else int(exposure_id[worst])
            raise ClocksDisagreeError(
                f"exposure {called} began {1e3 * error[worst]:+.1f} ms off the panel's clock, a tick is {1e3 * period_s:.1f} ms;"
                " the panel's clock was set meanwhile, or frames and pulses are not of the same exposures"
            )

        self.doubt_s = max(0.0, 0.5 * period_s - abs(float(error[worst]))) / np.sqrt(3.0)

    def _check_rate(self, along: np.ndarray, middles: np.ndarray, period_s: float) -> None:
        if not (np.ptp(along) > 0.0 and np.ptp(middles) > 0.0):
            raise ClocksDisagreeError(f"{len(along)} exposures at one time: the panel's clock or the loop's pulses stand still")
        doubt, by_squares = _rate(along, middles, period_s)
        if by_squares <= 0.0:
            raise ClocksDisagreeError(
                "the panel's stamps do not grow with the loop's pulses; frames and pulses are not of the same exposures"
            )
        if abs(by_squares - 1.0) > RATE_TRUST + doubt:
            raise ClocksDisagreeError(
                f"the panel's clock runs {1e6 * (1.0 / by_squares - 1.0):+.0f} ppm against the loop's; two clocks differ by 100"
            )
        self.rate_doubt = min(doubt, self.rate_doubt)

    def to_loop(self, panel_s: np.ndarray) -> np.ndarray:
        """Return loop times of panel times."""
        loop_s: np.ndarray = self._at + self.rate * (np.asarray(panel_s, float) - self._origin)
        return loop_s


def _narrowest(along: np.ndarray, middles: np.ndarray) -> tuple[float, float]:
    """Return value at 0 and rate of the line with the smallest largest distance from the points, its rate within `RATE_TRUST` of 1.

    The width that holds all points is convex and piecewise linear in the rate. The tangents at both ends of an interval cross below its
    least value, and that is where it is asked for next (Kelley 1960): a few passes over the points.
    """

    def width(rate: float) -> tuple[float, float]:
        rest = middles - rate * along
        top, bottom = int(np.argmax(rest)), int(np.argmin(rest))
        return float(rest[top] - rest[bottom]), float(along[bottom] - along[top])

    low, high = 1.0 - RATE_TRUST, 1.0 + RATE_TRUST
    (at_low, falls), (at_high, rises) = width(low), width(high)
    rate = low if falls >= 0.0 else high
    while falls < 0.0 < rises:
        rate = (at_high - rises * high - at_low + falls * low) / (falls - rises)
        here, slope = width(rate)
        if here - at_low - falls * (rate - low) < SETTLED_s or slope == 0.0:
            break
        if slope < 0.0:
            low, at_low, falls = rate, here, slope
        else:
            high, at_high, rises = rate, here, slope
    rest = middles - rate * along
    return 0.5 * float(rest.max() + rest.min()), rate


def _rate(along: np.ndarray, middles: np.ndarray, period_s: float) -> tuple[float, float]:
    """Return four standard deviations of a least-squares rate, for pulses spread evenly over their periods, and that rate."""
    spread = float(along @ along)
    return 4.0 * period_s / np.sqrt(12.0 * spread), float(along @ (middles - middles.mean())) / spread
