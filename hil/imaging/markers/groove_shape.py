"""Width and blur of the grooves of one direction, fitted together with the pieces that show them."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from hil.imaging.markers.pieces import SIZE, STEPS, Pieces, Profiles, held, solve

SHAPED = 64
"""So many pieces of a direction, spread over its grooves, tell their width and blur: many more cost time and add little."""

SHAPE_SETTLED = 5e-3
"""Steps of width and blur are below this [pixel] in the end."""


def shape_of(seen: Profiles, pieces: Pieces, good: np.ndarray, width: np.ndarray, start: tuple[float, float]) -> tuple[float, float]:
    """Return the shape of grooves of one direction by the good pieces: width, as a share of the drawing's, and blur [pixel].

    Places, contrasts and backgrounds are fitted along with it: held, they would keep it near where it started.

    Parameters
    ----------
    seen : Profiles
    pieces : Pieces
        Fitted with about this shape.
    good : (P,) bool array
    width : (P,) array
        Of each piece by the drawing [pixel].
    start : (2,)
        Share and blur to start from.
    """
    those = np.arange(0, len(good), max(1, len(good) // SHAPED))
    those = those[good[those]]
    if not len(those):
        return start
    counts, number, place, values, width = seen.counts[those], seen.number[those], seen.place[those], pieces.values[those], width[those]
    share, blur = start
    for _ in range(STEPS):
        change = _shape_step(counts, number, place, values, width, share, blur)
        widest = 0.5 * float(width.mean())
        share, blur = min(max(share + change[0], 0.8), 1.25), min(max(blur + change[1], 0.3), widest)
        if abs(change[0]) * widest < SHAPE_SETTLED and abs(change[1]) < SHAPE_SETTLED:
            break
    return float(share), float(blur)


@njit(cache=True, error_model="numpy")
def _shape_step(
    counts: np.ndarray, number: np.ndarray, place: np.ndarray, values: np.ndarray, width: np.ndarray, share: float, blur: float
) -> np.ndarray:
    """Take a step of Gauss-Newton for the share of the width, the blur and the pieces' values, which are replaced; return the first two.

    The normal equations have a block for each piece; what is left when those are eliminated is two by two.
    """
    pieces, bins = counts.shape
    root, peak = 1.0 / (math.sqrt(2.0) * blur), 1.0 / (math.sqrt(2.0 * math.pi) * blur)
    n00 = n01 = n11 = s0 = s1 = 0.0
    own, by_shape = np.zeros((pieces, SIZE)), np.zeros((pieces, 2, SIZE))
    row, normal, both, slope = np.empty(SIZE), np.empty((SIZE, SIZE)), np.empty((2, SIZE)), np.empty(SIZE)
    for k in range(pieces):
        v = values[k]
        normal[:], slope[:], both[:] = 0.0, 0.0, 0.0
        m00 = m01 = m11 = r0 = r1 = 0.0
        for j in range(bins):
            if number[k, j] == 0.0:
                continue
            d = place[k, j]
            left, right = d - v[0] + 0.5 * share * width[k], d - v[0] - 0.5 * share * width[k]
            shape = 0.5 * (math.erf(left * root) - math.erf(right * root))
            one, other = peak * math.exp(-((left * root) ** 2)), peak * math.exp(-((right * root) ** 2))
            background, contrast = v[2] + v[3] * d + v[4] * d * d, v[1] + v[5] * d
            through = 1.0 + contrast * shape
            weight = number[k, j] / max(background * through, 1.0)
            rest = counts[k, j] - background * through
            row[0], row[1], row[5] = -background * contrast * (one - other), background * shape, background * shape * d
            row[2], row[3], row[4] = through, through * d, through * d * d
            a = background * contrast * 0.5 * (one + other) * width[k]
            b = -background * contrast * (left * one - right * other) / blur
            for i in range(SIZE):
                weighted = weight * row[i]
                slope[i] += weighted * rest
                both[0, i] += weighted * a
                both[1, i] += weighted * b
                for n in range(i + 1):
                    normal[i, n] += weighted * row[n]
            m00 += weight * a * a
            m01 += weight * a * b
            m11 += weight * b * b
            r0 += weight * a * rest
            r1 += weight * b * rest
        for i in range(SIZE):
            for n in range(i + 1, SIZE):
                normal[i, n] = normal[n, i]
        stiffness = held(v)
        normal[5, 5] += stiffness
        slope[5] -= stiffness * v[5]
        if not solve(normal, slope):
            continue
        own[k] = slope
        for i in range(SIZE):
            for n in range(SIZE):
                by_shape[k, 0, i] += normal[i, n] * both[0, n]
                by_shape[k, 1, i] += normal[i, n] * both[1, n]
        for i in range(SIZE):
            m00 -= both[0, i] * by_shape[k, 0, i]
            m01 -= both[0, i] * by_shape[k, 1, i]
            m11 -= both[1, i] * by_shape[k, 1, i]
            r0 -= both[0, i] * own[k, i]
            r1 -= both[1, i] * own[k, i]
        n00, n01, n11, s0, s1 = n00 + m00, n01 + m01, n11 + m11, s0 + r0, s1 + r1
    determinant = n00 * n11 - n01 * n01
    if not determinant > 1e-12 * n00 * n11:
        return np.zeros(2)
    change = np.array([(n11 * s0 - n01 * s1) / determinant, (n00 * s1 - n01 * s0) / determinant])
    values += own - change[0] * by_shape[:, 0] - change[1] * by_shape[:, 1]
    return change
