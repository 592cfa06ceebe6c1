"""A modal model at one pose, fitted to a frequency response matrix: Sec. 5.4.3.

Pairs of poles may be real as well (a rigid body under gravity), so a_0 may have either sign.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import optimize

from hil.errors import IdentificationError
from hil.identification.modal.pole_blocks import block_responses
from hil.identification.modal.weights import fit_variance
from hil.identification.result import FrequencyResponse

RELOCATIONS = 25  # of the starting poles; vector fitting settles in ten or so
STEPS = 40  # of Levenberg-Marquardt; from vector fitting or a neighbouring pose it takes a handful
RISES = 1  # orders beyond the best one that are tried before it is kept
STEP = 1e-5  # of a coefficient, for the slope of its pair's response: truncation and rounding balance there
START_DAMPING = 0.01  # of the starting poles: light, as Gustavsen and Semlyen (1999) advise


@dataclass(frozen=True)
class PoseModes:
    """Pairs of poles and their numerators at one pose.

    Attributes
    ----------
    a0, a1 : (K,) of s^2 + a_1 s + a_0, rising in a_0 where a fit starts afresh. pole_covariance : (2 K, 2 K) of [a0, a1].
    N0, N1 : (K, n_y, n_u). D : (n_y, n_u). numerator_covariance : (n_y, n_u, 2 K + 1, 2 K + 1) of [N0, N1, D] per element, poles as fitted.
    misfit : weighted sum of squares over its degrees of freedom, 1 for a model that leaves noise alone.
    criterion : n log(sum of squares / n) + parameters log(n), the BIC for an unknown scale of the noise: variances that are estimates
        themselves, and errors shared by neighbouring lines, do not tempt it to a larger model.
    """

    a0: np.ndarray
    a1: np.ndarray
    pole_covariance: np.ndarray
    N0: np.ndarray
    N1: np.ndarray
    D: np.ndarray
    numerator_covariance: np.ndarray
    misfit: float
    criterion: float


def fit_modes(response: FrequencyResponse, start: tuple[np.ndarray, np.ndarray]) -> PoseModes:
    """Fit by maximum likelihood with the element-wise variances, from starting pairs (a0, a1), whose order is kept.

    Numerators are solved for within (variable projection). The covariances given are those of the fit under the response's full
    covariance, not only its diagonal.
    """
    problem = _Problem(response)
    scale = np.sqrt(np.maximum(np.abs(start[0]), (2 * np.pi * response.frequencies_Hz[0] / 4) ** 2))
    K, fastest = len(scale), 2 * np.pi * response.sample_rate_Hz

    def poles(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return np.clip(x[:K] * scale**2, -(fastest**2), fastest**2), np.clip(x[K:] * scale, -fastest, fastest)

    unscale = np.concatenate((scale**2, scale))
    solved = optimize.least_squares(
        lambda x: problem.project(*poles(x))[0].ravel(),
        np.concatenate((start[0] / scale**2, start[1] / scale)),
        jac=lambda x: problem.jacobian(*poles(x)).reshape(-1, 2 * K) * unscale,
        method="lm",
        xtol=1e-8,
        ftol=1e-8,
        max_nfev=STEPS,
    )
    a0, a1 = poles(solved.x)
    remaining, coefficients, element_covariance = problem.project(a0, a1)
    bread = np.linalg.pinv(solved.jac.T @ solved.jac, hermitian=True)
    jacobian = solved.jac.reshape(*remaining.shape, 2 * K)
    covariance = bread @ problem.meat(jacobian) @ bread * unscale[:, None] * unscale
    parameters = 2 * K + coefficients.shape[2] * coefficients.shape[0] * coefficients.shape[1]
    square = float(np.sum(remaining**2))
    return PoseModes(
        a0=a0,
        a1=a1,
        pole_covariance=covariance,
        N0=np.moveaxis(coefficients[:, :, 0 : 2 * K : 2], 2, 0),
        N1=np.moveaxis(coefficients[:, :, 1 : 2 * K : 2], 2, 0),
        D=coefficients[:, :, -1],
        numerator_covariance=element_covariance,
        misfit=square / (remaining.size - parameters),
        criterion=remaining.size * float(np.log(square / remaining.size)) + parameters * float(np.log(remaining.size)),
    )


def choose_pairs(response: FrequencyResponse, largest: int = 10) -> PoseModes:
    """Fit models of rising order from scratch and return the first minimum of BIC.

    Raises
    ------
    IdentificationError
        Fewer lines than the smallest model has unknowns.
    """
    best = None
    for K in range(1, largest + 1):
        if len(response.lines) < 4 * K + 2:
            break
        found = fit_modes(response, start_pairs(response, K))
        if best is None or found.criterion < best.criterion:
            best = found
        elif len(found.a0) > len(best.a0) + RISES:
            break
    if best is None:
        raise IdentificationError(f"{len(response.lines)} lines are too few for a modal model")
    order = np.argsort(best.a0)
    both = np.concatenate((order, order + len(order)))
    numerators = np.concatenate((np.stack((2 * order, 2 * order + 1), axis=1).ravel(), [2 * len(order)]))
    return PoseModes(
        best.a0[order],
        best.a1[order],
        best.pole_covariance[np.ix_(both, both)],
        best.N0[order],
        best.N1[order],
        best.D,
        best.numerator_covariance[:, :, numerators][:, :, :, numerators],
        best.misfit,
        best.criterion,
    )


def start_pairs(response: FrequencyResponse, K: int) -> tuple[np.ndarray, np.ndarray]:
    """Find starting pairs (a0, a1) by vector fitting on the unit circle (Gustavsen and Semlyen 1999).

    The poles are spread over the band at first.
    """
    T = 1.0 / response.sample_rate_Hz
    f = response.frequencies_Hz
    z = np.exp(2j * np.pi * f * T)
    data = (response.G * z[:, None, None]).reshape(len(f), -1)
    weight = 1.0 / np.maximum(response.standard_deviation("noise").reshape(len(f), -1), 1e-3 * np.abs(data))
    omega = 2 * np.pi * np.geomspace(f[0], f[-1], K)
    poles = np.exp((-START_DAMPING + 1j) * omega * T)
    for _ in range(RELOCATIONS):
        basis = _partial_fractions(z, poles)
        rows = []
        for e in range(data.shape[1]):
            numerator = np.concatenate((basis, np.ones((len(z), 1))), axis=1)
            system = np.concatenate((numerator, -data[:, e : e + 1] * basis), axis=1) * weight[:, e : e + 1]
            target = data[:, e] * weight[:, e]
            triangle = np.asarray(np.linalg.qr(np.concatenate((_real(system), _real(target)[:, None]), axis=1), mode="r"))
            rows.append(triangle[numerator.shape[1] :, numerator.shape[1] :])
        stacked = np.concatenate(rows)
        sigma = np.linalg.lstsq(stacked[:, :-1], stacked[:, -1], rcond=None)[0]
        poles = _zeros_of(poles, sigma, K)
    s = np.log(poles.astype(complex)) / T
    return np.abs(s) ** 2, -2 * s.real


def _partial_fractions(z: np.ndarray, poles: np.ndarray) -> np.ndarray:
    """Return the real-coefficient basis of conjugate pairs: (L, 2 K)."""
    first, second = 1.0 / (z[:, None] - poles), 1.0 / (z[:, None] - np.conj(poles))
    return np.stack((first + second, 1j * (first - second)), axis=2).reshape(len(z), -1)


def _zeros_of(poles: np.ndarray, sigma: np.ndarray, K: int) -> np.ndarray:
    """Return the zeros of 1 + sum of sigma's partial fractions.

    They are the relocated poles, inside the unit circle, as K in the upper half plane.
    """
    A, b = np.zeros((2 * K, 2 * K)), np.zeros(2 * K)
    for k, p in enumerate(poles):
        A[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = [[p.real, p.imag], [-p.imag, p.real]]
        b[2 * k] = 2.0
    moved = np.linalg.eigvals(A - np.outer(b, sigma))
    moved = np.where(np.abs(moved) > 1.0, 1.0 / np.conj(moved), moved)
    upper = moved[moved.imag > 1e-9]
    real = np.sort(moved[np.abs(moved.imag) <= 1e-9].real)
    paired = [complex(np.clip(np.mean(real[i : i + 2]), 1e-3, 1 - 1e-6), 1e-3) for i in range(0, len(real) - 1, 2)]
    return np.concatenate((upper, paired))[:K] if paired else upper[:K]


def _real(values: np.ndarray) -> np.ndarray:
    return np.concatenate((values.real, values.imag))


class _Problem:
    """Weighted data of one pose; numerators are solved for given poles."""

    def __init__(self, response: FrequencyResponse) -> None:
        self.response = response
        self.n_y, self.n_u = response.G.shape[1:]
        self.weight = np.sqrt(2.0 / fit_variance(response)).transpose(1, 2, 0)  # (n_y, n_u, L), of the real and of the imaginary part
        self.data = response.G.transpose(1, 2, 0) * self.weight
        self.covariance = response.covariance("noise" if response.total_covariance is None else "total")
        self.z = np.exp(2j * np.pi * response.frequencies_Hz / response.sample_rate_Hz)
        self._last: tuple[tuple[bytes, bytes], tuple[np.ndarray, np.ndarray, np.ndarray]] | None = None

    def project(self, a0: np.ndarray, a1: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return residuals (n_y, n_u, 2 L), coefficients (n_y, n_u, 2 K + 1) and their covariance with the poles held."""
        Q, R, size = self._factors(a0, a1)
        target = np.concatenate((self.data.real, self.data.imag), axis=2)[..., None]
        along = np.swapaxes(Q, 2, 3) @ target
        inverse = np.linalg.inv(R)
        covariance = inverse @ np.swapaxes(inverse, 2, 3) / (size[:, None] * size)
        return (target - Q @ along)[..., 0], (inverse @ along)[..., 0] / size, covariance

    def jacobian(self, a0: np.ndarray, a1: np.ndarray) -> np.ndarray:
        """Return the residuals' slopes with the poles in Kaufman's form: (n_y, n_u, 2 L, 2 K).

        The basis moves; its own span is projected out.
        """
        Q, _, _ = self._factors(a0, a1)
        coefficients = self.project(a0, a1)[1]
        K = len(a0)
        columns = []
        for values, other_first in ((a0, False), (a1, True)):
            step = STEP * np.maximum(np.abs(values), np.sqrt(np.abs(a0)) if other_first else 0.0)
            arguments = [(a0, a1 + s * step) if other_first else (a0 + s * step, a1) for s in (1.0, -1.0)]
            up, down = (self._pairs(*argument) for argument in arguments)
            slope = (up - down) / (2.0 * step[:, None, None])  # (K, L, 2)
            for k in range(K):
                moved = coefficients[:, :, 2 * k : 2 * k + 2] @ slope[k].T * self.weight
                columns.append(np.concatenate((moved.real, moved.imag), axis=2))
        moved = np.stack(columns, axis=-1)
        slopes: np.ndarray = Q @ (np.swapaxes(Q, 2, 3) @ moved) - moved
        return slopes

    def _pairs(self, a0: np.ndarray, a1: np.ndarray) -> np.ndarray:
        return block_responses(np.stack((a0, a1), axis=-1), self.response.frequencies_Hz, self.response.sample_rate_Hz)

    def _factors(self, a0: np.ndarray, a1: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the QR of every element's weighted, scaled basis (n_y, n_u, 2 L, 2 K + 1); those of the last poles are kept."""
        key = (a0.tobytes(), a1.tobytes())
        if self._last is None or self._last[0] != key:
            basis = np.concatenate((np.moveaxis(self._pairs(a0, a1), 0, 1).reshape(len(self.z), -1), 1.0 / self.z[:, None]), axis=1)
            size = np.linalg.norm(basis, axis=0)
            weighted = (basis / size) * self.weight[..., None]
            self._last = (key, (*np.linalg.qr(np.concatenate((weighted.real, weighted.imag), axis=2)), size))
        return self._last[1]

    def meat(self, jacobian: np.ndarray) -> np.ndarray:
        """Return J^T V J with V the covariance of the weighted data under the response's full covariance."""
        L = len(self.z)
        n_y, n_u = self.n_y, self.n_u
        weighted = self.weight.transpose(2, 1, 0).reshape(L, n_y * n_u)
        V = self.covariance * weighted[:, :, None] * weighted[:, None, :] / 2.0  # circular: half in each part
        J = jacobian.transpose(2, 1, 0, 3).reshape(2 * L, n_u * n_y, -1)
        real, imaginary = J[:L], J[L:]
        both = np.einsum("lap,lab,lbq->pq", real, V.real, real) + np.einsum("lap,lab,lbq->pq", imaginary, V.real, imaginary)
        cross = np.einsum("lap,lab,lbq->pq", imaginary, V.imag, real)
        meat: np.ndarray = both + cross + cross.T
        return meat
