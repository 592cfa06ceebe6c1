"""One local model of frequency and scheduling parameters at many centres: from coordinates and orders to `LocalFits`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hil.errors import IdentificationError
from hil.identification.local.least_squares import LocalFits, local_fits
from hil.identification.local.monomials import symmetric_monomials

CENTRED = 1e-6  # offsets are scaled to 1: a mean below it counts as none


def local_regression(
    rows: np.ndarray,
    coordinates: np.ndarray,
    centre: np.ndarray,
    numerator: tuple[int, ...],
    denominator: tuple[int, ...],
    w: np.ndarray,
    z: np.ndarray,
    extra: np.ndarray | None = None,
    n_y: int | None = None,
) -> LocalFits:
    """Fit N and D of (4.39) as Taylor series in the coordinates round every centre.

    Parameters
    ----------
    rows : (B, n) rows of w and z in each window.
    coordinates : (B, n, i, 1 + m) offset of each row from the centre: line, scheduling parameters, of each of its images in the window.
    centre : (i, 1 + m) the centre's own.
    numerator, denominator : 1 + m orders each.
    w, z, extra, n_y : as in `hil.identification.local.least_squares.local_fits`.
    """
    over_rows, below = (symmetric_monomials(coordinates, centre, orders) for orders in (numerator, denominator))
    return fits_with_true_residuals(rows, over_rows, below, w, z, extra, n_y)


def fits_with_true_residuals(
    rows: np.ndarray,
    numerator: np.ndarray,
    denominator: np.ndarray,
    w: np.ndarray,
    z: np.ndarray,
    extra: np.ndarray | None = None,
    n_y: int | None = None,
) -> LocalFits:
    """Fit like `hil.identification.local.least_squares.local_fits`, with residuals that keep the noise at its own size.

    With a rational model the residual is D v, and D is one at the centre. A column psi z of the denominator whose psi has a mean over the
    window (a window to one side of its centre, Remark 4.2; any even order) correlates with z's own noise and models it as dynamics, which
    loses half the variance. Therefore the residuals alone are taken from a second fit of the same data with psi less its mean, so that D is
    one on average over the window.
    """
    fits = local_fits(rows, numerator, denominator, w, z, extra, n_y)
    mean = denominator.mean(axis=1, keepdims=True)
    if not (np.abs(mean) > CENTRED).any():
        return fits
    shared = len(denominator) == 1
    again = np.arange(len(rows)) if shared else np.flatnonzero((np.abs(mean) > CENTRED).any(axis=(1, 2)))

    def chosen(basis: np.ndarray) -> np.ndarray:
        return basis if len(basis) == 1 else basis[again]

    second = local_fits(
        rows[again],
        chosen(numerator),
        chosen(denominator - mean),
        w,
        z,
        None if extra is None else chosen(extra),
        n_y,
    )
    residual_products, dof = fits.residual_products.copy(), fits.dof.copy()
    residual_products[again], dof[again] = second.residual_products, second.dof
    return replace(fits, residual_products=residual_products, dof=dof)


def check_told(fits: LocalFits, frequencies_Hz: np.ndarray, input_names: Sequence[str]) -> None:
    """Raise IdentificationError where a window cannot separate an input's response from the other unknowns."""
    share = np.real(np.diagonal(fits.inverse_gram, axis1=1, axis2=2))  # (B, n_w), zero where a column depends on those before it
    lines, inputs = np.nonzero(~(share > 0.0))
    if len(lines):
        raise IdentificationError(
            f"the window round {frequencies_Hz[lines[0]]:.4g} Hz does not tell the response to {input_names[inputs[0]]} from the rest"
            f" ({len(set(lines))} of {len(frequencies_Hz)} lines): too little of it is excited, or inputs are excited alike;"
            " widen the window, lower the orders, or take a method for periodic excitations"
        )
