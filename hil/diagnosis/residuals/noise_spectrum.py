"""The colour of noise, and when it is loud: what a filter of even and white disturbances leaves of it in every reading's innovations."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy.linalg

from hil.diagnosis.residuals.propagation import quickly_compiled

QUIETEST = 0.01
"""Share of the mean square below which nothing is quiet: a stretch in which an encoder's lattice hides all noise says nothing of it."""
WHITEST = 1e-3
"""Of noise, the share that nothing before predicts, at least."""
LONGEST = 32
"""Rows that an autoregression looks back, at most: a narrow line takes two, and a slope some more."""


SHOWN = 60
"""Innovations of noise that a loudness is taken from: its relative error is a tenth."""


def loudness_of(innovations: Sequence[np.ndarray]) -> np.ndarray:
    """Return how large innovations (N, m) of noise alone are from row to row, over all repeats of one experiment: (N, m), 1 on average.

    Where a joint reverses, friction scatters from repeat to repeat: noise is loud there.
    """
    squares = np.mean([each**2 for each in innovations], axis=0)
    rows = len(squares)
    half = max(1, round(0.5 * SHOWN / len(innovations)))
    sums = np.vstack([np.zeros(squares.shape[1]), np.cumsum(squares, axis=0)])
    first, last = np.maximum(np.arange(rows) - half, 0), np.minimum(np.arange(rows) + half + 1, rows)
    local = (sums[last] - sums[first]) / (last - first)[:, None]
    whole = squares.mean(axis=0)
    loudness: np.ndarray = np.sqrt(np.where(whole > 0.0, np.maximum(local, QUIETEST * whole) / np.maximum(whole, 1e-300), 1.0))
    return loudness


def colour_of(innovations: Sequence[np.ndarray]) -> np.ndarray:
    """Return whitening filters (m, LONGEST + 1) of innovations (N, m) of noise alone, one array a recording.

    Each is an autoregression by Yule and Walker; its order is the one of Akaike's criterion (1974).
    """
    channels = innovations[0].shape[1]
    filters = np.zeros((channels, LONGEST + 1))
    for c in range(channels):
        columns = [each[:, c] for each in innovations]
        rows = sum(len(column) for column in columns)
        lags = np.array([sum(float(column[k:] @ column[: len(column) - k]) for column in columns) for k in range(LONGEST + 1)]) / rows
        filters[c, 0] = 1.0
        if lags[0] <= 0.0:
            continue
        size = min(float(lags[0]), 1.0)  # of what repeats do not show, as of a lattice, the levels know
        lags[0] *= 1.0 + WHITEST
        best = np.inf
        for order in range(min(LONGEST, rows // LONGEST) + 1):
            back = scipy.linalg.solve_toeplitz(lags[:order], lags[1 : order + 1]) if order else np.zeros(0)
            variance = float(lags[0] - back @ lags[1 : order + 1])
            criterion = rows * np.log(max(variance, 1e-300)) + 2.0 * order
            if variance > 0.0 and criterion < best:
                best = criterion
                filters[c] = 0.0
                filters[c, 0], filters[c, 1 : order + 1] = 1.0, -back
                filters[c] *= np.sqrt(size / variance)
    return filters


@quickly_compiled
def whitened_by(filters: np.ndarray, values: np.ndarray) -> None:
    """Pass columns (N m, C) of innovations, row by row, through their channels' filters (m, p + 1), in place."""
    channels, lags = filters.shape
    rows = values.shape[0] // channels
    for c in range(channels):
        order = 0
        for k in range(lags):
            if filters[c, k] != 0.0:
                order = k
        for row in range(rows - 1, -1, -1):
            at = row * channels + c
            first = filters[c, 0]
            for i in range(values.shape[1]):
                values[at, i] *= first
            for k in range(1, min(order, row) + 1):
                weight = filters[c, k]
                before = at - k * channels
                for i in range(values.shape[1]):
                    values[at, i] += weight * values[before, i]
