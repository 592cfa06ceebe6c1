"""How much has changed at all, found from the images (type-II maximum likelihood, MacKay 1992), and what has.

A prior that is wider than the change fills whatever the images do not show with noise; one that is too narrow hides it. So its scale is not
given: of a grid of scales, each counts by the probability of what the images say.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

SCALES = np.concatenate([[0.0], np.geomspace(1e-3, 3.0, 12)])
"""Of the widest prior."""


@dataclass(frozen=True)
class Change:
    """What has changed, whatever the scale.

    Attributes
    ----------
    mean : (n,) array
    covariance : (n, n) array
    scales : (groups,) array
        Mean square roots, of each group of coefficients.
    gain : float
        Twice the logarithm of the likeliest scales' probability over that of no change at all.
    told : float
        Coefficients that the images determine, at the likeliest scales.
    """

    mean: np.ndarray
    covariance: np.ndarray
    scales: np.ndarray
    gain: float
    told: float


def change(information: np.ndarray, score: np.ndarray, noise: np.ndarray, groups: tuple[np.ndarray, ...]) -> Change:
    """Weigh scales of two groups of coefficients.

    Parameters
    ----------
    information : (n, n) array
        H, where the score is H x + noise.
    score : (n,) array
    noise : (n, n) array
        Its covariance.
    groups : two (n, n) arrays
        Prior covariances at scale one, to be added.
    """
    rows = []
    for one in SCALES:
        for other in SCALES:
            prior = one**2 * groups[0] + other**2 * groups[1]
            gain = prior @ information.T
            expected = noise + information @ gain
            root = np.linalg.cholesky(expected)
            white = np.linalg.solve(root, np.column_stack([score, gain.T]))
            likelihood = -0.5 * float(white[:, 0] @ white[:, 0]) - float(np.log(np.diag(root)).sum())
            mean = white[:, 1:].T @ white[:, 0]
            told = float(np.trace(np.linalg.solve(expected, information @ gain)))
            rows.append((likelihood, mean, prior - white[:, 1:].T @ white[:, 1:], (one, other), told))
    likelihoods = np.array([row[0] for row in rows])
    best = int(likelihoods.argmax())
    weight = np.exp(likelihoods - likelihoods[best])
    weight /= weight.sum()
    mean = sum(w * row[1] for w, row in zip(weight, rows, strict=True))
    second = sum(w * (row[2] + np.outer(row[1], row[1])) for w, row in zip(weight, rows, strict=True))
    scales = np.sqrt(sum(w * np.square(row[3]) for w, row in zip(weight, rows, strict=True)))
    return Change(mean, second - np.outer(mean, mean), scales, 2.0 * float(likelihoods[best] - likelihoods[0]), rows[best][4])
