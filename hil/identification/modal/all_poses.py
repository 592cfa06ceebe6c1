"""All poses of a modal model fitted together: denominators and numerators as polynomials of the pose, maximum likelihood.

In a fit pose by pose, the numerators of poles that are close together or barely visible are poorly known one by one, but well in their sum.
Smoothing them one by one loses the sum, and with it the response away from resonances. The joint fit keeps the sum.

Numerators enter linearly and are eliminated (variable projection, Kaufman's slopes). Every pose's equations are first reduced by QR to as
many as it has unknowns, so that the polynomials are solved for from few rows.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import linalg

from hil.errors import IdentificationError
from hil.identification.modal.pole_blocks import Block
from hil.identification.modal.pose_basis import over_poses, whole_degrees
from hil.identification.modal.weights import fit_variance
from hil.identification.result import FrequencyResponse

STEPS = 40  # of Levenberg-Marquardt
SETTLED = 1e-5  # share of the sum of squares by which it falls at the last step
STEP = 1e-5  # of a coefficient, for the slope of its block's response: truncation and rounding balance there
DAMPING = 1e-4  # of the first step; by which factors it moves, and where it is given up
SOFTER, HARDER, STIFFEST = 0.2, 8.0, 1e9


@dataclass(frozen=True)
class JointFit:
    """Blocks, numerators and the misfit of a joint fit.

    Attributes
    ----------
    blocks : denominators. pole_covariance : of their coefficients in order, as scaled.
    numerators : per element of G (rows first) the (order + 1, S + 1) polynomials of the S numerator coefficients, block by block from s^0
        up, and of D. numerator_covariance : per element, of the flattened polynomials, poles held.
    misfit : weighted sum of squares over its degrees of freedom, 1 for a model that leaves noise alone.
    """

    blocks: tuple[Block, ...]
    pole_covariance: np.ndarray
    numerators: tuple[np.ndarray, ...]
    numerator_covariance: tuple[np.ndarray, ...]
    misfit: float


class JointProblem:
    """Weighted responses of all poses x (poses, axes), at the same lines; numerators are solved for given denominators."""

    def __init__(self, responses: Sequence[FrequencyResponse], x: np.ndarray) -> None:
        first = responses[0]
        self.x, self.frequencies_Hz, self.sample_rate_Hz = x, first.frequencies_Hz, first.sample_rate_Hz
        n_y, n_u = first.G.shape[1:]
        self.elements = n_y * n_u
        self.shape = (n_y, n_u)
        variance = np.stack([fit_variance(response) for response in responses])
        G = np.stack([response.G for response in responses])
        self.weight = _by_element(np.sqrt(2.0 / variance))  # (poses, elements, L), of the real and of the imaginary part
        self.data = _real(_by_element(G) * self.weight)  # (poses, elements, 2 L)
        self.covariance = np.stack([r.covariance("noise" if r.total_covariance is None else "total") for r in responses])
        self.equations = self.data.size

    def fit(self, blocks: Sequence[Block], numerator_orders: Sequence[int]) -> JointState:
        """Run Levenberg-Marquardt from starting denominators, whose orders are kept; numerator orders are given per element.

        Raises
        ------
        IdentificationError
            The starting denominators have, at some pose, a pole that is no mode or is far faster than the sample rate.
        """
        self._require_usable(blocks)
        state, damping = JointState(self, tuple(blocks), tuple(numerator_orders)), DAMPING
        for _ in range(STEPS):
            gram, gradient = state.normal_equations()
            size = np.sqrt(np.diagonal(gram))
            size[size == 0.0] = 1.0
            scaled = gram / size[:, None] / size
            fallen = 0.0
            while damping < STIFFEST:
                move = np.linalg.lstsq(scaled + damping * np.eye(len(gram)), gradient / size, rcond=None)[0] / size
                trial = JointState(self, _moved(state.blocks, move), state.orders)
                fallen = state.square - trial.square
                if fallen > 0.0:
                    state, damping = trial, damping * SOFTER
                    break
                damping *= HARDER
            if not fallen > SETTLED * state.square:
                break
        return state

    def numerator_orders(self, blocks: Sequence[Block], highest: int) -> tuple[int, ...]:
        """Return the order of least BIC for every element's numerators, denominators held."""
        self._require_usable(blocks)
        found = []
        orders = whole_degrees(self.x.shape[1], highest)
        by_order = [JointState(self, tuple(blocks), (order,) * self.elements) for order in orders]
        rows = self.equations // self.elements
        columns = 1 + sum(block.order for block in blocks)
        for e in range(self.elements):
            criteria = [
                rows * np.log(s.squares[e] / rows) + (p + 1) * columns * np.log(rows) for p, s in zip(orders, by_order, strict=True)
            ]
            found.append(orders[int(np.argmin(criteria))])
        return tuple(found)

    def _require_usable(self, blocks: Sequence[Block]) -> None:
        for block in blocks:
            if not block.is_usable(self.x, self.sample_rate_Hz):
                order = max(len(c) for c in block.coefficients) - 1
                raise IdentificationError(
                    f"the poles near {block.scale / (2.0 * np.pi):.3g} Hz are not followed over the poses by polynomials of order {order}:"
                    " at a pose they are no vibrating mode, or far faster than the sample rate; take more poses"
                )

    def basis(self, blocks: Sequence[Block]) -> np.ndarray:
        """Return the sampled responses of every numerator coefficient, and of D last: (poses, L, S + 1)."""
        parts = [block.responses(block.values(self.x), self.frequencies_Hz, self.sample_rate_Hz) for block in blocks]
        tick = np.exp(-2j * np.pi * self.frequencies_Hz / self.sample_rate_Hz)
        return np.concatenate((*parts, np.broadcast_to(tick[:, None], (len(self.x), len(tick), 1))), axis=2)


