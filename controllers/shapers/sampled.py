"""Shapers at the sample rate: delays in whole samples, gains over the pose, and the taps of continuous designs moved onto samples."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import scipy.signal

from controllers.errors import DesignError
from controllers.shapers.conditions import Condition, equations
from controllers.shapers.delays import SETTLED, DelayFilter
from controllers.shapers.dynamics import Dynamics


@dataclass(frozen=True)
class AxisShaper:
    """The shaper of one axis as the sample loop runs it.

    Attributes
    ----------
    axis : str
    delays : (n,) int array, in samples, rising from 0
    gains : (p, n) array
        A row per scheduling position; interpolated between them.
    positions : (p,) array
        Positions of the scheduling axis [rad or m], rising; any single value where nothing is scheduled.
    schedule_axis : str
        Axis whose raw reference chooses the row; "" where there is one row.
    tail : (k, 6) array
        Sections on the last tap; none for (0, 6).
    static_gain : float
        H(0), the gain for a mean.
    name : str
    """

    axis: str
    delays: np.ndarray
    gains: np.ndarray
    positions: np.ndarray
    schedule_axis: str = ""
    tail: np.ndarray = field(default_factory=lambda: np.empty((0, 6)))
    static_gain: float = 1.0
    name: str = ""

    def __post_init__(self) -> None:
        """Check that shapes fit each other, delays and positions rise, and all numbers are finite."""
        if self.delays.ndim != 1 or self.gains.shape != (len(self.positions), len(self.delays)) or not self.gains.size:
            raise DesignError(
                f"shaper of {self.axis}: gains {self.gains.shape} do not fit {len(self.positions)} positions and {len(self.delays)} delays"
            )
        if self.delays[0] < 0 or (np.diff(self.delays) <= 0).any():
            raise DesignError(f"shaper of {self.axis}: delays must rise from 0 on, in whole samples")
        if (np.diff(self.positions) <= 0.0).any() or (len(self.positions) > 1) != bool(self.schedule_axis):
            raise DesignError(f"shaper of {self.axis}: a schedule takes rising positions and the axis they are of")
        if self.tail.ndim != 2 or self.tail.shape[1:] != (6,):
            raise DesignError(f"shaper of {self.axis}: a tail is rows of second-order sections, has shape {self.tail.shape}")
        if not (np.isfinite(self.gains).all() and np.isfinite(self.tail).all() and np.isfinite(self.positions).all()):
            raise DesignError(f"shaper of {self.axis}: gains, tail and positions must be finite numbers")

    @property
    def transient_samples(self) -> int:
        """Samples from the first tap's input to the last tap's output."""
        return int(self.delays[-1])

    @property
    def settling_samples(self) -> int:
        """Samples until the tail has decayed to `SETTLED`, from the last tap on."""
        if not len(self.tail):
            return 0
        slowest = np.abs(scipy.signal.sos2zpk(self.tail)[1]).max(initial=0.0)
        return int(np.ceil(np.log(SETTLED) / np.log(slowest))) if 0.0 < slowest < 1.0 else 0

    @property
    def gain_sum(self) -> float:
        """Largest sum of |A_k| over the schedule."""
        return float(np.abs(self.gains).sum(axis=1).max())


def axis_shaper(
    axis: str,
    filters: Sequence[DelayFilter],
    sample_rate_Hz: float,
    positions: Sequence[float] = (0.0,),
    schedule_axis: str = "",
    static_gain: float = 1.0,
) -> AxisShaper:
    """Make a shaper from filters with the same delays, one per scheduling position.

    Raises
    ------
    DesignError
        Delays are not whole numbers of samples or differ between positions, or a tail differs or is continuous.
    """
    samples = filters[0].delays_s * sample_rate_Hz
    if np.abs(samples - np.round(samples)).max() > 1e-6:
        raise DesignError(f"{filters[0].name}: delays {filters[0].delays_s.tolist()} s are no whole samples at {sample_rate_Hz:g} Hz")
    if any(len(each.delays_s) != len(samples) or np.abs(each.delays_s - filters[0].delays_s).max() > 1e-9 for each in filters):
        raise DesignError(f"{filters[0].name}: the filters of a schedule need the same delays")
    tail = filters[0].tail
    if any(each.tail is not tail for each in filters):
        raise DesignError(f"{filters[0].name}: the filters of a schedule need the same tail")
    return AxisShaper(
        axis,
        np.round(samples).astype(np.int64),
        np.array([each.gains for each in filters]),
        np.asarray(positions, dtype=float),
        schedule_axis,
        np.empty((0, 6)) if tail is None else sections_of(tail),
        static_gain,
        filters[0].name,
    )


def sections_of(system: Dynamics) -> np.ndarray:
    """Return a sampled system as second-order sections (k, 6)."""
    if system.sample_period_s is None:
        raise DesignError("a continuous tail cannot run in the loop: design at the sample rate")
    zeros, poles = system.zeros, np.linalg.eigvals(system.a)
    at = 1.0 + 0.0j  # the gain from the response at z = 1, where tails have 1
    gain = float((system.response(0.0) * np.prod(at - poles) / np.prod(at - zeros)).real)
    return np.asarray(scipy.signal.zpk2sos(zeros, poles, gain))


def on_samples(shaper: DelayFilter, conditions: Sequence[Condition], sample_period_s: float) -> DelayFilter:
    """Move a filter's taps onto whole samples and correct its gains so that the conditions hold exactly again.

    Each tap is shared between the sample before and the one after; the smallest change of gains then repairs the rounding.

    Parameters
    ----------
    shaper : DelayFilter
        Without a tail.
    conditions : what it met before, e.g. zeros at the sampled poles and DC gain 1.
    sample_period_s : float
    """
    samples = shaper.delays_s / sample_period_s
    before = np.floor(samples + 1e-9).astype(int)
    after_share = samples - before
    spread = np.zeros(int(before[-1]) + 3)
    np.add.at(spread, before, shaper.gains * (1.0 - after_share))
    np.add.at(spread, before + 1, shaper.gains * after_share)
    taps = np.flatnonzero(np.abs(spread) > 1e-12)
    count = sum(condition.equations for condition in conditions)
    while len(taps) < count:  # taps on whole samples already have no neighbour to share with
        taps = np.union1d(taps, [taps[-1] + 1, *(taps + 1)[: count - len(taps)]])
    delays, gains = taps * sample_period_s, np.append(spread, np.zeros(count + 1))[taps]
    matrix, right = equations(conditions, delays, None)
    for _ in range(3):
        gains = gains + np.linalg.lstsq(matrix, right - matrix @ gains, rcond=1e-13)[0]
    return DelayFilter(delays, gains, None, shaper.name)
