"""Structure of a modal model over poses: modes from fits at single poses; poles outside the band and orders over the poses by BIC."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hil.errors import IdentificationError
from hil.identification.modal.all_poses import JointFit, JointProblem, JointState
from hil.identification.modal.one_pose import PoseModes, choose_pairs, fit_modes
from hil.identification.modal.pole_blocks import Block
from hil.identification.modal.pose_basis import over_poses, whole_degrees
from hil.identification.result import FrequencyResponse

HIGHEST_ORDERS = {1: 12, 2: 20}  # by axes, of a polynomial over the poses: of two axes those up to degree 5
APART = 0.01  # of an axis's range scaled to -1 ... 1: two poses that are nearer are at one level of it
WELL_KNOWN = 1e3  # condition of the polynomials at the poses: beyond, a thousandth of an error at them is as large as the whole between
LIGHT = 0.5  # damping ratio below which a pair counts as a mode
MOVE = 1.5  # factor in a_0 by which a mode's motion from pose to pose is carried on at most
MOST_OUTSIDE = 4  # pairs of poles below the band, and above it
BELOW, BELOW_DAMPING = 0.25, 0.1  # of the lowest line's frequency: where poles below the band start
ABOVE, ABOVE_DAMPING = 2.0, 0.4  # of the highest line's: where those above start


def highest_order(x: np.ndarray) -> int:
    """Return the highest order of a polynomial over poses (poses, axes): one degree of freedom is left, along each axis and in all.

    The axis with the fewest levels bounds the degree in both.

    Raises
    ------
    IdentificationError
        There are more axes than the model takes, or the poses lie on one line.
    """
    poses, axes = x.shape
    if axes not in HIGHEST_ORDERS:
        raise IdentificationError(f"{axes} axes vary between the poses: a model over the poses takes one or two")
    levels = min(np.count_nonzero(np.diff(np.sort(along)) > APART) + 1 for along in x.T)
    orders = whole_degrees(axes, min(HIGHEST_ORDERS[axes], poses - 2))[: levels - 1]
    known = [order for order in orders if np.linalg.cond(over_poses(x, order + 1)) < WELL_KNOWN]
    if axes > 1 and len(known) < 2:
        raise IdentificationError("the poses lie on one line, or at two levels of an axis: a model over two axes takes three of each")
    return known[-1]


def modes_over(ordered: Sequence[FrequencyResponse], x: np.ndarray) -> tuple[tuple[PoseModes, ...], np.ndarray]:
    """Fit single poses, each from its nearest neighbour's poles, and tell which pairs are modes in the band at every pose.

    `x` (poses, axes) are the poses scaled to -1 ... 1. The number of pairs is chosen at the middle or an outermost pose: at the one that
    shows most modes.
    """
    band = 2 * np.pi * np.array([ordered[0].frequencies_Hz[0], ordered[0].frequencies_Hz[-1]])
    middle, inwards = np.argmin(np.abs(x).sum(axis=1)), x @ np.array(list(itertools.product((1.0, -1.0), repeat=x.shape[1]))).T
    chosen = {int(index): choose_pairs(ordered[index]) for index in dict.fromkeys((middle, *np.argmin(inwards, axis=0)))}
    first = max(chosen, key=lambda index: np.count_nonzero(_are_modes(chosen[index].a0, chosen[index].a1, band)))
    fits = {first: chosen[first]}
    while len(fits) < len(ordered):
        index, inner, further = _next(x, list(fits))
        near = fits[inner]
        starts = [(near.a0, near.a1)]
        if further is not None:  # a mode that moves goes on moving
            moving = _are_modes(near.a0, near.a1, band) & _are_modes(fits[further].a0, fits[further].a1, band)
            ratio = np.clip(near.a0 / np.where(moving, fits[further].a0, near.a0), 1.0 / MOVE, MOVE)
            starts.append((near.a0 * np.where(moving, ratio, 1.0), near.a1))
        fits[index] = min((fit_modes(ordered[index], start) for start in starts), key=lambda fit: fit.criterion)
    along = tuple(fits[index] for index in range(len(ordered)))
    return along, np.all([_are_modes(fit.a0, fit.a1, band) for fit in along], axis=0)


def _next(x: np.ndarray, fitted: list[int]) -> tuple[int, int, int | None]:
    """Return the pose nearest to a fitted one, that one, and the fitted one behind it, from where the way goes on; None without one."""
    apart = np.linalg.norm(x[:, None] - x[None, fitted], axis=2)
    apart[fitted] = np.inf
    nearest = apart.min(axis=1)
    index = int(np.flatnonzero(nearest <= nearest.min() + 1e-9)[-1])
    inner = fitted[int(np.argmin(apart[index]))]
    others = [other for other in fitted if other != inner]
    behind = np.linalg.norm(x[others] - (2.0 * x[inner] - x[index]), axis=1)
    return index, inner, others[int(np.argmin(behind))] if len(others) and behind.min() < 0.75 * nearest[index] else None


def mode_blocks(fits: Sequence[PoseModes], modes: np.ndarray, x: np.ndarray, order: int, *, flexible: bool = True) -> list[Block]:
    """Return blocks of the modes, rising in frequency, from the fits at single poses."""
    blocks = []
    K = len(modes)
    for k in np.flatnonzero(modes):
        a0, a1 = np.array([fit.a0[k] for fit in fits]), np.array([fit.a1[k] for fit in fits])
        variance = np.array([fit.pole_covariance[k, k] for fit in fits]), np.array([fit.pole_covariance[K + k, K + k] for fit in fits])
        scale = float(np.exp(np.mean(np.log(a0)) / 2))
        if flexible:
            values = scale * a1 / a0, scale**2 / a0
            sizes = scale / a0 * np.sqrt(variance[1]), scale**2 / a0**2 * np.sqrt(variance[0])
        else:
            values = a0 / scale**2, a1 / scale
            sizes = np.sqrt(variance[0]) / scale**2, np.sqrt(variance[1]) / scale
        coefficients = [
            _smoothed(x, value, order, 1.0 / np.maximum(size, 1e-9 * np.abs(value).max()))
            for value, size in zip(values, sizes, strict=True)
        ]
        blocks.append(Block(scale, tuple(coefficients), flexible, is_mode=True))
    return sorted(blocks, key=lambda block: block.scale)


def _smoothed(x: np.ndarray, values: np.ndarray, order: int, weight: np.ndarray) -> np.ndarray:
    """Return the polynomial of this order over the poses that fits values (poses,) best."""
    products = over_poses(x, order + 1) * weight[:, None]
    size = np.linalg.norm(products, axis=0)
    polynomial: np.ndarray = np.linalg.lstsq(products / size, values * weight, rcond=None)[0] / size
    return polynomial


def outside_block(pairs: int, frequency_rad_s: float, damping: float) -> list[Block]:
    """Return poles outside the band, the same at all poses; none for 0 pairs."""
    if pairs == 0:
        return []
    polynomial = np.array([1.0])
    for _ in range(pairs):
        polynomial = np.polymul(polynomial, (1.0, 2.0 * damping, 1.0))
    return [Block(frequency_rad_s, tuple(np.array([c]) for c in polynomial[:0:-1]), flexible=False, is_mode=False)]


def choose_blocks(problem: JointProblem, modes: list[Block], outside: tuple[int, int], order: int) -> JointState:
    """Choose the numbers of pole pairs below and above the band with the least BIC, upwards from a first guess.

    All numerators have one order.
    """
    lowest, highest = 2 * np.pi * problem.frequencies_Hz[[0, -1]]
    fits: dict[tuple[int, int], JointState] = {}

    def fit(below: int, above: int) -> JointState:
        if (below, above) not in fits:
            best = min(fits.values(), key=lambda f: f.criterion, default=None)
            known = modes if best is None else [block for block in best.blocks if block.is_mode]
            blocks = (
                *outside_block(below, BELOW * lowest, BELOW_DAMPING),
                *known,
                *outside_block(above, ABOVE * highest, ABOVE_DAMPING),
            )
            fits[below, above] = problem.fit(blocks, (order,) * problem.elements)
        return fits[below, above]

    here = outside
    fit(*here)
    while True:
        around = [(here[0] + 1, here[1]), (here[0], here[1] + 1)]
        better = [at for at in around if max(at) <= MOST_OUTSIDE and fit(*at).criterion < fit(*here).criterion]
        if not better:
            return fit(*here)
        here = min(better, key=lambda at: fit(*at).criterion)


def with_better_form(problem: JointProblem, state: JointState, modes: list[Block]) -> JointState:
    """Return `state`, or the same poles with the modes in the form of `modes`, whichever has the lower BIC."""
    others = iter(modes)
    other = problem.fit([next(others) if block.is_mode else block for block in state.blocks], state.orders)
    return min(state, other, key=lambda each: each.criterion)


def with_chosen_orders(problem: JointProblem, state: JointState, highest: int) -> JointFit:
    """Refit the same blocks with each polynomial's order chosen from the data."""
    blocks = _pruned(state.result(), float(np.log(problem.equations)))
    return problem.fit(blocks, problem.numerator_orders(blocks, highest)).result()


