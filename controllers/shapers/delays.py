"""A delay filter G(s) = sum A_k exp(-s d_k), with an optional tail filter on its last tap."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from controllers.errors import DesignError
from controllers.shapers.dynamics import Dynamics

SETTLED = 0.01
"""Share to which a filter's slowest mode has decayed when it counts as settled."""


@dataclass(frozen=True)
class DelayFilter:
    """The taps of a shaper.

    Attributes
    ----------
    delays_s : (n,) array, rising from 0
    gains : (n,) array
    tail : Dynamics or None
        Stands on the last tap: A_n F(s) exp(-s d_n), as in (7.33).
    name : str
    """

    delays_s: np.ndarray
    gains: np.ndarray
    tail: Dynamics | None = None
    name: str = ""

    def __post_init__(self) -> None:
        """Check that delays and gains fit each other, rise from 0 and are finite."""
        if self.delays_s.shape != self.gains.shape or self.delays_s.ndim != 1 or not len(self.gains):
            raise DesignError(f"a delay filter takes as many delays as gains, has {self.delays_s.shape} and {self.gains.shape}")
        if (np.diff(self.delays_s) < 0.0).any() or self.delays_s[0] < 0.0:
            raise DesignError(f"delays must rise from 0, are {self.delays_s.tolist()}")
        if not (np.isfinite(self.gains).all() and np.isfinite(self.delays_s).all()):
            raise DesignError("delays and gains must be finite numbers")

    @property
    def transient_s(self) -> float:
        """Duration L T of the transient, after which nothing new comes out of the taps."""
        return float(self.delays_s[-1])

    @property
    def settled_s(self) -> float:
        """Duration of the transient until the tail, too, has decayed to `SETTLED`."""
        if self.tail is None or not len(self.tail.poles):
            return self.transient_s
        slowest = -self.tail.poles.real.max()
        return self.transient_s - float(np.log(SETTLED)) / slowest if slowest > 0.0 else np.inf

    @property
    def largest_gain(self) -> float:
        """Largest |A_k|."""
        return float(np.abs(self.gains).max())

    @property
    def gain_sum(self) -> float:
        """Sum of |A_k|. Without a tail, no limit of the reference is exceeded by more than this factor."""
        return float(np.abs(self.gains).sum())

    def response(self, s: np.ndarray | complex) -> np.ndarray:
        """Return G at complex s, same shape."""
        value: np.ndarray = basis(np.asarray(s, dtype=complex), self.delays_s, self.tail)[0] @ self.gains
        return value

    def slope(self, s: np.ndarray | complex) -> np.ndarray:
        """Return dG/ds at complex s, same shape."""
        value: np.ndarray = basis(np.asarray(s, dtype=complex), self.delays_s, self.tail)[1] @ self.gains
        return value

    def ending(self, poles: np.ndarray) -> np.ndarray:
        """Return G(p) exp(p d_n), same shape as `poles`: a mode's amplitude when the last tap acts, for unit amplitude at the first."""
        decayed = np.exp(poles[..., None] * (self.delays_s[-1] - self.delays_s))
        if self.tail is not None:
            decayed[..., -1] = decayed[..., -1] * self.tail.response(poles)
        amplitude: np.ndarray = decayed @ self.gains
        return amplitude

    def then(self, other: DelayFilter) -> DelayFilter:
        """Return both filters in series, with the zeros of both (multi-mode shapers). Taps at the same instant are joined."""
        if self.tail is not None or other.tail is not None:
            raise DesignError("only delay filters without a tail are convolved")
        delays = (self.delays_s[:, None] + other.delays_s[None, :]).reshape(-1)
        gains = (self.gains[:, None] * other.gains[None, :]).reshape(-1)
        order = np.argsort(delays, kind="stable")
        delays, gains = delays[order], gains[order]
        first = np.concatenate([[True], np.diff(delays) > 1e-12 * max(delays[-1], 1.0)])
        joined = np.add.reduceat(gains, np.flatnonzero(first))
        return DelayFilter(delays[first], joined, None, f"{self.name} * {other.name}")


def basis(s: np.ndarray, delays_s: np.ndarray, tail: Dynamics | None) -> tuple[np.ndarray, np.ndarray]:
    """Return value and slope (..., n) of each tap's contribution for a gain of 1 at complex s (...)."""
    values = np.exp(-s[..., None] * delays_s)
    slopes = -delays_s * values
    if tail is not None:
        filtered, changing = tail.response(s), tail.slope(s)
        slopes[..., -1] = slopes[..., -1] * filtered + values[..., -1] * changing
        values[..., -1] = values[..., -1] * filtered
    return values, slopes
