"""Monomials of frequency and scheduling parameters: the basis of a Taylor series over several of them, (4.23) and (4.53)."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np


def multi_indices(orders: Sequence[int]) -> np.ndarray:
    """Return exponents (k, directions) of a Taylor series, (4.23) and (4.53).

    Each is at most its direction's order, and their sum at most the largest order. The constant is left out; pure powers of every direction
    are included (errata to (4.53)).
    """
    every = itertools.product(*(range(order + 1) for order in orders))
    return np.array([i for i in every if 0 < sum(i) <= max(orders, default=0)], int).reshape(-1, len(orders))


def monomials(coordinates: np.ndarray, orders: Sequence[int]) -> np.ndarray:
    """Return products of powers of the coordinates: (..., directions) to (..., k)."""
    values: np.ndarray = np.prod(coordinates[..., None, :] ** multi_indices(orders), axis=-1)
    return values


def symmetric_monomials(coordinates: np.ndarray, centre: np.ndarray, orders: Sequence[int]) -> np.ndarray:
    """Average monomials over places of equal response, less their value at the centre (i, directions).

    From (..., i, directions) to (..., k). A series of them is as symmetric as the machine, whatever its coefficients, and equals its
    constant at the centre.
    """
    if coordinates.shape[-2] == 1:
        return monomials(coordinates[..., 0, :], orders)
    at_centre = np.nanmean(monomials(centre, orders), axis=-2)
    even_part: np.ndarray = np.nanmean(monomials(coordinates, orders), axis=-2) - at_centre
    return even_part
