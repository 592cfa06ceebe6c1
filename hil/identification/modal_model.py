"""Parametric LPV modal model, Sec. 5.4: poles and numerators as smooth functions of a scheduling parameter, from responses over poses.

Pose by pose a modal model is fitted, each starting from its neighbour's, which keeps the modes apart by name. Each coefficient then gets
a polynomial in the pose, weighted by the covariance of its fits; its order is the one of least BIC. (5.31) and (5.32) are used with the
first rows [0 I] and [C_m 0].
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.polynomial import legendre
from scipy import special

from hil.identification.errors import IdentificationError
from hil.identification.modal_pose import PoseModes, choose_pairs, fit_modes, pair_responses
from hil.identification.result import FrequencyResponse

if TYPE_CHECKING:
    import control

HIGHEST_ORDER = 8  # of a polynomial over the poses, and one degree of freedom is left


@dataclass(frozen=True)
class PoseFunction:
    """Polynomials over the pose, of one family of coefficients.

    Attributes
    ----------
    coefficients : (order + 1, ...) of Legendre polynomials on the pose scaled to -1 ... 1.
    covariance : (order + 1, order + 1, ...) of them, scattering beyond their fits' covariances counted in.
    """

    coefficients: np.ndarray
    covariance: np.ndarray

    def __call__(self, x: float) -> np.ndarray:
        return legendre.legval(x, self.coefficients)

    def deviation(self, x: float) -> np.ndarray:
        """Standard deviation at x."""
        basis = legendre.legvander(np.array([x]), len(self.coefficients) - 1)[0]
        return np.sqrt(np.maximum(np.einsum("p,pq...,q->...", basis, self.covariance, basis), 0.0))


@dataclass(frozen=True)
class ModalFrfModel:
    """Omega(theta), Z(theta), B_m(theta), C_m(theta) of (5.35) as pairs s^2 + a_1 s + a_0 with numerators N_0 + N_1 s, and D.

    What the responses say, whatever the machine. The observer's model, with shapes of modes about a known chain of axes, is
    `controllers.models.modal.ModalModel`.

    Attributes
    ----------
    a0, a1 : functions to (K,). N0, N1 : to (K, n_y, n_u). D : to (n_y, n_u).
    pose_range : lowest and highest pose fitted. direction : which scheduling parameter of the responses.
    at_poses : the fits behind it, poses ascending.
    """

    a0: tuple[PoseFunction, ...]
    a1: tuple[PoseFunction, ...]
    N0: tuple[tuple[PoseFunction, ...], ...]
    N1: tuple[tuple[PoseFunction, ...], ...]
    D: tuple[PoseFunction, ...]
    pose_range: tuple[float, float]
    direction: int
    at_poses: tuple[PoseModes, ...]
    output_names: tuple[str, ...]
    input_names: tuple[str, ...]
    sample_rate_Hz: float

    def modes(self, pose: float, probability: float = 0.95) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Natural frequencies [Hz] and damping ratios (K,) with the half widths of their confidence intervals.

        NaN for a pair whose a_0 is not positive: it does not vibrate.
        """
        x = self._scaled(pose)
        a0, a1 = (np.array([f(x) for f in family]) for family in (self.a0, self.a1))
        d0, d1 = (np.array([f.deviation(x) for f in family]) for family in (self.a0, self.a1))
        omega = np.sqrt(np.where(a0 > 0.0, a0, np.nan))
        factor = special.ndtri(0.5 + probability / 2)
        zeta = a1 / (2 * omega)
        half_zeta = np.hypot(d1 / (2 * omega), zeta * d0 / (2 * omega**2))
        return omega / (2 * np.pi), zeta, factor * d0 / (4 * np.pi * omega), factor * half_zeta

    def state_space(self, pose: float) -> control.StateSpace:
        """Continuous model from the effort as applied to the outputs; a vibrating pair takes two states, others two per input."""
        import control  # takes half a second to load, and only this needs it

        a0, a1, N0, N1, D = self._values(pose)
        n_u = D.shape[1]
        blocks_A, blocks_B, blocks_C = [], [], []
        for k in range(len(a0)):
            left, b = _by_direction(N0[k], N1[k], vibrating=a0[k] > a1[k] ** 2 / 4)
            for r in range(len(b)):
                blocks_A.append(np.array([[0.0, 1.0], [-a0[k], -a1[k]]]))
                blocks_B.append(np.vstack((np.zeros(n_u), b[r])))
                blocks_C.append(left[:, :, r])
        A = np.zeros((2 * len(blocks_A), 2 * len(blocks_A)))
        for k, block in enumerate(blocks_A):
            A[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = block
        return control.ss(A, np.vstack(blocks_B), np.hstack(blocks_C), D, inputs=list(self.input_names), outputs=list(self.output_names))

    def response(self, pose: float, frequencies_Hz: np.ndarray) -> np.ndarray:
        """(L, n_y, n_u) sampled response from command to outputs, tick and hold included."""
        a0, a1, N0, N1, D = self._values(pose)
        pairs = pair_responses(a0, a1, frequencies_Hz, self.sample_rate_Hz)
        delay = np.exp(-2j * np.pi * frequencies_Hz / self.sample_rate_Hz)
        return np.einsum("kl,kij->lij", pairs[..., 0], N0) + np.einsum("kl,kij->lij", pairs[..., 1], N1) + delay[:, None, None] * D

    def is_stable(self, pose: float) -> bool:
        """All pairs damped and none repelled (gravity may repel a rigid body)."""
        a0, a1, *_ = self._values(pose)
        return bool(np.all(a0 > 0.0) and np.all(a1 > 0.0))

    def passive_modes(self, pose: float) -> np.ndarray:
        """(K, pairs of one axis's position and command) whether each mode's collocated numerator is not negative beyond its 95 % interval.

        Effort and speed at the same place exchange power with the machine one way only, so every mode's numerator is c b >= 0 there.
        """
        x = self._scaled(pose)
        collocated = [
            (i, j)
            for i, output in enumerate(self.output_names)
            for j, source in enumerate(self.input_names)
            if output.startswith("position_") and output.removeprefix("position_") == source.partition("_")[2]
        ]
        n_u = len(self.input_names)
        value = np.array([[family[i * n_u + j](x) for i, j in collocated] for family in self.N0])
        deviation = np.array([[family[i * n_u + j].deviation(x) for i, j in collocated] for family in self.N0])
        return value >= -special.ndtri(0.975) * deviation

    def _scaled(self, pose: float) -> float:
        low, high = self.pose_range
        x = 2.0 * (pose - low) / (high - low) - 1.0
        if abs(x) > 1.0 + 1e-9:
            raise IdentificationError(f"pose {pose:g} is outside {low:g} to {high:g}, over which the model was fitted")
        return x

    def _values(self, pose: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        x = self._scaled(pose)
        n_u = len(self.input_names)
        a0, a1 = (np.array([f(x) for f in family]) for family in (self.a0, self.a1))
        N0, N1 = (np.array([[f(x) for f in mode] for mode in family]).reshape(len(a0), -1, n_u) for family in (self.N0, self.N1))
        return a0, a1, N0, N1, np.array([f(x) for f in self.D]).reshape(-1, n_u)


def fit_modal_model(responses: Sequence[FrequencyResponse], direction: int) -> ModalFrfModel:
    """Fit the model to responses at poses along one scheduling parameter; the number of modes and every polynomial's order are chosen.

    Parameters
    ----------
    responses : with independent errors from line to line for the intervals to hold: BLA or robust local methods.
    direction : column of the poses that varies.

    Raises
    ------
    IdentificationError
        Fewer than three poses; too few lines.
    """
    if len(responses) < 3:
        raise IdentificationError(f"{len(responses)} poses: a model over the pose takes three or more")
    ordered = sorted(responses, key=lambda response: response.pose[direction])
    poses = np.array([response.pose[direction] for response in ordered])
    x = 2.0 * (poses - poses[0]) / (poses[-1] - poses[0]) - 1.0
    fits = _fit_along(ordered)
    K = len(fits[0].a0)
    n_y, n_u = fits[0].D.shape
    pole_variance = np.stack([np.diagonal(fit.pole_covariance) for fit in fits])
    numerator_variance = np.stack([np.diagonal(fit.numerator_covariance, axis1=2, axis2=3) for fit in fits])  # (poses, n_y, n_u, 2 K + 1)

    def over_poses(values: np.ndarray, variance: np.ndarray) -> PoseFunction:
        return smooth(x, values, variance)

    elements = [(i, j) for i in range(n_y) for j in range(n_u)]
    return ModalFrfModel(
        a0=tuple(over_poses(np.array([f.a0[k] for f in fits]), pole_variance[:, k]) for k in range(K)),
        a1=tuple(over_poses(np.array([f.a1[k] for f in fits]), pole_variance[:, K + k]) for k in range(K)),
        N0=tuple(
            tuple(over_poses(np.array([f.N0[k, i, j] for f in fits]), numerator_variance[:, i, j, 2 * k]) for i, j in elements)
            for k in range(K)
        ),
        N1=tuple(
            tuple(over_poses(np.array([f.N1[k, i, j] for f in fits]), numerator_variance[:, i, j, 2 * k + 1]) for i, j in elements)
            for k in range(K)
        ),
        D=tuple(over_poses(np.array([f.D[i, j] for f in fits]), numerator_variance[:, i, j, -1]) for i, j in elements),
        pose_range=(float(poses[0]), float(poses[-1])),
        direction=direction,
        at_poses=tuple(fits),
        output_names=ordered[0].output_names,
        input_names=ordered[0].input_names,
        sample_rate_Hz=ordered[0].sample_rate_Hz,
    )


def smooth(x: np.ndarray, values: np.ndarray, variance: np.ndarray) -> PoseFunction:
    """Polynomial through values with known variances; order of least BIC, covariance widened where they scatter by more than they say."""
    weight = 1.0 / np.sqrt(np.maximum(variance, 1e-24 * np.max(values**2) + np.finfo(float).tiny))
    best: tuple[float, PoseFunction] | None = None
    for order in range(min(HIGHEST_ORDER, len(x) - 2) + 1):
        basis = legendre.legvander(x, order)
        solution = np.linalg.lstsq(basis * weight[:, None], values * weight, rcond=None)[0]
        square = float(np.sum(((values - basis @ solution) * weight) ** 2))
        left = len(x) - order - 1
        criterion = square + (order + 1) * float(np.log(len(x)))
        if best is None or criterion < best[0]:
            covariance = np.linalg.inv(basis.T @ (basis * weight[:, None] ** 2)) * max(1.0, square / max(left, 1))
            best = (criterion, PoseFunction(solution, covariance))
    assert best is not None
    return best[1]


def _fit_along(ordered: Sequence[FrequencyResponse]) -> list[PoseModes]:
    """Fits from the middle pose outwards, each from its neighbour's poles."""
    middle = len(ordered) // 2
    fits: dict[int, PoseModes] = {middle: choose_pairs(ordered[middle])}
    for index in (*range(middle + 1, len(ordered)), *range(middle - 1, -1, -1)):
        inner, further = (index - 1, index - 2) if index > middle else (index + 1, index + 2)
        near = fits[inner]
        a0, a1 = near.a0, near.a1
        if further in fits:  # a mode that moves goes on moving
            a0 = np.where(near.a0 * fits[further].a0 > 0.0, near.a0**2 / np.where(fits[further].a0 == 0.0, 1.0, fits[further].a0), near.a0)
        tried = [fit_modes(ordered[index], start) for start in ((a0, a1), (near.a0, near.a1))[: 1 + (further in fits)]]
        fits[index] = min(tried, key=lambda fit: fit.criterion)
    return [fits[index] for index in range(len(ordered))]


def _by_direction(N0: np.ndarray, N1: np.ndarray, *, vibrating: bool) -> tuple[np.ndarray, np.ndarray]:
    """C (n_y, 2, r) and B (r, n_u) of a pair: one direction for a vibrating mode, as many as inputs otherwise."""
    n_y, n_u = N0.shape
    if not vibrating:
        return np.stack((N0, N1), axis=1), np.eye(n_u)
    scale = np.linalg.norm(N0) / max(float(np.linalg.norm(N1)), np.finfo(float).tiny)
    left, singular, right = np.linalg.svd(np.vstack((N0, N1 * scale)), full_matrices=False)
    C = left[:, :1] * singular[0]
    return np.stack((C[:n_y], C[n_y:] / scale), axis=1), right[:1]
