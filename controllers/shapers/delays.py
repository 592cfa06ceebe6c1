"""A delay filter G(s) = sum A_k exp(-s d_k), with an optional tail filter on its last tap."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from controllers.errors import DesignError
from controllers.shapers.dynamics import Dynamics


@dataclass(frozen=True)
class DelayFilter:
    """Taps of a shaper.

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
        if self.delays_s.shape != self.gains.shape or self.delays_s.ndim != 1 or not len(self.gains):
            raise DesignError(f"a delay filter takes as many delays as gains, has {self.delays_s.shape} and {self.gains.shape}")
        if (np.diff(self.delays_s) < 0.0).any() or self.delays_s[0] < 0.0:
            raise DesignError(f"delays must rise from 0, are {self.delays_s.tolist()}")
        if not (np.isfinite(self.gains).all() and np.isfinite(self.delays_s).all()):
            raise DesignError("delays and gains must be finite numbers")

    @property
    def transient_s(self) -> float:
        """Time after which nothing new comes out of the taps: L T."""
        return float(self.delays_s[-1])

    @property
    def largest_gain(self) -> float:
        return float(np.abs(self.gains).max())

    @property
    def gain_sum(self) -> float:
        """Sum of |A_k|: without a tail no limit of the reference is exceeded by more than this factor."""
        return float(np.abs(self.gains).sum())

    def response(self, s: np.ndarray | complex) -> np.ndarray:
        """G at complex s, same shape."""
        return basis(np.asarray(s, dtype=complex), self.delays_s, self.tail)[0] @ self.gains

    def slope(self, s: np.ndarray | complex) -> np.ndarray:
        """dG/ds at complex s, same shape."""
        return basis(np.asarray(s, dtype=complex), self.delays_s, self.tail)[1] @ self.gains

    def ending(self, poles: np.ndarray) -> np.ndarray:
        """G(p) exp(p d_n), same shape as `poles`: what a mode holds when the last tap acts, for unit amplitude at the first."""
        decayed = np.exp(poles[..., None] * (self.delays_s[-1] - self.delays_s))
        if self.tail is not None:
            decayed[..., -1] = decayed[..., -1] * self.tail.response(poles)
        return decayed @ self.gains

    def then(self, other: DelayFilter) -> DelayFilter:
        """Both, one after the other: the zeros of both (multi-mode shapers). Taps at the same instant are joined."""
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
    """Value and slope (..., n) of what each tap contributes for a gain of 1 at complex s (...)."""
    values = np.exp(-s[..., None] * delays_s)
    slopes = -delays_s * values
    if tail is not None:
        filtered, changing = tail.response(s), tail.slope(s)
        slopes[..., -1] = slopes[..., -1] * filtered + values[..., -1] * changing
        values[..., -1] = values[..., -1] * filtered
    return values, slopes
