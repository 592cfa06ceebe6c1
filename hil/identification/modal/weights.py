"""The variance that weights a response in a modal fit."""

from __future__ import annotations

import numpy as np

from hil.identification.result import FrequencyResponse

NEIGHBOURS = 10  # lines to either side over which total over noise variance is averaged


def fit_variance(response: FrequencyResponse) -> np.ndarray:
    """Return the variance of each element (L, n_y, n_u), smoother over lines than the estimated total variance.

    A total variance has few degrees of freedom, M - 1 for each experiment, so that weights from its inverse depend on chance. The noise
    variance has many. Therefore the noise variance is taken, times the ratio of total to noise variance averaged over neighbouring lines,
    and at least 1.
    """
    if response.total_covariance is None:
        return response.standard_deviation("noise") ** 2
    total = response.standard_deviation("total") ** 2
    if response.noise_covariance is None:
        return total
    noise = response.standard_deviation("noise") ** 2
    sums = np.cumsum(np.concatenate((np.zeros((1, *total.shape[1:])), total / noise)), axis=0)
    at = np.arange(len(total))
    low, high = np.maximum(at - NEIGHBOURS, 0), np.minimum(at + NEIGHBOURS + 1, len(total))
    ratio = (sums[high] - sums[low]) / (high - low)[:, None, None]
    weighed: np.ndarray = noise * np.maximum(ratio, 1.0)
    return weighed