def _pruned(fit: JointFit, price: float) -> tuple[Block, ...]:
    """Drop the highest coefficients of the denominators' polynomials one by one, while their squared t value is below `price`.

    Dropping one constrains the others, which move as their covariance says.
    """
    mean = np.concatenate([c for block in fit.blocks for c in block.coefficients])
    covariance = fit.pole_covariance.copy()
    place = np.cumsum([0] + [len(c) for block in fit.blocks for c in block.coefficients])
    orders = np.diff(place) - 1
    while np.any(orders > 0):
        tops = place[:-1] + orders
        variance = np.maximum(np.diagonal(covariance)[tops], np.finfo(float).tiny)
        square = np.where(orders > 0, mean[tops] ** 2 / variance, np.inf)
        weakest = int(np.argmin(square))
        if square[weakest] >= price:
            break
        top = tops[weakest]
        gain = covariance[:, top] / max(covariance[top, top], np.finfo(float).tiny)
        mean, covariance = mean - gain * mean[top], covariance - np.outer(gain, covariance[top])
        orders[weakest] -= 1
    parts = iter([mean[start : start + order + 1] for start, order in zip(place[:-1], orders, strict=True)])
    return tuple(replace(block, coefficients=tuple(next(parts) for _ in block.coefficients)) for block in fit.blocks)


def _are_modes(a0: np.ndarray, a1: np.ndarray, band_rad_s: np.ndarray) -> np.ndarray:
    omega = np.sqrt(np.maximum(a0, np.finfo(float).tiny))
    kept: np.ndarray = (a0 > 0.0) & (a1 > 0.0) & (a1 < 2 * LIGHT * omega) & (omega > band_rad_s[0]) & (omega < band_rad_s[1])
    return kept
