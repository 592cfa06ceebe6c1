"""Which harmonics of the base period a multisine excites."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from controllers.errors import DesignError

GRID_TOLERANCE = 1e-6
"""Tolerance in lines. Further off the grid, a sine leaks more than a millionth of its amplitude per period into its neighbours."""


@dataclass(frozen=True)
class Band:
    """A choice of lines by frequency.

    Thesis Sec. 3.3: dense around resonances, sparse elsewhere; Sec. 3.4.1: detection lines left free.

    Parameters
    ----------
    low_Hz, high_Hz : float
        Ends, both included.
    per_decade : int
        Lines per decade, logarithmic; 0 takes every line.
    dense_Hz : tuple of (low, high)
        Bands in which every line is taken regardless of `per_decade`.
    odd : bool
        Odd lines only: even distortions then fall on even lines, odd ones on odd lines that are left free.
    one_free_in : int
        One line, drawn at random, of this many consecutive chosen lines (2, 3 or 4) stays free as a detection line; 0 leaves none free.

    Examples
    --------
    A period of 10 s has lines 0.1 Hz apart.

    >>> from controllers.excitation_lines import Band
    >>> Band(0.5, 1.2).lines(1000, 100.0).tolist()
    [5, 7, 9, 11]
    """

    low_Hz: float = 0.15
    high_Hz: float = 40.0
    per_decade: int = 0
    dense_Hz: tuple[tuple[float, float], ...] = ()
    odd: bool = True
    one_free_in: int = 0

    def lines(self, period_samples: int, sample_rate_Hz: float, seed: int = 0) -> np.ndarray:
        """Return the chosen harmonics in ascending order.

        Raises
        ------
        DesignError
            A band that is empty, ends beyond half the sample rate, or a free-line rule that is none of 0, 2, 3, 4.
        """
        spacing_Hz = sample_rate_Hz / period_samples
        if not 0.0 < self.low_Hz < self.high_Hz < sample_rate_Hz / 2.0:
            raise DesignError(f"band {self.low_Hz:g} to {self.high_Hz:g} Hz: must ascend between 0 and {sample_rate_Hz / 2.0:g} Hz")
        if self.one_free_in not in (0, 2, 3, 4):
            raise DesignError(f"one_free_in = {self.one_free_in}: one line in 2, 3 or 4 can stay free, or 0 for none")
        grid = np.arange(1, (period_samples + 1) // 2)
        frequencies = grid * spacing_Hz
        slack = GRID_TOLERANCE * spacing_Hz
        candidates = (frequencies >= self.low_Hz - slack) & (frequencies <= self.high_Hz + slack)
        if self.odd:
            candidates &= grid % 2 == 1
        if not candidates.any():
            raise DesignError(f"no line of the {spacing_Hz:g} Hz grid lies between {self.low_Hz:g} and {self.high_Hz:g} Hz")
        chosen = candidates & self._dense(frequencies, slack)
        if self.per_decade:
            chosen[_nearest(self._logarithmic(), frequencies, np.flatnonzero(candidates))] = True
        else:
            chosen = candidates
        return _leave_free(grid[chosen], self.one_free_in, seed)

    def _dense(self, frequencies: np.ndarray, slack: float) -> np.ndarray:
        chosen = np.zeros(frequencies.shape, dtype=bool)
        for low, high in self.dense_Hz:
            if not low < high:
                raise DesignError(f"dense band {low:g} to {high:g} Hz: must ascend")
            chosen |= (frequencies >= low - slack) & (frequencies <= high + slack)
        return chosen

    def _logarithmic(self) -> np.ndarray:
        count = max(2, round(self.per_decade * np.log10(self.high_Hz / self.low_Hz)) + 1)
        return np.geomspace(self.low_Hz, self.high_Hz, count)


def checked_lines(lines: tuple[int, ...], period_samples: int) -> np.ndarray:
    """Return explicit lines as an ascending array.

    Raises
    ------
    DesignError
        A line twice, or outside 1 to below half the samples of a period (thesis (3.8) runs to N, of which only N/2 are distinct).
    """
    array = np.array(sorted(lines), dtype=np.int64)
    top = (period_samples + 1) // 2 - 1
    if array.size == 0:
        raise DesignError("no line to excite")
    if array[0] < 1 or array[-1] > top:
        wrong = array[0] if array[0] < 1 else array[-1]
        raise DesignError(f"line {wrong}: a period of {period_samples} samples has the lines 1 to {top}")
    if (np.diff(array) == 0).any():
        raise DesignError(f"line {array[:-1][np.diff(array) == 0][0]} is listed twice")
    return array


def _nearest(wanted_Hz: np.ndarray, frequencies: np.ndarray, candidates: np.ndarray) -> np.ndarray:
    return np.unique([candidates[np.argmin(np.abs(frequencies[candidates] - f))] for f in wanted_Hz])


def _leave_free(lines: np.ndarray, one_free_in: int, seed: int) -> np.ndarray:
    """Drop one random line of each whole group of `one_free_in` consecutive ones."""
    if not one_free_in:
        return lines
    groups = len(lines) // one_free_in
    places = np.random.default_rng([seed, one_free_in]).integers(one_free_in, size=groups)
    return np.delete(lines, np.arange(groups) * one_free_in + places)
