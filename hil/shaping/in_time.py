"""A shaper in time: what a closed loop does after a step of its reference, and how its lightly damped modes ring, with it and without."""

from __future__ import annotations

import textwrap
from dataclasses import dataclass

import numpy as np

from controllers.shapers.conditions import LIGHTLY_DAMPED
from controllers.shapers.delays import DelayFilter
from controllers.shapers.dynamics import Dynamics

SETTLED = 0.05
"""Share of the largest ringing without a shaper below which a loop counts as settled."""

FAINT = 1e-6
"""Share of the step below which ringing is none: less than any encoder resolves."""

TOLD_OVERSHOOT = 0.02
"""Share of the step by which a shaper may add to the overshoot without a word."""

WIDTH = 100
"""Of a terminal [columns]."""

LONGEST_s = 30.0
"""Longest time looked at: a mode at 1 Hz and 1 % damping has settled by then."""


@dataclass(frozen=True)
class InTime:
    """A loop after a step of 1 in its raw reference.

    Attributes
    ----------
    time_s, reference, output, ringing : (N,) with the shaped reference, the output that tracks, and the part of it that its lightly damped
        modes make beside their static deflection.
    left : largest ringing after the shaper's transient, as a share of the step.
    """

    time_s: np.ndarray
    reference: np.ndarray
    output: np.ndarray
    ringing: np.ndarray
    left: float

    def settled_s(self, level: float) -> float:
        """Return from when on [s] the ringing stays within a share of the step; infinite where it does not within `LONGEST_s`."""
        beyond = np.flatnonzero(np.abs(self.ringing) > level)
        if not beyond.size:
            return 0.0
        return np.inf if beyond[-1] == len(self.ringing) - 1 else float(self.time_s[beyond[-1] + 1])

    @property
    def overshoot(self) -> float:
        """Largest excess of the output over where it ends, as a share of the step."""
        return float(self.output.max() - self.output[-1])

    @property
    def ramp_lag_s(self) -> float:
        """Time by which the output trails a ramp: the area that it lacks after a step, less the one that it has too much."""
        return float((self.output[-1] - self.output).sum() * (self.time_s[1] - self.time_s[0]))


def after_step(dynamics: Dynamics, shaper: DelayFilter, sample_rate_Hz: float) -> InTime:
    """Return the response of a loop to a step behind a shaper.

    Parameters
    ----------
    dynamics : Dynamics
        From reference to output; a continuous one is sampled.
    shaper : DelayFilter
        With delays of whole samples; one tap of 1 at 0 is no shaper.
    sample_rate_Hz : float
    """
    period_s = 1.0 / sample_rate_Hz
    loop = dynamics if dynamics.sample_period_s is not None else dynamics.sampled(period_s)
    count = round(LONGEST_s * sample_rate_Hz)
    reference = _shaped_step(shaper, period_s, count)
    values, seen = loop.residues
    rings = _rings(values, period_s)
    state, output = np.zeros(len(loop.b)), np.zeros(count)
    for k in range(count):
        output[k] = loop.c @ state + loop.d * reference[k]
        state = loop.a @ state + loop.b * reference[k]
    ringing = np.zeros(count)
    if rings.any():
        static = (seen[rings] / (1.0 - values[rings])).sum().real
        ringing = (_modal_states(values[rings], reference) @ seen[rings]).real - static * reference
    time_s = np.arange(count) * period_s
    after = time_s > shaper.transient_s
    return InTime(time_s, reference, output, ringing, float(np.abs(ringing[after]).max()))


def settled(without: InTime, shaped: InTime) -> tuple[float, float]:
    """Return from when on [s] the ringing stays below a twentieth of the largest one without a shaper, without and with it."""
    level = SETTLED * without.left
    return without.settled_s(level), shaped.settled_s(level)


def in_time_lines(without: InTime, shaped: InTime, name: str) -> list[str]:
    """Return before and after in words."""
    lines = ["in time, after a step of the reference: ringing of the lightly damped modes in the output"]
    for label, each, settled_s in zip(("without shaper", name), (without, shaped), settled(without, shaped), strict=True):
        when = f"after {settled_s:.2f} s" if np.isfinite(settled_s) else f"not within {LONGEST_s:g} s"
        lines.append(f"  {label:14s}  up to {_percent(each.left)} of the step, down to a twentieth of the unshaped {when}")
    if shaped.overshoot > without.overshoot + TOLD_OVERSHOOT:
        lags = [f"{round(1e3 * each.ramp_lag_s)} ms" for each in (shaped, without)]
        said = (
            f"a step overshoots by {_percent(shaped.overshoot)}, by {_percent(without.overshoot)} without: what is held back at first,"
            f" and may trail a ramp by {lags[0]} alone ({lags[1]} without), must go beyond a step; the reference of a scan is a ramp"
        )
        lines += textwrap.wrap(said, WIDTH, initial_indent="  ", subsequent_indent="    ")
    return lines


def _shaped_step(shaper: DelayFilter, period_s: float, count: int) -> np.ndarray:
    """Return a step of 1 at the first sample behind the taps (count,)."""
    reference = np.zeros(count)
    last = len(shaper.gains) - 1
    for number, (delay_s, gain) in enumerate(zip(shaper.delays_s, shaper.gains, strict=True)):
        begin = round(float(delay_s) / period_s)
        entering = np.ones(max(count - begin, 0))
        if number == last and shaper.tail is not None:
            entering = _response(shaper.tail, entering)
        reference[begin:] += gain * entering
    return reference


def _response(system: Dynamics, entering: np.ndarray) -> np.ndarray:
    values, right = np.linalg.eig(system.a)
    seen = (system.c @ right) * np.linalg.solve(right, system.b.astype(complex))
    response: np.ndarray = (_modal_states(values, entering) @ seen).real + system.d * entering
    return response


def _modal_states(values: np.ndarray, entering: np.ndarray) -> np.ndarray:
    """Return the states (N, n) of x[k+1] = value x[k] + u[k] from rest, one per eigenvalue."""
    states = np.zeros((len(entering), len(values)), dtype=complex)
    for k in range(1, len(entering)):
        states[k] = values * states[k - 1] + entering[k - 1]
    return states


def _rings(values: np.ndarray, period_s: float) -> np.ndarray:
    """Return which eigenvalues (n,) of a sampled loop are lightly damped modes."""
    with np.errstate(divide="ignore"):
        s = np.log(values.astype(complex)) / period_s
    size = np.abs(s)
    rings: np.ndarray = (np.abs(values.imag) > 0.0) & np.isfinite(size) & (-s.real < LIGHTLY_DAMPED * size)
    return rings


def _percent(share: float) -> str:
    return f"{100.0 * share:.3g} %" if share > FAINT else "0 %"
