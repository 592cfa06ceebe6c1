"""Jog mode: a slow sinusoidal reference that keeps the machine out of stick-slip while it is excited.

Thesis Sec. 3.3 with the correction of Chapter 3: a base period of 20 s has the 0.05 Hz jog on line 1, where the thesis's 10 s hold half a
jog and fake noise at 0.1 Hz.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from controllers.errors import DesignError
from controllers.excitation_lines import GRID_TOLERANCE

FADE_SHARE = 0.25
"""Share of the first period over which the jog grows from standstill: short enough to settle within that period."""


def jog_line(frequency_Hz: float, period_samples: int, sample_rate_Hz: float) -> int:
    """Return the line of a jog frequency.

    Raises
    ------
    DesignError
        The frequency is off the grid; names the nearest one on it.
    """
    position = frequency_Hz * period_samples / sample_rate_Hz
    if not math.isfinite(position):
        raise DesignError(f"jog at {frequency_Hz} Hz: must be a number")
    top = (period_samples + 1) // 2 - 1
    nearest = min(max(round(position), 1), top)
    if abs(position - nearest) > GRID_TOLERANCE:
        spacing_Hz = sample_rate_Hz / period_samples
        raise DesignError(
            f"jog at {frequency_Hz:.10g} Hz is off the grid of {spacing_Hz:.6g} Hz: a period of {period_samples / sample_rate_Hz:g} s "
            f"holds {position:.6g} jogs; the nearest frequency on it is {nearest * spacing_Hz:.10g} Hz"
        )
    return nearest


def jog(amplitude: float, line: int, period_samples: int, settle_periods: int, periods: int, turn_share: float = 1.0) -> np.ndarray:
    """Return a motion of `amplitude` about zero, there and back over all periods, ((settle_periods + periods) N,).

    The turn at each end takes `turn_share` of the way and has the speed of a cosine; between turns the speed is constant. With 1, the
    default, that is a sine. With settling periods it grows from standstill in the first of them.

    Raises
    ------
    DesignError
        A line outside 1 to below N/2, or a share outside 0 to 1.
    """
    if not 0.0 < turn_share <= 1.0:
        raise DesignError(f"jog: turn_share = {turn_share:g}: must be above 0 and at most 1, a sine")
    top = (period_samples + 1) // 2 - 1
    if not 1 <= line <= top:
        raise DesignError(f"jog on line {line}: a period of {period_samples} samples has the lines 1 to {top}")
    # whole periods repeat exactly: the phase is reduced in integers
    phase = np.arange(period_samples) * line % period_samples
    whole = np.tile(amplitude * _there_and_back(phase / period_samples, turn_share), settle_periods + periods)
    if settle_periods:
        rise = round(FADE_SHARE * period_samples)
        t = np.arange(rise) / rise
        whole[:rise] *= t**4 * (35.0 - 84.0 * t + 70.0 * t**2 - 20.0 * t**3)  # ends with speed, acceleration and jerk zero
    return whole


def _there_and_back(phase: np.ndarray, turn_share: float) -> np.ndarray:
    """Return the jog of amplitude 1 at phases from 0 to below 1."""
    if turn_share == 1.0:
        return np.sin(2.0 * np.pi * phase)
    turn = 0.5 * turn_share
    from_middle = np.where(phase < 0.75, 0.25 - np.abs(phase - 0.25), phase - 1.0)  # of the way, -1/4 to 1/4 at the ends
    size = np.abs(from_middle)
    straight = 0.25 - 0.5 * turn
    rounded = straight + turn / np.pi * np.cos(np.pi * (0.25 - size) / turn)
    way = np.where(size < straight, size, rounded) / (straight + turn / np.pi)
    return np.sign(from_middle) * way


def odd_even_split(excited_lines: Iterable[int], jog_on_line: int | None) -> tuple[bool, str]:
    """Return whether even and odd distortions can be told apart by their lines, and if not, a sentence that says why.

    With odd lines only, jog included, even distortions fall on even lines. An even jog line mixes them.
    """
    if jog_on_line is not None and jog_on_line % 2 == 0:
        return False, f"the jog on even line {jog_on_line} forfeits the odd/even split of distortions; an odd jog line keeps it"
    even = [int(line) for line in excited_lines if line % 2 == 0]
    if even:
        return False, f"{len(even)} even lines are excited (first {even[0]}), so odd and even distortions are not split"
    return True, ""
