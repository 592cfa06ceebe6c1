"""The variance along a response that is seen in what a fit leaves, whatever it is that is left.

Of a residual r and a unit response u the products u r summed over channels are the rows of a score. Where r is white noise their sum has
variance one; where something is left, it has the variance that the rows show, those near in time taken together (the sandwich of White
1982, Econometrica 50, with the lags' weights of Newey and West 1987, Econometrica 55). What is left in other channels or at other times
than a response counts nothing.
"""

from __future__ import annotations

import numpy as np

from hil.diagnosis.tuning.free_run import FreeRuns

REACH_s = 0.3
"""Rows that are further apart in time count as independent: a few memories of a position loop."""


class StructureLeft:
    """Of whitened residuals of one set.

    Parameters
    ----------
    runs : FreeRuns
    name : str
        Of the set.
    """

    def __init__(self, runs: FreeRuns, name: str) -> None:
        found = runs.sets[name]
        self._channels = len(found.channels)
        self._ends = np.cumsum([runs.noise.size(len(group.time_s)) // self._channels for group in found.groups])[:-1]
        self._reach = max(round(REACH_s * runs.noise.rate_Hz), 1)

    def along(self, response: np.ndarray, residual: np.ndarray) -> float:
        """Variance of a residual (M,) along a response (M,), in units of the noise model's; at least 1."""
        energy = float(response @ response)
        if energy == 0.0:
            return 1.0
        rows = (response * residual).reshape(-1, self._channels).sum(axis=1)
        return max(1.0, sum(near_products(part, self._reach) for part in np.split(rows, self._ends)) / energy)


def near_products(rows: np.ndarray, reach: int) -> float:
    """Sum of products of rows (N,), weighted by how near they are, up to so many rows: not negative."""
    spectrum = np.abs(np.fft.rfft(rows, 2 * len(rows))) ** 2
    products = np.fft.irfft(spectrum, 2 * len(rows))[: min(reach, len(rows))]
    weights = 1.0 - np.arange(len(products)) / reach
    return float(products[0] + 2.0 * weights[1:] @ products[1:])
