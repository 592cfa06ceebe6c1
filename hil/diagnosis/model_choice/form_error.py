"""What laws may be wrong by: their form, as noise that goes with them.

Real friction, springs and motors follow the catalogue's curves to a tenth or so. How far a law is off is a smooth function of position and
speed that nobody knows: a Gaussian one, with FORM of the law as its standard deviation. So what is left along a law is noise with a
covariance of its own, and another effect beside it must explain what no such function does (Kennedy and O'Hagan 2001).
"""

from __future__ import annotations

import copy
from collections.abc import Sequence

import numpy as np
from numpy.polynomial import legendre

from hil.diagnosis.candidates.columns import Column
from hil.diagnosis.residuals.trajectory import Motion

FORM = 0.1
"""Relative error of a law's form."""
DEGREE = 3
"""Of the polynomials in position and in speed that the error is made of."""


def form_columns(change: Column, motion: Motion) -> list[Column]:
    """Return what one standard deviation of each part of a law's form error changes; `change` is what the law itself does."""
    found = []  # as many of every recording, though a law may not act in some
    shapes = {joint: _shapes(motion, joint, at) for joint, (at, _) in change.efforts.items()}
    for k in range(2 * DEGREE):
        efforts = {joint: (at * shapes[joint][:, k], until * shapes[joint][:, k]) for joint, (at, until) in change.efforts.items()}
        found.append(Column(efforts, {}))
    return found


def _shapes(motion: Motion, joint: int, effort: np.ndarray) -> np.ndarray:
    """Return polynomials (N, 2 DEGREE) of a joint's position and speed, even in speed, of FORM rms together.

    None has a part of the law itself, `effort` (N,): the strength of a law is that of its mean over the recording.
    """
    weights = effort.astype(float) ** 2
    parts: list[np.ndarray] = []
    for values in (motion.position[:, joint], np.abs(motion.speed[:, joint])):
        low, reach = float(values.min()), float(np.ptp(values))
        x = 2.0 * (values - low) / reach - 1.0 if reach > 0.0 else np.zeros_like(values)
        parts += [legendre.legval(x, np.eye(1, n + 1, n)[0]) * np.sqrt(2 * n + 1) for n in range(1, DEGREE + 1)]
    shapes = np.column_stack(parts)
    shapes -= weights @ shapes / max(float(weights.sum()), 1e-300)
    shapes *= FORM / np.sqrt(2 * DEGREE)
    return shapes.astype(np.float32)


class FormError:
    """Form errors of a set of laws as noise beside white one.

    Parameters
    ----------
    columns : sequence of (N m, K) arrays
        What one standard deviation of each changes of every recording, whitened.
    dispersion : float
        Of the white noise.
    """

    def __init__(self, columns: Sequence[np.ndarray], dispersion: float) -> None:
        self.columns = tuple(columns)
        self.dispersion = dispersion
        self.squares = np.sum([each.T @ each for each in columns], axis=0)
        self._inner = self.squares + dispersion * np.eye(len(self.squares))

    def without_columns(self) -> FormError:
        """Return what costs are computed from."""
        bare = copy.copy(self)
        bare.columns = ()
        return bare

    @property
    def count(self) -> int:
        """Number of unknowns."""
        return len(self.squares)

    def log_determinant(self, dispersion: float) -> float:
        """Return that of the covariance over the white noise's."""
        if not self.count:
            return 0.0
        return float(np.linalg.slogdet(np.eye(self.count) + self.squares / dispersion)[1])

    def solved(self, slopes: np.ndarray) -> np.ndarray:
        """Return the likeliest form errors (K, ...) for slopes (K, ...)."""
        return np.linalg.solve(self._inner, slopes)

    def taken_from(self, left: Sequence[np.ndarray]) -> tuple[tuple[np.ndarray, ...], float]:
        """Return what the likeliest form errors leave, and their squares."""
        if not self.count:
            return tuple(left), 0.0
        slopes = np.sum([each.T @ rest for each, rest in zip(self.columns, left, strict=True)], axis=0)
        size = np.linalg.solve(self._inner, slopes)
        return tuple(rest - each @ size for each, rest in zip(self.columns, left, strict=True)), float(size @ size)
