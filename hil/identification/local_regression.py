"""One local model of frequency and scheduling parameters at many centres: from coordinates and orders to `LocalFits`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hil.identification.errors import IdentificationError
from hil.identification.local_fit import LocalFits, local_fits
from hil.identification.poses import monomials

CENTRED = 1e-6  # of the window's half width: a mean offset below it counts as none


def local_regression(
    rows: np.ndarray,
    coordinates: np.ndarray,
    numerator: tuple[int, ...],
    denominator: tuple[int, ...],
    w: np.ndarray,
    z: np.ndarray,
    extra: np.ndarray | None = None,
) -> LocalFits:
    """Fit N and D of (4.39) as Taylor series in the coordinates round every centre.

    With a rational model the residual is D v. Over a window that lies to one side of its centre D, which is one at the centre,
    takes noise for dynamics and shrinks the residual (a factor of two in variance at the ends of the band, Remark 4.2). The residuals, and
    they alone, are therefore taken from a second fit of the same data whose D is one at the window's mean.

    Parameters
    ----------
    rows : (B, n) rows of w and z in each window.
    coordinates : (B, n, 1 + m) offset of each row from the centre: line, scheduling parameters.
    numerator, denominator : 1 + m orders each.
    w, z, extra : as in `hil.identification.local_fit.local_fits`.
    """
    fits = local_fits(rows, monomials(coordinates, numerator), monomials(coordinates, denominator), w, z, extra)
    if not any(denominator):
        return fits
    mean = coordinates.mean(axis=1, keepdims=True)
    lopsided = np.flatnonzero((np.abs(mean) > CENTRED).any(axis=(1, 2)))
    if len(lopsided) == 0:
        return fits
    centred = coordinates[lopsided] - mean[lopsided]
    second = local_fits(
        rows[lopsided],
        monomials(centred, numerator),
        monomials(centred, denominator),
        w,
        z,
        None if extra is None else extra[lopsided],
    )
    residual_products, dof = fits.residual_products.copy(), fits.dof.copy()
    residual_products[lopsided], dof[lopsided] = second.residual_products, second.dof
    return replace(fits, residual_products=residual_products, dof=dof)


def check_told(fits: LocalFits, frequencies_Hz: np.ndarray, input_names: Sequence[str]) -> None:
    """Raise IdentificationError where a window does not tell an input's response from the other unknowns."""
    share = np.real(np.diagonal(fits.inverse_gram, axis1=1, axis2=2))  # (B, n_w), nought where a column depends on those before it
    lines, inputs = np.nonzero(~(share > 0.0))
    if len(lines):
        raise IdentificationError(
            f"the window round {frequencies_Hz[lines[0]]:.4g} Hz does not tell the response to {input_names[inputs[0]]} from the rest"
            f" ({len(set(lines))} of {len(frequencies_Hz)} lines): too little of it is excited, or inputs are excited alike;"
            " widen the window, lower the orders, or take a method for periodic excitations"
        )
