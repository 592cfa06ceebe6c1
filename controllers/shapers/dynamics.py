"""The plant of a shaper: one linear path from reference to output, continuous or sampled, described in the s plane.

A sampled system is evaluated at z = exp(s h), so a delay of k samples is exp(-s k h) and one set of equations serves both.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.linalg
import scipy.signal

from controllers.errors import DesignError

INFINITE_ZERO = 1e7
"""Generalised eigenvalues beyond this multiple of the largest pole stem from the relative degree and are no zeros."""

FORGOTTEN = 1e-9
"""A sampled pole with |z| below this is a delay: it decays within a sample and has no place in the s plane."""


@dataclass(frozen=True)
class Mode:
    """A pole of the upper half plane (or a real one) and its share in the step response.

    Attributes
    ----------
    pole : complex, rad/s
    step_share : size of its term in the unit step response at the start, |2 residue / pole| (once for a real pole).
    """

    pole: complex
    step_share: float

    @property
    def frequency_rad_s(self) -> float:
        """Natural frequency |pole| [rad/s]."""
        return abs(self.pole)

    @property
    def damping(self) -> float:
        """Damping ratio, 1 for a real pole."""
        return -self.pole.real / abs(self.pole)


@dataclass(frozen=True)
class Dynamics:
    """A state space from one input to one output.

    Attributes
    ----------
    a, b, c : arrays (n, n), (n,), (n,)
    d : float
    sample_period_s : float or None
        None: continuous time.
    """

    a: np.ndarray
    b: np.ndarray
    c: np.ndarray
    d: float
    sample_period_s: float | None = None

    @classmethod
    def from_polynomials(
        cls, numerator: np.ndarray | Sequence[float], denominator: np.ndarray | Sequence[float], sample_period_s: float | None = None
    ) -> Dynamics:
        """Make a system from a transfer function's coefficients, highest power first (of z for a sampled system).

        Raises
        ------
        DesignError
            There are more zeros than poles, so the system is not causal.
        """
        numerator, denominator = (np.trim_zeros(np.asarray(part, dtype=float), "f") for part in (numerator, denominator))
        if len(numerator) > len(denominator):
            raise DesignError(f"{len(numerator) - 1} zeros and {len(denominator) - 1} poles: a system has at least as many poles as zeros")
        if len(denominator) == 1:
            return cls(np.zeros((0, 0)), np.zeros(0), np.zeros(0), float(numerator[0] / denominator[0]), sample_period_s)
        a, b, c, d = scipy.signal.tf2ss(numerator, denominator)
        return cls(a, b[:, 0], c[0], float(d[0, 0]), sample_period_s)

    @classmethod
    def from_modes(cls, modes: Sequence[tuple[float, float, float]]) -> Dynamics:
        """Make the sum of gain w^2 / (s^2 + 2 zeta w s + w^2) over (w [rad/s], zeta, gain): an identified modal model at one pose."""
        blocks = [np.array([[0.0, 1.0], [-(w**2), -2.0 * zeta * w]]) for w, zeta, _ in modes]
        entering = np.concatenate([[0.0, gain * w**2] for w, _, gain in modes])
        return cls(scipy.linalg.block_diag(*blocks), entering, np.tile([1.0, 0.0], len(modes)), 0.0)

    def sampled(self, sample_period_s: float) -> Dynamics:
        """Return the same system sampled, for a reference held from sample to sample."""
        held = (self.a, self.b[:, None], self.c[None, :], np.array([[self.d]]))
        a, b, c, d, _ = scipy.signal.cont2discrete(held, sample_period_s)
        return Dynamics(a, b[:, 0], c[0], float(d[0, 0]), sample_period_s)

    def scaled(self, gain: float) -> Dynamics:
        """Return the same system with its output multiplied by `gain`."""
        return Dynamics(self.a, self.b, gain * self.c, gain * self.d, self.sample_period_s)

    def after(self, first: Dynamics) -> Dynamics:
        """Return `first` and this system in series."""
        a = np.block([[first.a, np.zeros((len(first.a), len(self.a)))], [np.outer(self.b, first.c), self.a]])
        b = np.concatenate([first.b, self.b * first.d])
        return Dynamics(a, b, np.concatenate([self.d * first.c, self.c]), self.d * first.d, self.sample_period_s)

    def variable(self, s: np.ndarray) -> np.ndarray:
        """Return s itself, or z = exp(s h) for a sampled system."""
        return s if self.sample_period_s is None else np.exp(s * self.sample_period_s)

    def response(self, s: np.ndarray | complex) -> np.ndarray:
        """Return the transfer function at complex s, same shape."""
        return self._solved(np.asarray(s, dtype=complex))[0]

    def slope(self, s: np.ndarray | complex) -> np.ndarray:
        """Return the derivative dP/ds at complex s, same shape."""
        return self._solved(np.asarray(s, dtype=complex))[1]

    def _solved(self, s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        at = self.variable(s)
        resolvent = at.reshape(-1, 1, 1) * np.eye(len(self.a)) - self.a
        entered = np.linalg.solve(resolvent, np.broadcast_to(self.b.astype(complex)[:, None], (at.size, len(self.b), 1)))
        twice = np.linalg.solve(resolvent, entered)
        inner = 1.0 if self.sample_period_s is None else self.sample_period_s * at
        return (entered[..., 0] @ self.c + self.d).reshape(s.shape), (-(twice[..., 0] @ self.c).reshape(s.shape)) * inner

    @cached_property
    def poles(self) -> np.ndarray:
        """All poles in the s plane [rad/s], without a sampled system's pure delays."""
        return self._in_s(np.linalg.eigvals(self.a))

    @cached_property
    def zeros(self) -> np.ndarray:
        """Finite zeros, of s or (sampled) of z."""
        n = len(self.a)
        pencil = np.block([[self.a, self.b[:, None]], [self.c[None, :], np.array([[self.d]])]])
        mass = np.diag(np.concatenate([np.ones(n), [0.0]]))
        alpha, beta = scipy.linalg.eigvals(pencil, mass, homogeneous_eigvals=True)
        scale = np.abs(np.linalg.eigvals(self.a)).max(initial=1.0)
        finite = np.abs(beta) * INFINITE_ZERO * scale > np.abs(alpha)
        zeros: np.ndarray = alpha[finite] / beta[finite]
        return zeros

    @cached_property
    def residues(self) -> tuple[np.ndarray, np.ndarray]:
        """Eigenvalues (n,) and their residues (n,), by left and right eigenvectors.

        A chain of delays has a single one for all its poles at 0: of those the residues are none.
        """
        values, left, right = scipy.linalg.eig(self.a, left=True, right=True)
        with np.errstate(divide="ignore", invalid="ignore"):
            residues = (self.c @ right) * (left.conj().T @ self.b) / np.einsum("ij,ij->j", left.conj(), right)
        return values, residues

    @cached_property
    def modes(self) -> tuple[Mode, ...]:
        """Poles with a non-negative imaginary part, largest share of the step response first. Poles are assumed to be distinct."""
        if not len(self.a):
            return ()
        values, residues = self.residues
        distance = values if self.sample_period_s is None else values - 1.0
        seen = np.abs(values) > (0.0 if self.sample_period_s is None else FORGOTTEN)
        found = []
        for value, residue, away in zip(values[seen], residues[seen], distance[seen], strict=True):
            if value.imag < 0.0:
                continue
            pole = complex(self._in_s(np.array([value]))[0])
            share = abs(residue) / max(abs(away), np.finfo(float).tiny)
            found.append(Mode(pole, float(share) * (2.0 if value.imag > 0.0 else 1.0)))
        return tuple(sorted(found, key=lambda mode: -mode.step_share))

    def check_stable(self) -> None:
        """Raise DesignError for a pole on or right of the imaginary axis: no shaper removes a growing motion."""
        unstable = self.poles[self.poles.real >= 0.0]
        if unstable.size:
            worst = unstable[np.argmax(unstable.real)]
            raise DesignError(f"the plant is not stable (pole at {worst:.4g} rad/s), so no shaper settles it; close a loop around it first")

    def _in_s(self, values: np.ndarray) -> np.ndarray:
        if self.sample_period_s is None:
            return values.astype(complex)
        mapped: np.ndarray = np.log(values[np.abs(values) > FORGOTTEN].astype(complex)) / self.sample_period_s
        return mapped
