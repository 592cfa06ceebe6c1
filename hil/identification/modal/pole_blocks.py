"""Poles as blocks: the denominator of one mode, or of all that lies below or above the band, and its sampled response.

With a_0 = omega^2 and a_1 = 2 zeta omega of (5.30) the response from command to the sampled outputs is

    G(z) = z^-1 ZOH{ sum_k (N_0k + N_1k s) / (s^2 + a_1k s + a_0k) + D }.

For a position N_0 = c b^T and N_1 = 0; for an acceleration (5.32) N_0 = -omega^2 c_a b^T, N_1 = -2 zeta omega c_a b^T and D = c_a b^T.
N_1 of a position takes what is not proportional damping.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import linalg

from hil.identification.modal.pose_basis import over_poses

FASTEST = 10.0  # of the sample rate: a pole beyond it is a constant to the samples, and its exponential overflows


@dataclass(frozen=True)
class Block:
    """Denominator of some poles over the poses.

    Attributes
    ----------
    scale : [rad/s] that makes the coefficients comparable: with p = s / scale the denominator is p^n + c_(n-1) p^(n-1) + ... + c_0, or,
        where `flexible`, 1 + c_1 p + ... + c_n p^n.
    coefficients : n arrays (order + 1,) of the pose's polynomials (`pose_basis`); c_0 ... c_(n-1), or c_1 ... c_n.
    flexible : which form. Where masses move and springs stay, 1 / omega^2 of a mode is a smoother function of the pose than omega^2.
    is_mode : a vibrating mode in the band; otherwise poles outside it.
    """

    scale: float
    coefficients: tuple[np.ndarray, ...]
    flexible: bool
    is_mode: bool

    @property
    def order(self) -> int:
        """Order of the denominator in s."""
        return len(self.coefficients)

    def values(self, x: np.ndarray) -> np.ndarray:
        """Return the scaled coefficients at poses x (poses, axes): (poses, n)."""
        return np.stack([over_poses(x, len(c)) @ c for c in self.coefficients], axis=-1)

    def is_usable(self, x: np.ndarray, sample_rate_Hz: float) -> bool:
        """Tell whether at every pose no pole is far faster than the sample rate and no mode has omega^2 below zero."""
        values = self.values(x)
        if self.is_mode and not (values[:, -1 if self.flexible else 0] > 0.0).all():
            return False
        speed = np.abs(self.monic(values)[0]) ** (1.0 / (self.order - np.arange(self.order)))
        return bool((speed < FASTEST * 2 * np.pi * sample_rate_Hz).all())

    def monic(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return c_0 ... c_(n-1) of s^n + ... (..., n) for scaled coefficients, and the divisor (...) of the numerator."""
        powers = self.scale ** (self.order - np.arange(self.order))
        if not self.flexible:
            return values * powers, np.ones(values.shape[:-1])
        leading = values[..., -1:]
        below = np.concatenate((np.ones_like(leading), values[..., :-1]), axis=-1)
        return below / leading * powers, leading[..., 0] / self.scale**self.order

    def numerator_scale(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return factors (n,) and divisors (...) that turn scaled numerator coefficients into those of s^i over the monic denominator.

        As scaled, numerators are of (s / scale)^i over the denominator as scaled.
        """
        size = (1.0 if self.flexible else self.scale**self.order) / self.scale ** np.arange(self.order)
        return size, self.monic(values)[1]

    def responses(self, values: np.ndarray, frequencies_Hz: np.ndarray, sample_rate_Hz: float) -> np.ndarray:
        """Return sampled responses (..., L, n) of the scaled numerators for coefficients `values` (..., n)."""
        c, _ = self.monic(values)
        size, divisor = self.numerator_scale(values)
        sampled: np.ndarray = block_responses(c, frequencies_Hz, sample_rate_Hz) * size / divisor[..., None, None]
        return sampled


def block_responses(denominators: np.ndarray, frequencies_Hz: np.ndarray, sample_rate_Hz: float) -> np.ndarray:
    """Return sampled responses z^-1 ZOH{s^i / (s^n + ...)} of denominators (..., n): (..., L, n)."""
    n = denominators.shape[-1]
    A = np.zeros((*denominators.shape[:-1], n + 1, n + 1))
    A[..., np.arange(n - 1), np.arange(1, n)] = 1.0
    A[..., n - 1, :n] = -denominators
    A[..., n - 1, n] = 1.0
    step = linalg.expm(A / sample_rate_Hz)
    F, g = step[..., None, :n, :n], step[..., None, :n, n:]
    z = np.exp(2j * np.pi * frequencies_Hz / sample_rate_Hz)[:, None, None]
    return np.linalg.solve(z * np.eye(n) - F, np.broadcast_to(g, (*denominators.shape[:-1], len(z), n, 1)))[..., 0] / z[..., 0]
