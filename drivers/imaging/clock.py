"""The panel's clock against the loop's, from the exposures' pulses.

A pulse is seen at the next tick of the loop, so it says that the exposure began within the period before. The line that passes all those
periods nearest to their middles is the panel's clock in loop time: frames do not divide ticks, so N exposures leave it some N-th of a
period to either side, where least squares would leave the root of that. Its rate is that of two crystals. A rate far from 1, or a line that
misses a period, means that the stamps belong to other exposures.
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import linprog

from drivers.errors import DriverError

RATE_TRUST = 100e-6
"""Two quartz clocks are within this of each other; beyond, by more than the pulses leave in doubt, one of them is no clock."""

SLACK = 0.25
"""Of a period: how far outside of its period a pulse may seem to lie, by the line's own error."""

FEWEST = 3


class ClocksDisagreeError(DriverError):
    """A panel's stamps and the loop's pulses tell different times.

    Example scenarios
    -----------------
    - The panel's clock was set during the run, or runs at another rate than it says.
    - Frames were lost without their numbers, so that stamps and pulses are of different exposures.
    """


class PanelClock:
    """Line from the panel's time to the loop's.

    Parameters
    ----------
    panel_s, pulse_s : (N,) arrays
        Starts by the panel's clock; ticks of the loop at which they were first seen.
    period_s : float
        Of the loop.
    exposure_id : (N,) array of int, optional
        What exposures are called in errors; counted from 0 without.

    Attributes
    ----------
    rate : float
        Loop seconds in a second of the panel's.
    rate_doubt : float
        Four standard deviations of a rate from so many pulses; twice `RATE_TRUST` where they say less than that.
    residual_s : float
        Root mean square of the pulses about the line; period / sqrt(12) where they agree.
    doubt_s : float
        Standard deviation of a time: so far the line could be shifted either way before a pulse lay outside of its period, over sqrt(3).

    Raises
    ------
    ClocksDisagreeError
        Too few pulses, or they do not lie on a line of this rate.
    """

    def __init__(self, panel_s: np.ndarray, pulse_s: np.ndarray, period_s: float, exposure_id: np.ndarray | None = None) -> None:
        panel, middles = np.asarray(panel_s, float), np.asarray(pulse_s, float) - 0.5 * period_s
        if len(panel) < FEWEST:
            raise ClocksDisagreeError(
                f"{len(panel)} exposures; the panel's clock needs {FEWEST} pulses at least to be known in the loop's time"
            )
        if not (np.ptp(panel) > 0.0 and np.ptp(middles) > 0.0):
            raise ClocksDisagreeError(f"{len(panel)} exposures at one time: the panel's clock or the loop's pulses stand still")
        self._origin = float(panel.mean())
        along, (doubt, by_squares) = panel - self._origin, _rate(panel - panel.mean(), middles, period_s)
        if by_squares <= 0.0:
            raise ClocksDisagreeError(
                "the panel's stamps do not grow with the loop's pulses; frames and pulses are not of the same exposures"
            )
        if abs(by_squares - 1.0) > RATE_TRUST + doubt:
            raise ClocksDisagreeError(
                f"the panel's clock runs {1e6 * (1.0 / by_squares - 1.0):+.0f} ppm against the loop's; two clocks differ by 100"
            )
        self.rate_doubt = min(doubt, 2.0 * RATE_TRUST)
        # least largest distance t: |middle - at - rate along| <= t
        ones = np.ones(len(panel))
        above, below = np.column_stack([ones, along, -ones]), np.column_stack([-ones, -along, -ones])
        bounds = [(None, None), (1.0 - RATE_TRUST, 1.0 + RATE_TRUST), (0.0, None)]
        scale = middles.mean()
        limits = np.concatenate([middles - scale, scale - middles])
        self._at, self.rate, _ = linprog([0.0, 0.0, 1.0], np.vstack([above, below]), limits, bounds=bounds).x
        self._at += scale
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

    def to_loop(self, panel_s: np.ndarray) -> np.ndarray:
        """Loop times of panel times."""
        return self._at + self.rate * (np.asarray(panel_s, float) - self._origin)


def _rate(along: np.ndarray, middles: np.ndarray, period_s: float) -> tuple[float, float]:
    """Four standard deviations of a rate by least squares through pulses spread evenly over their periods, and that rate."""
    spread = float(along @ along)
    return 4.0 * period_s / np.sqrt(12.0 * spread), float(along @ (middles - middles.mean())) / spread
