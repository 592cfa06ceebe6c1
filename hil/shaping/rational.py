"""Rational fit of sampled frequency responses with common poles: vector fitting (Gustavsen and Semlyen 1999) on the unit circle."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg

from controllers.errors import DesignError
from controllers.shapers.dynamics import Dynamics

ROUNDS = 10
"""Most relocations of the poles; from well-spread starts they have then settled."""

SETTLED = 1e-6
"""Largest move of a pole in the z plane that counts as settled."""

ORDERS = range(10, 31, 4)

WORSE = 2
"""Consecutive orders that raise the criterion before the search ends."""

FLOOR = 0.01
"""Responses are weighted relative to their size, at least this share of the largest: a fit should not follow noise in antiresonances."""


@dataclass(frozen=True)
class RationalFit:
    """Systems with common poles, and their error.

    Attributes
    ----------
    systems : one per response.
    error : rms of the weighted relative error over all responses and lines.
    """

    systems: tuple[Dynamics, ...]
    error: float


def fit(responses: np.ndarray, frequencies_Hz: np.ndarray, sample_rate_Hz: float) -> RationalFit:
    """Fit with the order that has the least Bayesian information criterion.

    Parameters
    ----------
    responses : (L, m) complex array
    frequencies_Hz : (L,) array
    sample_rate_Hz : float

    Raises
    ------
    DesignError
        Too few lines for the smallest order.
    """
    lines, outputs = responses.shape
    if lines < ORDERS[0] + 2:
        raise DesignError(f"{lines} frequencies are too few to find modes in; it takes {ORDERS[0] + 2}")
    z = np.exp(2j * np.pi * frequencies_Hz / sample_rate_Hz)
    size = np.abs(responses)
    weights = 1.0 / np.maximum(size, FLOOR * size.max(axis=0))
    best: tuple[float, RationalFit] | None = None
    since_best = 0
    for order in ORDERS:
        if lines < order + 2 or since_best == WORSE:
            break
        found = _fit_order(responses, weights, z, order, 1.0 / sample_rate_Hz, frequencies_Hz)
        count = 2 * lines * outputs
        criterion = count * np.log(max(found.error, 1e-12) ** 2) + (order + outputs * (order + 1)) * np.log(count)
        since_best += 1
        if best is None or criterion < best[0]:
            best, since_best = (criterion, found), 0
    assert best is not None
    return best[1]


def _fit_order(
    responses: np.ndarray, weights: np.ndarray, z: np.ndarray, order: int, period_s: float, frequencies_Hz: np.ndarray
) -> RationalFit:
    low, high = max(frequencies_Hz.min(), 1e-3), frequencies_Hz.max()
    angles = 2.0 * np.pi * period_s * np.geomspace(low, high, order // 2)
    poles = np.exp((-0.05 + 1j) * angles)  # upper halves of pairs, 5 % damped
    for _ in range(ROUNDS):
        states, entering = _blocks(poles)
        basis = _basis(poles, z)
        rows, right = [], []
        for response, weight in zip(responses.T, weights.T, strict=True):
            own = np.column_stack([basis, np.ones(len(z))])
            block = weight[:, None] * np.column_stack([own, -response[:, None] * basis])
            block, target = np.vstack([block.real, block.imag]), np.concatenate([(weight * response).real, (weight * response).imag])
            r = np.asarray(np.linalg.qr(np.column_stack([block, target]), mode="r"))
            kept = r[own.shape[1] :, own.shape[1] :]  # what the common denominator has to explain
            rows.append(kept[:, :-1])
            right.append(kept[:, -1])
        shared = np.linalg.lstsq(np.vstack(rows), np.concatenate(right), rcond=None)[0]
        moved = np.linalg.eigvals(states - np.outer(entering, shared))
        outside = np.abs(moved) >= 1.0
        moved[outside] = 1.0 / np.conj(moved[outside])
        before, poles = poles, _halves(moved)
        if len(before) == len(poles) and np.abs(np.sort_complex(poles) - np.sort_complex(before)).max() < SETTLED:
            break
    states, entering = _blocks(poles)
    basis = np.column_stack([_basis(poles, z), np.ones(len(z))])
    systems, missed = [], []
    for response, weight in zip(responses.T, weights.T, strict=True):
        block, target = weight[:, None] * basis, weight * response
        solution = np.linalg.lstsq(np.vstack([block.real, block.imag]), np.concatenate([target.real, target.imag]), rcond=None)[0]
        systems.append(Dynamics(states, entering, solution[:-1], float(solution[-1]), period_s))
        missed.append(np.abs(block @ solution - target) ** 2)
    return RationalFit(tuple(systems), float(np.sqrt(np.mean(missed))))


def _halves(poles: np.ndarray) -> np.ndarray:
    """Return the upper halves of pole pairs, then the real poles."""
    real = np.abs(poles.imag) < 1e-12
    return np.concatenate([poles[~real & (poles.imag > 0.0)], poles[real].real])


def _blocks(halves: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the real state matrix (n, n) and input (n,) with these poles."""
    blocks, entering = [], []
    for pole in halves:
        if abs(pole.imag) > 0.0:
            blocks.append(np.array([[pole.real, pole.imag], [-pole.imag, pole.real]]))
            entering += [2.0, 0.0]
        else:
            blocks.append(np.array([[pole.real]]))
            entering += [1.0]
    return scipy.linalg.block_diag(*blocks), np.array(entering)


def _basis(halves: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Return responses (L, n) of the states of `_blocks` to the input in closed form, without a linear system per line."""
    columns: list[np.ndarray] = []
    for pole in halves:
        if abs(pole.imag) > 0.0:
            away = z - pole.real
            size = away**2 + pole.imag**2
            columns += [2.0 * away / size, -2.0 * pole.imag / size]
        else:
            columns.append(1.0 / (z - pole.real))
    return np.array(columns).T
