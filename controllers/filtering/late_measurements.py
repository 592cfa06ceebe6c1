"""Kalman filter whose measurements come late: what one shows of its instant is kept as extra states until it is there.

So it counts for exactly what it would have counted in time.
"""

from __future__ import annotations

import numpy as np


class LateMeasurements:
    """Estimate and covariance, with copies of some states for every measurement on its way.

    Parameters
    ----------
    x, covariance : (states,), (states, states) arrays
    shown : (s,) int array
        States that a measurement shows and that move on before it arrives.

    Attributes
    ----------
    x, covariance : (states + s waiting,) array and its covariance
    """

    def __init__(self, x: np.ndarray, covariance: np.ndarray, shown: np.ndarray) -> None:
        self.x, self.covariance = x, covariance
        self._own, self._shown = len(x), np.asarray(shown, dtype=int)
        self._waiting: list[int] = []

    def exposed(self, number: int) -> None:
        """Remember what a measurement shows of this instant until it arrives."""
        self.x = np.concatenate([self.x, self.x[self._shown]])
        grown = np.vstack([self.covariance, self.covariance[self._shown, :]])
        self.covariance = np.hstack([grown, grown[:, self._shown]])
        self._waiting.append(number)

    def copies(self, number: int) -> slice:
        """Return where the copies of an exposure are among the states."""
        size = len(self._shown)
        first = self._own + size * self._waiting.index(number)
        return slice(first, first + size)

    def dropped(self, number: int) -> None:
        """Forget an exposure whose measurement will not come, or has been taken in."""
        away = self.copies(number)
        keep = np.r_[0 : away.start, away.stop : len(self.x)]
        self.x, self.covariance = self.x[keep], self.covariance[np.ix_(keep, keep)]
        self._waiting.remove(number)

    def spread(self, gradient: np.ndarray, covariance: np.ndarray) -> np.ndarray:
        """Return the covariance (k, k) of the innovation of a measurement (k,) with this gradient (k, states) and noise (k, k)."""
        spread: np.ndarray = gradient @ self.covariance @ gradient.T + covariance
        return spread

    def gain(self, gradient: np.ndarray, covariance: np.ndarray) -> np.ndarray:
        """Return the gain (states, k)."""
        gain: np.ndarray = np.linalg.solve(self.spread(gradient, covariance), gradient @ self.covariance).T
        return gain

    def update(self, innovation: np.ndarray, gradient: np.ndarray, covariance: np.ndarray) -> None:
        """Take an innovation in (Joseph's form, which keeps the covariance positive)."""
        gain = self.gain(gradient, covariance)
        rest = np.eye(len(self.x)) - gain @ gradient
        self.x = self.x + gain @ innovation
        self.covariance = rest @ self.covariance @ rest.T + gain @ covariance @ gain.T

    def update_whitened(self, innovation: np.ndarray, gradient: np.ndarray, covariance: np.ndarray) -> float:
        """Take an innovation in and return its normalised square, for what is measured at every sample.

        With W the whitened rows of H P, P - WᵀW is a fraction of the work of Joseph's form. It loses the digits by which a measurement is
        surer than the estimate: few for samples in a row, many for an image of a machine as on its drawing.
        """
        shown = gradient @ self.covariance
        lower = np.linalg.cholesky(shown @ gradient.T + covariance)
        whitened = np.linalg.solve(lower, np.column_stack([shown, innovation]))
        rows, rest = whitened[:, :-1], whitened[:, -1]
        self.x = self.x + rest @ rows
        left = self.covariance - rows.T @ rows
        self.covariance = 0.5 * (left + left.T)
        return float(rest @ rest)

    def surprise(self, innovation: np.ndarray, gradient: np.ndarray, covariance: np.ndarray) -> float:
        """Return the normalised innovation squared."""
        return float(innovation @ np.linalg.solve(self.spread(gradient, covariance), innovation))
