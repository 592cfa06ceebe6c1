"""Covariances of frequency response matrices: from closed-loop outputs to the plant, nonlinear from total, bounds from degrees of freedom.

vec(.) stacks columns: element (i, j) of an n_y x n_u matrix has index j n_y + i.
"""

from __future__ import annotations

import numpy as np
from scipy import special


def plant_covariance(G: np.ndarray, inputs: np.ndarray, covariance_z: np.ndarray) -> np.ndarray:
    """Return the covariance of vec(G) from that of the columns of the averaged closed-loop outputs, (3.18).

    Parameters
    ----------
    G : (L, n_y, n_u) frequency response.
    inputs : (L, n_u, n_u) averaged input matrix U_c; one column per experiment.
    covariance_z : (L, n_z, n_z) of one column of the averaged [Y; U], or (L, n_y, n_y) where the inputs are known exactly.

    Returns
    -------
    (L, n_y n_u, n_y n_u) Hermitian.
    """
    inverse = np.linalg.inv(inputs)
    return kronecker(np.conj(_hermitian(inverse) @ inverse), output_covariance(G, covariance_z))


def output_covariance(G: np.ndarray, covariance_z: np.ndarray) -> np.ndarray:
    """Return Q C_z Q^H with Q = [I, -G] of (3.18), the covariance of y - G u; (L, n_y, n_y) passes through."""
    n_y = G.shape[1]
    if covariance_z.shape[-1] == n_y:
        return covariance_z
    Q = np.concatenate((np.broadcast_to(np.eye(n_y), (len(G), n_y, n_y)), -G), axis=2)
    of_outputs: np.ndarray = Q @ covariance_z @ _hermitian(Q)
    return of_outputs


def kronecker(A: np.ndarray, B: np.ndarray) -> np.ndarray:
    """Return the Kronecker product of stacks: (L, a, a), (L, b, b) to (L, a b, a b)."""
    product = A[:, :, None, :, None] * B[:, None, :, None, :]
    size = A.shape[1] * B.shape[1]
    stacked: np.ndarray = product.reshape(len(A), size, size)
    return stacked


def nonlinear_covariance(total: np.ndarray, noise: np.ndarray, realisations: int) -> np.ndarray:
    """Return the covariance of the stochastic nonlinear distortion of one realisation, (3.20) times M.

    (3.20) as printed belongs to the mean over M realisations. Variances are clipped at zero element by element; a covariance
    between two elements is kept only where both variances are positive, and bounded by them.
    """
    difference = realisations * (total - noise)
    variance = np.maximum(np.real(np.diagonal(difference, axis1=1, axis2=2)), 0.0)
    bound = np.sqrt(variance[:, :, None] * variance[:, None, :])
    magnitude = np.abs(difference)
    shrunk: np.ndarray = difference * np.minimum(1.0, np.divide(bound, magnitude, out=np.zeros_like(bound), where=magnitude > 0.0))
    diagonal = np.arange(variance.shape[1])
    shrunk[:, diagonal, diagonal] = variance
    return shrunk


def variances(covariance: np.ndarray, n_y: int, n_u: int) -> np.ndarray:
    """Return the diagonal of a covariance of vec(G) as a matrix like G: (L, n_y n_u, n_y n_u) to (L, n_y, n_u)."""
    diagonal = np.real(np.diagonal(covariance, axis1=1, axis2=2))
    return diagonal.reshape(-1, n_u, n_y).transpose(0, 2, 1)


def circle_factor(dof: np.ndarray | float, probability: float) -> np.ndarray:
    """Return the radius of the confidence circle of a complex value in units of its estimated standard deviation.

    |error|^2 / variance is F(2, 2 dof) for a circular complex error and a variance estimated with `dof` complex degrees of freedom.
    """
    dof = np.asarray(dof, float)
    known = np.sqrt(-np.log1p(-probability))
    safe = np.where(np.isfinite(dof), np.maximum(dof, 1e-9), 1.0)
    factor: np.ndarray = np.where(np.isfinite(dof), np.sqrt(special.fdtri(2, 2 * safe, probability)), known)
    return factor


def hotelling_bound(size: int, dof: np.ndarray | float, probability: float) -> np.ndarray:
    """Return Hotelling's T^2 bound on e^H C^-1 e for a complex error vector of `size`.

    C is an estimated covariance with `dof` degrees of freedom.

    NaN where dof < size: such a covariance has no inverse.
    """
    dof = np.asarray(dof, float)
    left = dof - size + 1
    usable = left > 0
    value = dof * size / np.where(usable, left, 1.0) * special.fdtri(2 * size, 2 * np.where(usable, left, 1.0), probability)
    return np.where(usable, value, np.nan)


def _hermitian(matrices: np.ndarray) -> np.ndarray:
    transposed: np.ndarray = np.conj(np.swapaxes(matrices, -1, -2))
    return transposed
