"""The algebra of a filter whose images come late: what an image shows of its instant is kept as extra states until it is there.

So an image counts for exactly what it would have counted in time.
"""

from __future__ import annotations

import numpy as np


class LateImages:
    """Estimate and covariance, with copies of some states for every image on its way.

    Parameters
    ----------
    x, covariance : (states,), (states, states) arrays
    shown : (s,) int array
        States that an image shows and that move on before it arrives.

    Attributes
    ----------
    x, covariance : (states + s waiting,) array and its covariance
    """

    def __init__(self, x: np.ndarray, covariance: np.ndarray, shown: np.ndarray) -> None:
        self.x, self.covariance = x, covariance
        self._own, self._shown = len(x), np.asarray(shown, dtype=int)
        self._waiting: list[int] = []

    def exposed(self, number: int) -> None:
        """Remember what an image shows of this instant until it arrives."""
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
        """Forget an exposure whose image will not come, or has been taken in."""
        away = self.copies(number)
        keep = np.r_[0 : away.start, away.stop : len(self.x)]
        self.x, self.covariance = self.x[keep], self.covariance[np.ix_(keep, keep)]
        self._waiting.remove(number)

    def update(self, innovation: np.ndarray, gradient: np.ndarray, covariance: np.ndarray) -> None:
        """Take an innovation in (Joseph's form, which keeps the covariance positive)."""
        spread = gradient @ self.covariance @ gradient.T + covariance
        gain = np.linalg.solve(spread, gradient @ self.covariance).T
        rest = np.eye(len(self.x)) - gain @ gradient
        self.x = self.x + gain @ innovation
        self.covariance = rest @ self.covariance @ rest.T + gain @ covariance @ gain.T

    def surprise(self, innovation: np.ndarray, gradient: np.ndarray, covariance: np.ndarray) -> float:
        """Return the normalised innovation squared."""
        spread = gradient @ self.covariance @ gradient.T + covariance
        return float(innovation @ np.linalg.solve(spread, innovation))
