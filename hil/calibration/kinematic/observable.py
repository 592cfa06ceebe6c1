"""Least squares on the combinations of parameters that the data see (thesis Sec. 2.3.4): the others stay where they were, by name."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from hil.errors import BadAnswerError

VISIBLE = 1e-6
"""Singular values of the scaled Jacobian below this share of the largest are null: rounding leaves 1e-16, the weakest seen combination of
Table 2.2's chain 1e-4 or more."""

FIRST_DAMPING = 1e-3
LEAST_DAMPING, LARGEST_DAMPING = 1e-12, 1e12
CONVERGED = 1e-10
"""Relative fall of the weighted sum of squares at which the iteration ends."""
MOST_STEPS = 60


@dataclass(frozen=True)
class NullCombination:
    """A direction in parameter space the poses do not see: parameters by name and their shares, largest first."""

    shares: tuple[tuple[str, float], ...]

    def __str__(self) -> str:
        """Name the parameters and their shares."""
        return " ".join(f"{share:+.2f} {name}" for name, share in self.shares if abs(share) > 0.05)


@dataclass(frozen=True)
class SeenFit:
    """A fit by `fit_seen`.

    Attributes
    ----------
    values : (p,) array
        All parameters.
    covariance : (p, p) array
        (J' C^-1 J)^+ (correction to (2.21)); zero for what was not free.
    rank : int
        Combinations of the free parameters that the data see.
    singular_values : array
        Of the scaled Jacobian, relative to the largest.
    null : tuple of NullCombination
        Left at their start.
    residual : (M,) array
        Whitened.
    """

    values: np.ndarray
    covariance: np.ndarray
    rank: int
    singular_values: np.ndarray
    null: tuple[NullCombination, ...]
    residual: np.ndarray


def fit_seen(
    residual_of: Callable[[np.ndarray], np.ndarray],
    jacobian_of: Callable[[np.ndarray], np.ndarray],
    origin: np.ndarray,
    free: np.ndarray,
    names: Sequence[str],
) -> SeenFit:
    """Levenberg-Marquardt on the singular vectors of the scaled Jacobian.

    Parameters
    ----------
    residual_of : callable
        Parameters (p,) to whitened residuals (M,), measured less model.
    jacobian_of : callable
        Parameters (p,) to the model's whitened change (M, p).
    origin : (p,) array
        Where to start, and where what is not seen stays.
    free : int array
        Parameters to fit.
    names : sequence of str
        Of all p.

    Raises
    ------
    BadAnswerError
        The iteration does not converge.
    """
    values, damping = origin.copy(), FIRST_DAMPING
    residual = residual_of(values)
    cost = float(residual @ residual)
    for _ in range(MOST_STEPS):
        seen = _seen(jacobian_of(values)[:, free])
        slope = seen.u.T @ residual
        while True:
            change = seen.to_parameters @ (slope * seen.s / (seen.s**2 + damping * seen.s[0] ** 2))
            trial = values.copy()
            trial[free] += change
            trial_residual = residual_of(trial)
            trial_cost = float(trial_residual @ trial_residual)
            if trial_cost <= cost or damping > LARGEST_DAMPING:
                break
            damping = max(10.0 * damping, LEAST_DAMPING)
        fall = cost - trial_cost
        if fall < 0.0:
            break
        values, residual, cost = trial, trial_residual, trial_cost
        damping *= 0.1
        if fall <= CONVERGED * cost:
            break
    else:
        raise BadAnswerError(f"no convergence in {MOST_STEPS} steps; the start is too far off, or the angles are of other exposures")
    seen = _seen(jacobian_of(values)[:, free])
    covariance = np.zeros((len(origin), len(origin)))
    half = seen.to_parameters / seen.s
    covariance[np.ix_(free, free)] = half @ half.T
    return SeenFit(
        values=values,
        covariance=covariance,
        rank=len(seen.s),
        singular_values=seen.all_values / seen.all_values[0],
        null=_null(seen, [names[k] for k in free]),
        residual=residual,
    )


def combinations_seen(jacobian: np.ndarray, tolerance: np.ndarray, names: Sequence[str]) -> tuple[np.ndarray, tuple[NullCombination, ...]]:
    """Return the combinations that data determine better than a drawing does.

    Parameters
    ----------
    jacobian : (M, p) array
        Whitened.
    tolerance : (p,) array
        How far each parameter may be from its drawing.
    names : sequence of str

    Returns
    -------
    singular_values : (p,) array
        Tolerance over the standard deviation of each combination of the parameters in units of their tolerance.
    null : tuple of NullCombination
        Those below 1.
    """
    _, s, vt = np.linalg.svd(jacobian * tolerance, full_matrices=False)
    return s, tuple(NullCombination(_shares(np.array(names), row)) for row, value in zip(vt, s, strict=True) if value < 1.0)


def _null(seen: _Seen, names: Sequence[str]) -> tuple[NullCombination, ...]:
    return tuple(NullCombination(_shares(np.array(names), row)) for row in seen.null)


@dataclass(frozen=True)
class _Seen:
    """What the poses see of the free parameters."""

    u: np.ndarray  # (M, r)
    s: np.ndarray  # (r,) of the scaled Jacobian
    to_parameters: np.ndarray  # (p, r) from seen combinations to parameters
    null: np.ndarray  # (p - r, p) in scaled parameters
    all_values: np.ndarray


def _seen(jacobian: np.ndarray) -> _Seen:
    """Decompose by singular values, columns scaled to unit length, cut at `VISIBLE`."""
    scale = np.linalg.norm(jacobian, axis=0)
    scale[scale == 0.0] = 1.0
    u, s, vt = np.linalg.svd(jacobian / scale, full_matrices=False)
    rank = int(np.sum(s > VISIBLE * s[0]))
    return _Seen(u[:, :rank], s[:rank], vt[:rank].T / scale[:, None], vt[rank:], s)


def _shares(names: np.ndarray, row: np.ndarray) -> tuple[tuple[str, float], ...]:
    order = np.argsort(-np.abs(row))
    return tuple((str(names[k]), float(row[k])) for k in order)