class JointState:
    """Denominators with the numerators that fit best."""

    def __init__(self, problem: JointProblem, blocks: tuple[Block, ...], orders: tuple[int, ...]) -> None:
        self.problem, self.blocks, self.orders = problem, blocks, orders
        self.square = np.inf
        if not all(block.is_usable(problem.x, problem.sample_rate_Hz) for block in blocks):
            return
        basis = problem.basis(blocks)
        self.columns = _real(basis[:, None].swapaxes(2, 3) * problem.weight[:, :, None]).swapaxes(2, 3)  # (poses, elements, 2 L, S + 1)
        R = np.asarray(np.linalg.qr(np.concatenate((self.columns, problem.data[..., None]), axis=3), mode="r"))
        S1 = self.columns.shape[3]
        self.squares = np.sum(R[:, :, S1, S1] ** 2, axis=0)
        self.numerators = []
        for e, order in enumerate(orders):
            K, target = _by_products(R[:, e, :S1, :S1], problem.x, order), R[:, e, :S1, S1].ravel()
            size = np.linalg.norm(K, axis=0)
            solution = linalg.lstsq(K / size, target, lapack_driver="gelsy", check_finite=False)[0] / size
            self.squares[e] += np.sum((target - K @ solution) ** 2)
            self.numerators.append(solution.reshape(order + 1, S1))
        self.square = float(self.squares.sum())

    def normal_equations(self) -> tuple[np.ndarray, np.ndarray]:
        """Return J^T J and J^T residual over the denominators' coefficients, numerators eliminated."""
        gram: np.ndarray = np.zeros(0)
        gradient: np.ndarray = np.zeros(0)
        for e, (R, S1) in enumerate(self._reduced()):
            Q, J = self._split(R[..., :-1], S1, e)
            target = R[..., -1].ravel()
            left = target - Q @ (Q.T @ target)
            gram, gradient = (J.T @ J, J.T @ left) if e == 0 else (gram + J.T @ J, gradient + J.T @ left)
        return gram, gradient

    @property
    def parameters(self) -> int:
        """Return how many numbers are fitted."""
        count: int = sum(len(c) for block in self.blocks for c in block.coefficients) + sum(n.size for n in self.numerators)
        return count

    @property
    def criterion(self) -> float:
        """Return the BIC for an unknown scale of the noise."""
        rows = self.problem.equations
        return rows * float(np.log(self.square / rows)) + self.parameters * float(np.log(rows))

    def result(self) -> JointFit:
        """Return the fit with its covariances."""
        problem = self.problem
        moved = self._moved_columns()
        slopes = [self._full_slopes(moved[:, e], e) for e in range(problem.elements)]
        gram = np.sum([J.T @ J for J in slopes], axis=0)
        size = np.sqrt(np.maximum(np.diagonal(gram), np.finfo(float).tiny))
        bread = np.linalg.pinv(gram / size[:, None] / size, hermitian=True) / size[:, None] / size
        misfit = self.square / (problem.equations - self.parameters)
        spread = max(1.0, misfit)
        covariances = []
        for e, order in enumerate(self.orders):
            R = np.asarray(np.linalg.qr(self.columns[:, e], mode="r"))
            inverse = np.linalg.pinv(_by_products(R, problem.x, order))
            covariances.append(inverse @ inverse.T * spread)
        return JointFit(
            blocks=self.blocks,
            pole_covariance=bread @ _meat(problem, slopes) @ bread * spread,
            numerators=tuple(self.numerators),
            numerator_covariance=tuple(covariances),
            misfit=misfit,
        )

    def _reduced(self) -> Iterator[tuple[np.ndarray, int]]:
        """Yield per element the triangular factor (poses, rows, S + 1 + S + 1) of [basis, its slopes, data], and S + 1."""
        moved = self._moved_columns()
        every = np.concatenate((self.columns, moved, self.problem.data[..., None]), axis=3)
        R = np.asarray(np.linalg.qr(every, mode="r"))
        for e in range(self.problem.elements):
            yield R[:, e], self.columns.shape[3]

    def _split(self, R: np.ndarray, S1: int, e: int) -> tuple[np.ndarray, np.ndarray]:
        """Return an orthonormal basis of the numerators' span, and the denominators' slopes orthogonal to it."""
        K = _by_products(R[..., :S1], self.problem.x, self.orders[e])
        Q = np.linalg.qr(K / np.linalg.norm(K, axis=0))[0]
        J = self._denominator_columns(R[..., S1:])
        return Q, J - Q @ (Q.T @ J)

    def _full_slopes(self, moved_columns: np.ndarray, e: int) -> np.ndarray:
        """Return the slopes of the residuals in the data's own rows: (poses 2 L, coefficients)."""
        problem, order = self.problem, self.orders[e]
        moved = self._denominator_columns(moved_columns)
        K = _by_products(self.columns[:, e], problem.x, order)
        size = np.linalg.norm(K, axis=0)
        R = np.linalg.qr(K / size, mode="r")
        along = linalg.solve_triangular(R, linalg.solve_triangular(R, (K / size).T @ moved, trans="T"))
        projected: np.ndarray = moved - K / size @ along
        return projected

    def _denominator_columns(self, moved: np.ndarray) -> np.ndarray:
        """(poses, rows, S) slopes with the coefficients at each pose to (poses rows, polynomial coefficients)."""
        columns, at = [], 0
        for block in self.blocks:
            for c in block.coefficients:
                at_poses = over_poses(self.problem.x, len(c))
                columns.append((moved[:, :, at, None] * at_poses[:, None, :]).reshape(-1, len(c)))
                at += 1
        return np.concatenate(columns, axis=1)

    def _moved_columns(self) -> np.ndarray:
        """(poses, elements, 2 L, S) weighted slopes of the responses with each scaled denominator coefficient, numerators held."""
        problem, first, columns = self.problem, 0, []
        at_poses = np.stack([over_poses(problem.x, len(n)) @ n for n in self.numerators], axis=1)  # (poses, elements, S + 1)
        for block in self.blocks:
            values, n = block.values(problem.x), block.order
            for k in range(n):
                step = STEP * np.maximum(np.abs(values[:, k]), 1.0)[:, None] * (np.arange(n) == k)
                up, down = (block.responses(values + sign * step, problem.frequencies_Hz, problem.sample_rate_Hz) for sign in (1.0, -1.0))
                slope = (up - down) / (2.0 * step[:, k])[:, None, None]
                columns.append(np.einsum("qln,qen->qel", slope, at_poses[:, :, first : first + n]) * problem.weight)
            first += n
        return _real(np.stack(columns, axis=2)).swapaxes(2, 3)


