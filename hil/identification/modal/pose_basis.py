"""Polynomials of a pose, of one scheduling parameter or more: products of Legendre polynomials, ordered by their degree."""

from __future__ import annotations

import itertools
import math

import numpy as np
from numpy.polynomial import legendre


def over_poses(x: np.ndarray, count: int) -> np.ndarray:
    """Return the first products of Legendre polynomials at poses.

    Parameters
    ----------
    x : (poses, axes) array
        Each axis scaled to -1 ... 1.
    count : int
        Of products: 1, then those of degree 1, of degree 2 and so on; over one axis the Legendre polynomials themselves.

    Returns
    -------
    (poses, count) array
    """
    degrees = _degrees(x.shape[1], count)
    single = [legendre.legvander(x[:, axis], int(degrees[:, axis].max(initial=0))) for axis in range(x.shape[1])]
    product: np.ndarray = np.prod([one[:, degrees[:, axis]] for axis, one in enumerate(single)], axis=0)
    return product


def whole_degrees(axes: int, highest: int) -> list[int]:
    """Return the orders, each the number of its products less one, up to `highest`, whose products are all those up to some degree."""
    counts = (math.comb(degree + axes, axes) for degree in itertools.count())
    return [count - 1 for count in itertools.takewhile(lambda count: count - 1 <= highest, counts)]


def _degrees(axes: int, count: int) -> np.ndarray:
    """Return of each product the degrees in every axis (count, axes)."""
    found: list[tuple[int, ...]] = []
    total = 0
    while len(found) < count:
        found += sorted((each for each in itertools.product(range(total + 1), repeat=axes) if sum(each) == total), reverse=True)
        total += 1
    return np.array(found[:count], dtype=int).reshape(count, axes)
