"""The shaper as the sample loop runs it: one sample of every axis, switched on and off without a jump.

y = r + sum A_k (r_k - r), r_k the raw reference d_k samples ago. At standstill y = r to the last bit; for a sum of gains of 1 this is the
filter itself. A tail stands on the last tap.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy.signal

from controllers.errors import DesignError
from controllers.sections import exactly_compiled, sections_step
from controllers.settings import AxisLimits
from controllers.shapers.harmonic_time_delay import UNIT_GAIN
from controllers.shapers.sampled import AxisShaper

BLEND_S = 0.5
"""Duration of the fade between raw and shaped reference; the fade has zero speed and acceleration at both ends."""


@exactly_compiled
def _tap_sample(
    history: np.ndarray, newest: int, delays: np.ndarray, gains: np.ndarray, positions: np.ndarray, at: float, oldest: float
) -> float:
    """Return one sample of one axis.

    `history` (rows,) is a ring of raw references, `newest` this sample's row in it, `oldest` the last tap's value.
    """
    rows, last, points = len(history), len(delays) - 1, len(positions)
    lower, share = 0, 0.0
    if points > 1:
        while lower < points - 2 and at >= positions[lower + 1]:
            lower += 1
        share = min(max((at - positions[lower]) / (positions[lower + 1] - positions[lower]), 0.0), 1.0)
    upper = min(lower + 1, points - 1)
    raw = history[newest]
    moved = 0.0
    for k in range(last + 1):
        held = oldest if k == last else history[(newest - delays[k]) % rows]
        moved += ((1.0 - share) * gains[lower, k] + share * gains[upper, k]) * (held - raw)
    shaped: float = raw + moved
    return shaped


class ReferenceShaper:
    """Shapers of some of a machine's axes, with their history; the references of other axes pass through.

    Parameters
    ----------
    axes : the machine's axes.
    shapers : at most one per axis.
    limits : of all axes; range and speed are limited at every sample, whatever the reference is.
    sample_rate_Hz : float

    Raises
    ------
    DesignError
        An axis does not exist or appears twice, or a shaper's H(0) is not 1.
    """

    def __init__(self, axes: Sequence[str], shapers: Sequence[AxisShaper], limits: Sequence[AxisLimits], sample_rate_Hz: float) -> None:
        names = [shaper.axis for shaper in shapers]
        for name in [*names, *(shaper.schedule_axis for shaper in shapers if shaper.schedule_axis)]:
            if name not in axes:
                raise DesignError(f"shaper: there is no axis {name!r}; there is {', '.join(axes)}")
        if len(set(names)) < len(names):
            raise DesignError(f"shaper: more than one for an axis: {', '.join(names)}")
        for shaper in shapers:
            check_passes_mean(shaper)
        self.axes, self.shapers = tuple(axes), tuple(shapers)
        self._columns = [self.axes.index(name) for name in names]
        self._scheduling = [self.axes.index(shaper.schedule_axis) if shaper.schedule_axis else 0 for shaper in shapers]
        rows = 1 + max((shaper.transient_samples for shaper in shapers), default=0)
        self._history = np.zeros((len(self.axes), rows))
        self._tail_states = [np.zeros((len(shaper.tail), 2)) for shaper in shapers]
        self._newest = 0
        self._lower = np.array([limit.lower for limit in limits])
        self._upper = np.array([limit.upper for limit in limits])
        self._step = np.array([limit.speed for limit in limits]) / sample_rate_Hz
        self._last = np.zeros(len(self.axes))
        self._blend_samples = max(1, round(BLEND_S * sample_rate_Hz))
        self._blend = self._blend_samples  # how far switched on, 0 to _blend_samples
        self._on = True

    @property
    def transient_samples(self) -> int:
        """Samples from the rest of the raw reference to the rest of the shaped one."""
        return self._history.shape[1] - 1

    def start(self, pose: np.ndarray, on: bool = True) -> None:
        """Start from a lasting standstill at `pose` (n_axes,)."""
        self._history[:] = np.asarray(pose, dtype=float)[:, None]
        self._last[:] = pose
        for shaper, column, state in zip(self.shapers, self._columns, self._tail_states, strict=True):
            if len(shaper.tail):
                state[:] = scipy.signal.sosfilt_zi(shaper.tail) * pose[column]
        self._on = on
        self._blend = self._blend_samples if on else 0

    def switch(self, on: bool) -> None:
        """Fade to the shaped (or back to the raw) reference from the next sample on."""
        self._on = on

    def step(self, raw: np.ndarray, out: np.ndarray) -> int:
        """Shape one sample: the raw reference (n_axes,) into `out` (n_axes,). A missing raw value repeats the last one.

        Returns
        -------
        int
            Bit i set: axis i was held at a limit of range or speed.
        """
        rows = self._history.shape[1]
        before = self._newest
        self._newest = (before + 1) % rows
        column = self._history[:, self._newest]
        column[:] = np.where(np.isfinite(raw), raw, self._history[:, before])
        out[:] = column
        self._blend = min(max(self._blend + (1 if self._on else -1), 0), self._blend_samples)
        share = _smooth(self._blend / self._blend_samples)
        for shaper, axis, scheduling, state in zip(self.shapers, self._columns, self._scheduling, self._tail_states, strict=True):
            history = self._history[axis]
            oldest = history[(self._newest - shaper.delays[-1]) % rows]
            if len(shaper.tail):
                oldest = sections_step(shaper.tail, state, oldest)
            shaped = _tap_sample(history, self._newest, shaper.delays, shaper.gains, shaper.positions, column[scheduling], oldest)
            out[axis] = shaped if share == 1.0 else column[axis] + share * (shaped - column[axis])
        held = 0
        for axis in range(len(self.axes)):
            low = max(self._lower[axis], self._last[axis] - self._step[axis])
            high = min(self._upper[axis], self._last[axis] + self._step[axis])
            if not low <= out[axis] <= high:
                out[axis] = min(max(out[axis], low), high)
                held |= 1 << axis
        self._last[:] = out
        return held


def check_passes_mean(shaper: AxisShaper) -> None:
    """Refuse a shaper with which a move would end somewhere else.

    Raises
    ------
    DesignError
        |H(0) - 1| or, for machines whose loop integrates, |G(0) - 1| is above 1e-9.
    """
    sums = shaper.gains.sum(axis=1)
    worst = float(sums[np.argmax(np.abs(sums - 1.0))])
    through = worst if abs(worst - 1.0) > UNIT_GAIN else shaper.static_gain
    if abs(through - 1.0) > UNIT_GAIN:
        raise DesignError(
            f"{shaper.name or 'shaper'} of {shaper.axis} passes a mean with H(0) = {through:.6g}: a move of 1 would end at {through:.4g}; "
            "a reference with a mean or a ramp needs the forcing frequency 0 among the conditions"
        )


def _smooth(share: float) -> float:
    """Fade from 0 to 1 with zero slope and curvature at both ends."""
    return share**3 * (10.0 - 15.0 * share + 6.0 * share**2)
