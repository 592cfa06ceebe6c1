"""Many small complex least-squares problems at once: the engine of every local parametric method.

One problem per centre (line, pose and record). With phi the numerator's basis, psi the denominator's (both without unit), w and z the rows
of the excitation and the closed-loop outputs inside the window, the unknowns N and D of

    z_i^T = sum_a phi_ia w_i^T N_a^T - sum_d psi_id y_i^T D_d^T + w_i^T N_0^T + residual,       (3.30), (3.41), (4.47), (4.51)

are found by modified Gram-Schmidt on scaled columns, (4.37). Only N_0, its share of (K^H K)^-1 and the products of the residuals are
wanted, so the columns of N_0 come last and the elimination leaves these quantities. Problems are solved LANES at a time, side by side in
memory, so that every inner loop is a vector instruction.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from controllers.compiled import kept_on_disk

quickly_compiled = kept_on_disk(fastmath=True, error_model="numpy")
LANES = 8  # problems side by side: one AVX-512 register of doubles, two of AVX2
DEPENDENT = 1e-20  # squared length left of a scaled column (1e-10 of it) below which it counts as dependent on the columns before


@dataclass(frozen=True)
class LocalFits:
    """Solutions at B centres.

    Attributes
    ----------
    response : (B, n_z, n_w) N_0: the local model at the centre.
    inverse_gram : (B, n_w, n_w) the block of (K^H K)^-1 that belongs to N_0; the conjugate of S^H S of (3.47).
    residual_products : (B, n_z, n_z) sum of residual residual^H over the window.
    dof : (B,) rows less the rank of K, (4.30), (4.33).
    """

    response: np.ndarray
    inverse_gram: np.ndarray
    residual_products: np.ndarray
    dof: np.ndarray


def local_fits(
    rows: np.ndarray,
    numerator: np.ndarray,
    denominator: np.ndarray,
    w: np.ndarray,
    z: np.ndarray,
    extra: np.ndarray | None = None,
    n_y: int | None = None,
) -> LocalFits:
    """Fit the local model at every centre.

    Parameters
    ----------
    rows : (B, n) rows of `w` and `z` inside each window.
    numerator : (1 or B, n, a) basis of the numerator without its constant.
    denominator : (1 or B, n, d) basis of the denominator without its unit; d = 0 gives the polynomial method.
    w : (rows, n_w) excitation spectrum. z : (rows, n_z) output spectrum.
    extra : (1 or B, n, x) further real columns, e.g. transients of arbitrary excitations.
    n_y : how many of z's columns, the first ones, the denominator takes; None takes all. In closed loop these are the plant's outputs.
        u = w - C y adds no pole to them, and with C changing over the window it would add r u + C r y, which is r^2 y: a regressor that
        explains the outputs' own noise and halves its estimate.
    """
    centres, n = rows.shape
    if extra is None:
        extra = np.zeros((1, n, 0))
    bases = tuple(np.ascontiguousarray(basis, dtype=float) for basis in (numerator, denominator, extra))
    w, z = np.ascontiguousarray(w, complex), np.ascontiguousarray(z, complex)
    n_w, n_z = w.shape[1], z.shape[1]
    n_y = n_z if n_y is None else n_y
    response = np.empty((centres, n_z, n_w), complex)
    inverse_gram = np.empty((centres, n_w, n_w), complex)
    residual_products = np.empty((centres, n_z, n_z), complex)
    dof = np.empty(centres, np.int64)
    _fit_all(np.ascontiguousarray(rows), bases, w, z, n_y, response, inverse_gram, residual_products, dof)
    return LocalFits(response, inverse_gram, residual_products, dof)


@quickly_compiled
def _fit_all(
    rows: np.ndarray,
    bases: tuple[np.ndarray, ...],
    w: np.ndarray,
    z: np.ndarray,
    n_y: int,
    response: np.ndarray,
    inverse_gram: np.ndarray,
    residual_products: np.ndarray,
    dof: np.ndarray,
) -> None:
    numerator, denominator, extra = bases
    centres, n = rows.shape
    n_w, n_z = w.shape[1], z.shape[1]
    a, d, x = numerator.shape[2], denominator.shape[2], extra.shape[2]
    unknowns = a * n_w + d * n_y + x + n_w
    re = np.zeros((unknowns + n_z, n, LANES))
    im = np.zeros((unknowns + n_z, n, LANES))
    scale = np.empty((unknowns, LANES))
    upper_re, upper_im = np.zeros((n_w, n_w + n_z, LANES)), np.zeros((n_w, n_w + n_z, LANES))
    length = np.empty((n_w, LANES))
    rank = np.empty(LANES, np.int64)
    for first in range(0, centres, LANES):
        used = min(LANES, centres - first)
        for lane in range(LANES):
            centre = first + min(lane, used - 1)
            _fill(re, im, lane, rows[centre], numerator[centre % len(numerator)], denominator[centre % len(denominator)],
                  extra[centre % len(extra)], w, z, n_y)  # fmt: skip
        _scale_columns(re, im, unknowns, scale)
        _eliminate(re, im, unknowns, n_w, n_z, upper_re, upper_im, length, rank)
        for lane in range(used):
            _collect(first + lane, lane, n, unknowns, re, im, scale, upper_re, upper_im, length, response, inverse_gram, residual_products)
            dof[first + lane] = n - rank[lane]


@quickly_compiled
def _fill(
    re: np.ndarray,
    im: np.ndarray,
    lane: int,
    rows: np.ndarray,
    numerator: np.ndarray,
    denominator: np.ndarray,
    extra: np.ndarray,
    w: np.ndarray,
    z: np.ndarray,
    n_y: int,
) -> None:
    """Fill the columns of one lane in the order numerator, denominator, extra, N_0, targets."""
    n_w, n_z = w.shape[1], z.shape[1]
    a, d, x = numerator.shape[1], denominator.shape[1], extra.shape[1]
    behind = a * n_w + d * n_y + x
    for i in range(len(rows)):
        row = rows[i]
        for j in range(n_w):
            value = w[row, j]
            for b in range(a):
                re[b * n_w + j, i, lane] = numerator[i, b] * value.real
                im[b * n_w + j, i, lane] = numerator[i, b] * value.imag
            re[behind + j, i, lane] = value.real
            im[behind + j, i, lane] = value.imag
        for j in range(n_z):
            value = z[row, j]
            for b in range(d if j < n_y else 0):
                re[a * n_w + b * n_y + j, i, lane] = -denominator[i, b] * value.real
                im[a * n_w + b * n_y + j, i, lane] = -denominator[i, b] * value.imag
            re[behind + n_w + j, i, lane] = value.real
            im[behind + n_w + j, i, lane] = value.imag
        for b in range(x):
            re[behind - x + b, i, lane] = extra[i, b]
            im[behind - x + b, i, lane] = 0.0


@quickly_compiled
def _scale_columns(re: np.ndarray, im: np.ndarray, unknowns: int, scale: np.ndarray) -> None:
    """Scale every column of K to unit length, (4.37), (4.38)."""
    n = re.shape[1]
    square = np.empty(LANES)
    for c in range(unknowns):
        square[:] = 0.0
        for i in range(n):
            for lane in range(LANES):
                square[lane] += re[c, i, lane] ** 2 + im[c, i, lane] ** 2
        for lane in range(LANES):
            scale[c, lane] = np.sqrt(square[lane]) if square[lane] > 0.0 else 1.0
        for i in range(n):
            for lane in range(LANES):
                re[c, i, lane] /= scale[c, lane]
                im[c, i, lane] /= scale[c, lane]


@quickly_compiled
def _eliminate(
    re: np.ndarray,
    im: np.ndarray,
    unknowns: int,
    n_w: int,
    n_z: int,
    upper_re: np.ndarray,
    upper_im: np.ndarray,
    length: np.ndarray,
    rank: np.ndarray,
) -> None:
    """Orthogonalise the columns of K and the targets by modified Gram-Schmidt; keep the rows of R that belong to N_0."""
    n = re.shape[1]
    square, inverse = np.empty(LANES), np.empty(LANES)
    dot_re, dot_im = np.empty(LANES), np.empty(LANES)
    rank[:] = 0
    for j in range(unknowns):
        square[:] = 0.0
        for i in range(n):
            for lane in range(LANES):
                square[lane] += re[j, i, lane] ** 2 + im[j, i, lane] ** 2
        for lane in range(LANES):
            independent = square[lane] > DEPENDENT
            inverse[lane] = 1.0 / square[lane] if independent else 0.0
            rank[lane] += 1 if independent else 0
        for c in range(j + 1, unknowns + n_z):
            dot_re[:] = 0.0
            dot_im[:] = 0.0
            for i in range(n):
                for lane in range(LANES):
                    dot_re[lane] += re[j, i, lane] * re[c, i, lane] + im[j, i, lane] * im[c, i, lane]
                    dot_im[lane] += re[j, i, lane] * im[c, i, lane] - im[j, i, lane] * re[c, i, lane]
            for lane in range(LANES):
                dot_re[lane] *= inverse[lane]
                dot_im[lane] *= inverse[lane]
            for i in range(n):
                for lane in range(LANES):
                    re[c, i, lane] -= dot_re[lane] * re[j, i, lane] - dot_im[lane] * im[j, i, lane]
                    im[c, i, lane] -= dot_re[lane] * im[j, i, lane] + dot_im[lane] * re[j, i, lane]
            if j >= unknowns - n_w:
                for lane in range(LANES):
                    upper_re[j - unknowns + n_w, c - unknowns + n_w, lane] = dot_re[lane]
                    upper_im[j - unknowns + n_w, c - unknowns + n_w, lane] = dot_im[lane]
        if j >= unknowns - n_w:
            for lane in range(LANES):
                length[j - unknowns + n_w, lane] = inverse[lane]


@quickly_compiled
def _collect(
    centre: int,
    lane: int,
    n: int,
    unknowns: int,
    re: np.ndarray,
    im: np.ndarray,
    scale: np.ndarray,
    upper_re: np.ndarray,
    upper_im: np.ndarray,
    length: np.ndarray,
    response: np.ndarray,
    inverse_gram: np.ndarray,
    residual_products: np.ndarray,
) -> None:
    n_w, n_z = response.shape[2], response.shape[1]
    inverse = np.zeros((n_w, n_w), np.complex128)  # of the unit upper triangle
    for j in range(n_w - 1, -1, -1):
        inverse[j, j] = 1.0
        for c in range(j + 1, n_w):
            total = 0j
            for k in range(j + 1, c + 1):
                total -= complex(upper_re[j, k, lane], upper_im[j, k, lane]) * inverse[k, c]
            inverse[j, c] = total
    for j in range(n_w):
        outer = scale[unknowns - n_w + j, lane]
        for target in range(n_z):
            total = 0j
            for k in range(j, n_w):
                total += inverse[j, k] * complex(upper_re[k, n_w + target, lane], upper_im[k, n_w + target, lane])
            response[centre, target, j] = total / outer
        for c in range(n_w):
            total = 0j
            for k in range(max(j, c), n_w):
                total += inverse[j, k] * length[k, lane] * np.conj(inverse[c, k])
            inverse_gram[centre, j, c] = total / (outer * scale[unknowns - n_w + c, lane])
    for a in range(n_z):
        for b in range(a, n_z):
            total_re = 0.0
            total_im = 0.0
            for i in range(n):
                total_re += re[unknowns + a, i, lane] * re[unknowns + b, i, lane] + im[unknowns + a, i, lane] * im[unknowns + b, i, lane]
                total_im += im[unknowns + a, i, lane] * re[unknowns + b, i, lane] - re[unknowns + a, i, lane] * im[unknowns + b, i, lane]
            residual_products[centre, a, b] = complex(total_re, total_im)
            residual_products[centre, b, a] = complex(total_re, -total_im)
