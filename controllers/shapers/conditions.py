"""Conditions on a delay filter, linear in its gains: zeros at poles, the plant's inverse at forcing frequencies, and their slopes.

Design Requirement 1, (7.22)-(7.24), and (7.35), (7.36), with the corrections: (7.31), (7.32) get the right-hand sides Re and Im of
1/P(iw); H = P G is +1 at every forcing frequency; (7.35) holds once per conjugate pair, as dG/ds(p) = 0 with the tail's slope included.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from controllers.errors import DesignError
from controllers.shapers.delays import DelayFilter, basis
from controllers.shapers.dynamics import Dynamics

REAL = 1e-12
"""A point of the s plane with a smaller relative imaginary part counts as real and gives one equation instead of two."""

SOLVED = 1e-9
"""Largest residual with which a condition counts as met, in units of its largest term for a gain of 1."""

LIGHTLY_DAMPED = 0.3
"""Damping ratio below which a pole rings: its response has a peak that a forcing frequency must keep away from."""


@dataclass(frozen=True)
class Condition:
    """A condition on G: its derivative of this order is `value` at s (and the conjugate of `value` at the conjugate of s)."""

    s: complex
    value: complex
    order: int = 0
    what: str = ""

    @property
    def equations(self) -> int:
        """Number of real equations: one at a real point, two elsewhere."""
        return 1 if abs(self.s.imag) <= REAL * abs(self.s) else 2


def cancelling(poles: Iterable[complex], robust: bool = False) -> list[Condition]:
    """Make the conditions (7.22): G = 0 at each pole, conjugates once; robust: dG/ds = 0 there as well, (7.35)."""
    conditions = []
    for pole in poles:
        if pole.imag < -REAL * abs(pole):
            continue
        conditions.append(Condition(complex(pole), 0.0, 0, f"pole {pole:.4g} rad/s"))
        if robust:
            conditions.append(Condition(complex(pole), 0.0, 1, f"slope at the pole {pole:.4g} rad/s"))
    return conditions


def tracking(dynamics: Dynamics, frequencies_rad_s: Iterable[float], robust: bool = False) -> list[Condition]:
    """Make the conditions (7.23), (7.24): P G = +1 at each forcing frequency; robust: d(P G)/ds = 0 there as well, (7.36).

    A reference with a mean has the forcing frequency 0 among them. At zero frequency the slope makes a ramp follow without lag.
    """
    conditions = []
    for frequency in frequencies_rad_s:
        s = 1j * float(frequency)
        plant, slope = complex(dynamics.response(s)), complex(dynamics.slope(s))
        if not (np.isfinite(plant) and abs(plant) > 0.0):
            raise DesignError(f"the plant passes nothing at the forcing frequency {frequency:.4g} rad/s, so nothing can be tracked there")
        conditions.append(Condition(s, 1.0 / plant, 0, f"forcing frequency {frequency:.4g} rad/s"))
        if robust:  # d(PG) = P'G + P G' = 0 with G = 1/P
            conditions.append(Condition(s, -slope / plant**2, 1, f"slope at the forcing frequency {frequency:.4g} rad/s"))
    return conditions


def check_apart(poles: Iterable[complex], frequencies_rad_s: Iterable[float]) -> None:
    """Refuse a forcing frequency inside the resonance of a pole that is to be cancelled: G would have to be 0 and 1/P side by side.

    Raises
    ------
    DesignError
        A forcing frequency lies on a pole; the message says how far to stay away.
    """
    for pole in poles:
        if -pole.real >= LIGHTLY_DAMPED * abs(pole):
            continue
        for frequency in frequencies_rad_s:
            if abs(abs(pole.imag) - frequency) <= max(-pole.real, 1e-6 * abs(pole)):
                raise DesignError(
                    f"forcing frequency {frequency:.6g} rad/s lies on the pole {complex(pole):.6g} rad/s that is to be cancelled; "
                    f"stay {2.0 * max(-pole.real, 1e-3 * abs(pole)):.2g} rad/s away from {abs(pole.imag):.6g}, or leave that harmonic out"
                )


def equations(conditions: Sequence[Condition], delays_s: np.ndarray, tail: Dynamics | None) -> tuple[np.ndarray, np.ndarray]:
    """Return the real matrix (m, n) and right-hand side (m,) of the conditions for these taps, each scaled to its largest complex term.

    Real and imaginary parts keep their proportion: a part that vanishes at some delay does so smoothly with the delay. Delays of shape
    (k, 1, n) give matrices (k, m, n) and right-hand sides (k, m).
    """
    points, values = (np.array([getattr(condition, name) for condition in conditions], dtype=complex) for name in ("s", "value"))
    gains, slopes = basis(points, delays_s, tail)
    terms = np.where(np.array([condition.order == 0 for condition in conditions])[:, None], gains, slopes)
    scale = np.abs(terms).max(axis=-1)
    scale[scale == 0.0] = 1.0
    owner = np.repeat(np.arange(len(conditions)), [condition.equations for condition in conditions])
    is_imaginary = np.concatenate([[False], owner[1:] == owner[:-1]])
    terms, right = (terms / scale[..., None])[..., owner, :], (values / scale)[..., owner]
    return np.where(is_imaginary[:, None], terms.imag, terms.real), np.where(is_imaginary, right.imag, right.real)


def solve(conditions: Sequence[Condition], delays_s: np.ndarray, tail: Dynamics | None = None, name: str = "") -> DelayFilter:
    """Return the filter whose gains meet the conditions; of many, that with the least sum of squares.

    Raises
    ------
    DesignError
        No gains meet them at these delays; the message names the condition that is missed most.
    """
    matrix, right = equations(conditions, delays_s, tail)
    gains = np.linalg.lstsq(matrix, right, rcond=1e-15)[0]
    exact, wanted = matrix.astype(np.longdouble), right.astype(np.longdouble)
    for _ in range(3):  # iterative refinement: cond 1e6 and residuals below 1e-9 go together
        gains = gains + np.linalg.lstsq(matrix, (wanted - exact @ gains).astype(float), rcond=1e-15)[0]
    missed = np.abs((wanted - exact @ gains).astype(float))
    if not missed.max() <= SOLVED * max(1.0, np.abs(right).max()):
        owner = np.repeat(np.arange(len(conditions)), [condition.equations for condition in conditions])
        raise DesignError(
            f"no gains meet {conditions[owner[int(np.argmax(missed))]].what or 'the conditions'} with {len(delays_s)} taps "
            f"up to {delays_s[-1]:.4g} s (residual {missed.max():.1e}); take another delay or more taps"
        )
    return DelayFilter(np.asarray(delays_s, dtype=float), gains, tail, name)


def residuals(conditions: Sequence[Condition], shaper: DelayFilter) -> np.ndarray:
    """Return the complex residual (n_conditions,) of a filter for each condition."""
    points = np.array([condition.s for condition in conditions])
    values, slopes = basis(points, shaper.delays_s, shaper.tail)
    chosen = np.where(np.array([condition.order for condition in conditions])[:, None] == 0, values, slopes)
    missed: np.ndarray = chosen @ shaper.gains - np.array([condition.value for condition in conditions])
    return missed