def _meat(problem: JointProblem, slopes: list[np.ndarray]) -> np.ndarray:
    """Return J^T V J, with V the halved (circular) covariance of the weighted data under the responses' full covariance."""
    poses, _, L = problem.weight.shape
    n_y, n_u = problem.shape
    order = [i * n_u + j for j in range(n_u) for i in range(n_y)]  # vec stacks columns
    weight = problem.weight[:, order].transpose(0, 2, 1).reshape(poses * L, -1)
    V = problem.covariance.reshape(poses * L, len(order), len(order)) * weight[:, :, None] * weight[:, None, :] / 2.0
    J = [slopes[e].reshape(poses, 2, L, -1).swapaxes(0, 1).reshape(2, poses * L, -1) for e in order]
    total = np.zeros((J[0].shape[2],) * 2)
    for a, (real_a, imaginary_a) in enumerate(J):
        for b, (real_b, imaginary_b) in enumerate(J):
            v = V[:, a, b, None]
            total += real_a.T @ (v.real * real_b - v.imag * imaginary_b) + imaginary_a.T @ (v.real * imaginary_b + v.imag * real_b)
    return total


def _moved(blocks: tuple[Block, ...], move: np.ndarray) -> tuple[Block, ...]:
    made, at = [], 0
    for block in blocks:
        coefficients = []
        for c in block.coefficients:
            coefficients.append(c + move[at : at + len(c)])
            at += len(c)
        made.append(replace(block, coefficients=tuple(coefficients)))
    return tuple(made)


def _by_products(K: np.ndarray, x: np.ndarray, order: int) -> np.ndarray:
    """Multiply every column with every polynomial: (poses, rows, S + 1) to (poses rows, (order + 1) (S + 1))."""
    products: np.ndarray = K[:, :, None, :] * over_poses(x, order + 1)[:, None, :, None]
    return products.reshape(K.shape[0] * K.shape[1], -1)


def _by_element(values: np.ndarray) -> np.ndarray:
    """Reshape (poses, L, n_y, n_u) to (poses, elements, L)."""
    return values.reshape(*values.shape[:2], -1).swapaxes(1, 2)


def _real(values: np.ndarray) -> np.ndarray:
    """Put real parts, then imaginary ones, along the last axis."""
    return np.concatenate((values.real, values.imag), axis=-1)
